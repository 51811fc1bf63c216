"""What is assigned to the objects of a scene takes effect, or is refused by name."""

import copy
import re

import pytest
import torch
from torch import nn
from torch.nn.utils import parametrize

import torch_radbp as rb
from tests.gradients import relative_error
from tests.scenes import SKY, diffuse, load, rectangle, sensor
from tests.scenes.networks import LAMP, mlp, textured

SETTINGS = {"spp": 1, "max_depth": 3, "compile": False, "seed": 2}


def scene(**bsdf) -> rb.Scene:
    """Two rectangles, the first of a material that has a name of its own, a lamp and a sky; float32."""
    return load(torch.float32, sensor=sensor(3, (0.2, 0.1, 2)), white=diffuse(0.5, 0.6, 0.7), sky=SKY,
                floor=rectangle((0, 0, 0), 2.0, bsdf={"type": "ref", "id": "white"}),
                wall=rectangle((0.1, 0, 0.2), 0.3, bsdf=bsdf or diffuse(0.2, 0.3, 0.4)),
                lamp=rectangle((0, 1.5, 0.5), 0.5, angle=90, emitter=LAMP))


def texture() -> rb.NeuralTexture:
    return rb.NeuralTexture(mlp(2, 3))


DIFFUSE = "diffuse has no attribute 'reflectanse'; did you mean 'reflectance'? known: reflectance"
MATERIAL = "; a network or another texture stands in a material, as .bsdf.reflectance"
NUMBERS = "; numbers go into its parameter, as .reflectance.value.data"
REFUSED = {
    "a misspelt texture": ("white", "reflectanse", texture, AttributeError, DIFFUSE),
    "a misspelt network": ("white", "reflectanse", lambda: mlp(2, 3), AttributeError, DIFFUSE),
    "a misspelt parameter": ("white", "reflectanse", lambda: nn.Parameter(torch.ones(3)), AttributeError, DIFFUSE),
    "a misspelt material": ("floor", "bdsf", lambda: nn.Linear(2, 3), AttributeError,
                            "rectangle has no attribute 'bdsf'; did you mean 'bsdf'?"),
    "a misspelt pose": ("floor", "to_wrold", lambda: nn.Parameter(torch.eye(4)), AttributeError,
                        "rectangle has no attribute 'to_wrold'; did you mean 'to_world'?"),
    "the value of a colour": ("white.reflectance", "data", lambda: nn.Parameter(torch.ones(3)), AttributeError,
                              "rgb has no attribute 'data'; known: value"),
    "a parameter of a sensor": ("sensor", "fovv", lambda: nn.Parameter(torch.tensor(40.0)), AttributeError,
                                "perspective has no attribute 'fovv'; did you mean "),
    "a texture as material": ("floor", "bsdf", texture, TypeError,
                              "bsdf of a rectangle must be a bsdf, got a texture" + MATERIAL),
    "a network as material": ("wall", "bsdf", lambda: nn.Linear(2, 3), TypeError,
                              "bsdf of a rectangle must be a bsdf, got a Linear" + MATERIAL),
    "a colour as material": ("wall", "bsdf", lambda: scene().white.reflectance, TypeError, "must be a bsdf, got a texture"),
    "an emitter as material": ("wall", "bsdf", lambda: scene().sky, TypeError,
                               "bsdf of a rectangle must be a bsdf, got a Constant"),
    "a network as emitter": ("lamp", "emitter", lambda: mlp(2, 3), TypeError,
                             "emitter of a rectangle must be an emitter, got a Sequential"),
    "a tensor as texture": ("white", "reflectance", lambda: torch.ones(3), TypeError,
                            "reflectance of a diffuse must be a texture, got a Tensor" + NUMBERS),
    "a number as texture": ("white", "reflectance", lambda: 0.5, TypeError,
                            "reflectance of a diffuse must be a texture, got a float" + NUMBERS),
    "a parameter as texture": ("white", "reflectance", lambda: nn.Parameter(torch.ones(3)), TypeError,
                               "reflectance of a diffuse must be a texture, got a Parameter" + NUMBERS),
    "a network as sky": ("sky", "radiance", lambda: mlp(2, 3), TypeError,
                         "radiance of Constant must be a colour or a bitmap, got a NeuralTexture"),
    "a texture of no object": ("", "wite", texture, AttributeError,
                               "the scene has no object 'wite', and a texture that no shape has would change nothing: "
                               "assign it where it is to be used; did you mean 'white'?"),
    "a texture as named material": ("", "white", texture, TypeError, "white of the scene must be a bsdf, got a texture"),
}


@pytest.mark.hostile
@pytest.mark.parametrize("owner, name, make, kind, message", REFUSED.values(), ids=REFUSED)
def test_what_cannot_stand_there_is_refused(owner, name, make, kind, message):
    ours, value = scene(), make()
    before = list(dict(ours.named_parameters()))
    with pytest.raises(kind, match=re.escape(message)):
        setattr(ours.get_submodule(owner), name, value)
    assert list(dict(ours.named_parameters())) == before


def test_a_tensor_of_an_unknown_name_is_refused_by_the_rendering():
    ours = scene()
    ours.white.reflectanse = torch.ones(3)
    with pytest.raises(AttributeError, match="there is no parameter 'scene.white.reflectanse'; did you mean"):
        rb.render(ours, **SETTINGS)


def test_a_network_that_is_assigned_is_a_texture():
    """Of a material that others refer to, with the image and the gradient of one that was described."""
    network = mlp(2, 3)
    ours, described = scene(), scene(**textured(copy.deepcopy(network)))
    ours.wall.bsdf.reflectance = network
    assert isinstance(ours.wall.bsdf.reflectance, rb.NeuralTexture)
    images = [rb.render(each, **SETTINGS) for each in (ours, described)]
    assert torch.equal(*images)
    for image in images:
        image.sum().backward()
    expected = described.wall.bsdf.reflectance.module[0].weight.grad
    assert float(expected.abs().max()) > 0 and relative_error(network[0].weight.grad, expected) < 1e-6


def test_a_network_can_be_assigned_to_a_lamp():
    ours = scene()
    ours.lamp.emitter.radiance = network = mlp(2, 3)
    rb.render(ours, **SETTINGS).sum().backward()
    assert float(network[0].weight.grad.abs().max()) > 0


def test_an_assigned_material_takes_the_place_of_one_that_is_referred_to():
    ours, expected = scene(), scene()
    expected.white.reflectance.value.copy_(torch.tensor((0.2, 0.3, 0.4)))
    ours.floor.bsdf = ours.wall.bsdf
    assert torch.equal(rb.render(ours, **SETTINGS), rb.render(expected, **SETTINGS))


def test_a_named_object_can_be_replaced():
    ours, expected = scene(), scene()
    expected.white.reflectance.value.fill_(0.25)
    ours.white = load(torch.float32, white=diffuse(0.25, 0.25, 0.25), sky=SKY, sensor=sensor(),
                      floor=rectangle((0, 0, 0), bsdf={"type": "ref", "id": "white"})).white
    assert torch.equal(rb.render(ours, **SETTINGS), rb.render(expected, **SETTINGS))


def test_a_parametrisation_is_no_unknown_attribute():
    ours = scene()
    ours.white.reflectance.value.requires_grad_()
    parametrize.register_parametrization(ours.white.reflectance, "value", nn.Sigmoid())
    rb.render(ours, **SETTINGS).sum().backward()
    assert float(ours.white.reflectance.parametrizations.value.original.grad.abs().max()) > 0
