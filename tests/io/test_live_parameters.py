"""`load_dict` and tensors that require a gradient: an `nn.Parameter` becomes the scene's, all else is refused by name."""

import re

import numpy as np
import pytest
import torch
from torch import nn

import torch_radbp as rb
from tests.scenes import diffuse, rectangle, rgb, sensor
from torch_radbp.bsdf.diffuse import Diffuse
from torch_radbp.texture.bitmap import Bitmap

pytestmark = pytest.mark.hostile

TRIANGLE = torch.tensor([[-1.0, -1, 0], [1, -1, 0], [0, 1, 0]])
FACES = torch.tensor([[0, 1, 2]])
VIEW = torch.tensor([[-1.0, 0, 0, 0.1], [0, 1, 0, 0], [0, 0, -1, 3], [0, 0, 0, 1]])


def scene(**objects) -> rb.Scene:
    """These objects before a wall, under a sky, unless they are the wall, the sky or the sensor."""
    others = {
        "sensor": sensor(2),
        "wall": rectangle((0, 0, -1), 3, bsdf=diffuse(0.5, 0.4, 0.3)),
        "sky": {"type": "constant"},
    }
    return rb.load_dict({"type": "scene", **{**others, **objects}})


def wall(bsdf) -> dict:
    return {"wall": rectangle((0, 0, -1), 3, bsdf=bsdf)}


def mesh(**attributes) -> dict:
    return {"mesh": {"type": "mesh", "vertex_positions": TRIANGLE, "faces": FACES} | attributes}


def bitmap(name: str, value, kind: str = "bitmap") -> dict:
    return {"type": kind, name: value}


# By case: the value, the objects that it is put into, and the name that it gets.
ADOPTED = {
    "colour": (torch.rand(3), lambda p: wall({"type": "diffuse", "reflectance": p}), "wall.bsdf.reflectance.value"),
    "number": (torch.tensor(0.3), lambda p: wall({"type": "diffuse", "reflectance": p}), "wall.bsdf.reflectance.value"),
    "rgb": (
        torch.rand(3),
        lambda p: wall({"type": "diffuse", "reflectance": {"type": "rgb", "value": p}}),
        "wall.bsdf.reflectance.value",
    ),
    "bitmap": (
        torch.rand(2, 3, 3),
        lambda p: wall({"type": "diffuse", "reflectance": bitmap("data", p)}),
        "wall.bsdf.reflectance.data",
    ),
    "bitmap by its other name": (
        torch.rand(2, 3, 3),
        lambda p: wall({"type": "diffuse", "reflectance": bitmap("bitmap", p)}),
        "wall.bsdf.reflectance.data",
    ),
    "grey bitmap": (
        torch.rand(3, 4, 1),
        lambda p: wall({"type": "diffuse", "reflectance": bitmap("data", p)}),
        "wall.bsdf.reflectance.data",
    ),
    "grey envmap": (torch.rand(3, 4, 1), lambda p: {"sky": bitmap("bitmap", p, "envmap")}, "sky.data"),
    "envmap": (torch.rand(3, 4, 3), lambda p: {"sky": bitmap("bitmap", p, "envmap")}, "sky.data"),
    "envmap by its other name": (torch.rand(3, 4, 3), lambda p: {"sky": bitmap("data", p, "envmap")}, "sky.data"),
    "radiance": (torch.rand(3), lambda p: {"sky": {"type": "constant", "radiance": p}}, "sky.radiance.value"),
    "spectrum of a surface": (
        torch.rand(3),
        lambda p: wall({"type": "diffuse", "reflectance": {"type": "spectrum", "value": p}}),
        "wall.bsdf.reflectance.value",
    ),
    "roughness": (torch.tensor(0.4), lambda p: wall({"type": "roughconductor", "alpha": p}), "wall.bsdf.alpha.value"),
    "position": (torch.tensor([0.0, 0, 2]), lambda p: {"lamp": {"type": "point", "position": p}}, "lamp.position"),
    "pose of a camera": (VIEW, lambda p: {"sensor": sensor(2, to_world=p), "ball": {"type": "sphere"}}, "sensor.to_world"),
    "pose of a sphere": (torch.eye(4), lambda p: {"ball": {"type": "sphere", "to_world": p}}, "ball.to_world"),
    "pose of a cube": (torch.eye(4), lambda p: {"box": {"type": "cube", "to_world": p}}, "box.to_world"),
    "vertices": (TRIANGLE, lambda p: mesh(vertex_positions=p), "mesh.vertex_positions"),
    "vertices with smooth normals": (
        TRIANGLE,
        lambda p: mesh(vertex_positions=p, recompute_normals=True),
        "mesh.vertex_positions",
    ),
    "normals": (
        torch.tensor([[0.1, 0, 1], [0, 0.2, 1], [0, 0, 1]]),
        lambda p: mesh(vertex_normals=p),
        "mesh.vertex_normals",
    ),
    "coordinates": (
        torch.rand(3, 2),
        lambda p: mesh(
            vertex_texcoords=p,
            bsdf={"type": "diffuse", "reflectance": bitmap("data", np.random.default_rng(0).uniform(0, 1, (4, 4, 3)))},
        ),
        "mesh.vertex_texcoords",
    ),
}


@pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning")
@pytest.mark.parametrize("value, objects, name", ADOPTED.values(), ids=ADOPTED)
def test_a_parameter_becomes_that_of_the_scene_and_gets_the_gradient(value, objects, name):
    parameter = nn.Parameter(value.clone())
    loaded = scene(**objects(parameter))
    assert loaded.get_parameter(name) is parameter
    rb.render(loaded, spp=16, max_depth=3, sampling="attached", compile=False).square().sum().backward()
    assert parameter.grad.isfinite().all() and parameter.grad.abs().max() > 0
    plain = scene(**objects(value.clone()))
    assert not plain.get_parameter(name).requires_grad
    # Eager: loops that are compiled for other tables (here for normals that are not dropped) round differently.
    images = [rb.render(each, spp=2, max_depth=3, compile=False) for each in (plain, loaded)]
    assert torch.equal(*images)


def test_a_frozen_parameter_stays_frozen_and_is_shared():
    parameter = nn.Parameter(torch.rand(3), requires_grad=False)
    loaded = scene(**wall({"type": "diffuse", "reflectance": parameter}))
    assert loaded.get_parameter("wall.bsdf.reflectance.value") is parameter and not parameter.requires_grad


def test_one_parameter_in_two_places_is_one_parameter():
    parameter = nn.Parameter(torch.tensor([0.2, 0.3, 0.4]))
    loaded = scene(**wall({"type": "diffuse", "reflectance": parameter}), sky={"type": "constant", "radiance": parameter})
    assert loaded.wall.bsdf.reflectance.value is loaded.sky.radiance.value
    rb.render(loaded, spp=1, max_depth=2).sum().backward()
    assert (parameter.grad > 0).all()


# By case: the objects that hold a value which cannot become a parameter as it is, and the place and name in the message.
LEAF = torch.rand(3, requires_grad=True)
REFUSED = {
    "leaf that is no parameter": (
        lambda: wall({"type": "diffuse", "reflectance": LEAF}),
        "wall.bsdf.reflectance",
        "reflectance",
    ),
    "output of a network": (
        lambda: wall({"type": "diffuse", "reflectance": torch.sigmoid(LEAF)}),
        "wall.bsdf.reflectance",
        "reflectance",
    ),
    "leaf as bitmap": (
        lambda: wall({"type": "diffuse", "reflectance": bitmap("data", torch.rand(2, 2, 3, requires_grad=True))}),
        "wall.bsdf.reflectance.data",
        "data",
    ),
    "leaf as rgb": (
        lambda: wall({"type": "diffuse", "reflectance": {"type": "rgb", "value": LEAF}}),
        "wall.bsdf",
        "reflectance",
    ),
    "leaf as vertices": (
        lambda: mesh(vertex_positions=TRIANGLE.clone().requires_grad_()),
        "mesh.vertex_positions",
        "vertex_positions",
    ),
    "leaf as pose": (
        lambda: {"ball": {"type": "sphere", "to_world": torch.eye(4, requires_grad=True)}},
        "ball.to_world",
        "to_world",
    ),
    "computed position": (lambda: {"lamp": {"type": "point", "position": 2 * LEAF}}, "lamp.position", "position"),
    "flat bitmap": (
        lambda: wall({"type": "diffuse", "reflectance": bitmap("data", nn.Parameter(torch.rand(2, 2)))}),
        "wall.bsdf.reflectance",
        "data",
    ),
    "grey envmap": (lambda: {"sky": bitmap("bitmap", nn.Parameter(torch.rand(2, 2)), "envmap")}, "sky", "data"),
    "double colour": (
        lambda: wall({"type": "diffuse", "reflectance": nn.Parameter(torch.rand(3).double())}),
        "wall.bsdf",
        "value",
    ),
    "frozen double colour": (
        lambda: wall({"type": "diffuse", "reflectance": nn.Parameter(torch.rand(3).double(), False)}),
        "wall.bsdf.reflectance",
        "reflectance",
    ),
    "double bitmap": (lambda: {"sky": bitmap("data", nn.Parameter(torch.rand(2, 2, 3).double()), "envmap")}, "sky", "data"),
    "vertices under a pose": (
        lambda: mesh(vertex_positions=nn.Parameter(TRIANGLE), to_world=torch.eye(4)),
        "mesh",
        "vertex_positions in world space",
    ),
    "sphere of a radius under a pose": (
        lambda: {"ball": {"type": "sphere", "radius": 2.0, "to_world": nn.Parameter(torch.eye(4))}},
        "ball",
        "to_world",
    ),
    "centre of a sphere": (lambda: {"ball": {"type": "sphere", "center": nn.Parameter(torch.rand(3))}}, "ball", ""),
    "direction": (lambda: {"sun": {"type": "directional", "direction": nn.Parameter(torch.rand(3))}}, "sun", ""),
    "pose of a point light": (
        lambda: {"lamp": {"type": "point", "to_world": nn.Parameter(torch.eye(4))}},
        "lamp",
        "position",
    ),
    "field of view": (lambda: {"sensor": sensor(2, fov=nn.Parameter(torch.tensor(40.0)))}, "sensor.fov", "fov"),
    "focal length": (
        lambda: {"sensor": sensor(2) | {"near_clip": nn.Parameter(torch.tensor(0.1))}},
        "sensor.near_clip",
        "near",
    ),
    "index of refraction": (
        lambda: wall({"type": "dielectric", "int_ior": nn.Parameter(torch.tensor(1.5))}),
        "wall.bsdf.int_ior",
        "int_ior",
    ),
    "factor of a sky": (
        lambda: {"sky": bitmap("data", torch.rand(2, 2, 3), "envmap") | {"scale": nn.Parameter(torch.ones(()))}},
        "sky.scale",
        "scale",
    ),
    "angle": (
        lambda: {"lamp": {"type": "spot", "cutoff_angle": nn.Parameter(torch.tensor(20.0))}},
        "lamp.cutoff_angle",
        "cutoff",
    ),
    "spectrum of an emitter": (
        lambda: {"sky": {"type": "constant", "radiance": {"type": "spectrum", "value": nn.Parameter(torch.ones(()))}}},
        "sky.radiance",
        "radiance",
    ),
    "pixels": (
        lambda: {"sensor": sensor(2) | {"film": {"type": "hdrfilm", "width": nn.Parameter(torch.tensor(4.0))}}},
        "sensor.film.width",
        "width",
    ),
}


@pytest.mark.parametrize("objects, place, name", REFUSED.values(), ids=REFUSED)
def test_what_would_lose_its_gradient_is_refused_by_name(objects, place, name):
    message = rf"^{re.escape(place)}.*{name}.* requires a gradient, which would not reach it: only an nn.Parameter"
    with pytest.raises(rb.SceneError, match=message):
        scene(**objects())


@pytest.mark.parametrize(
    "make",
    [
        lambda: Diffuse(reflectance=torch.rand(3, requires_grad=True)),
        lambda: Bitmap(data=torch.rand(2, 2, 3, requires_grad=True)),
        lambda: Bitmap(data=nn.Parameter(torch.rand(2, 2))),
    ],
    ids=["colour", "bitmap", "grey"],
)
def test_plugins_made_by_hand_refuse_it_too(make):
    with pytest.raises(ValueError, match="requires a gradient, which would not reach it"):
        make()


def test_plugins_made_by_hand_take_a_parameter_too():
    parameter = nn.Parameter(torch.rand(2, 2, 3))
    assert Bitmap(data=parameter).data is parameter


COMPLEX = {
    "bitmap": wall({"type": "diffuse", "reflectance": bitmap("data", np.ones((2, 2, 3)) * (0.5 + 0.5j))}),
    "bitmap of torch": wall({"type": "diffuse", "reflectance": bitmap("data", torch.ones(2, 2, 3) * (0.5 + 0.5j))}),
    "envmap": {"sky": bitmap("bitmap", np.ones((2, 2, 3), complex), "envmap")},
    "colour": wall({"type": "diffuse", "reflectance": np.array([0.5, 0.5j, 0.5])}),
    "number": wall({"type": "diffuse", "reflectance": 0.5j}),
    "rgb": wall({"type": "diffuse", "reflectance": rgb(0.1, 0.2j, 0.3)}),
    "vertices": mesh(vertex_positions=TRIANGLE * (1 + 1j)),
    "pose": {"ball": {"type": "sphere", "to_world": np.eye(4) * (1 + 0j)}},
    "position": {"lamp": {"type": "point", "position": [0.0, 1j, 2.0]}},
    "field of view": {"sensor": sensor(2, fov=40 + 1j)},
}


@pytest.mark.parametrize("objects", COMPLEX.values(), ids=COMPLEX)
@pytest.mark.filterwarnings("error")
def test_complex_numbers_are_refused(objects):
    with pytest.raises(rb.SceneError, match="must be .*, got .*(complex|j)"):
        scene(**objects)


@pytest.mark.filterwarnings("error")
def test_complex_numbers_are_refused_by_plugins_made_by_hand():
    with pytest.raises(ValueError, match="data must be real numbers, got torch.complex64; take its real part"):
        Bitmap(data=torch.ones(2, 2, 3) * 1j)


ARRAYS = [torch.rand(2, 3, 3), np.random.default_rng(0).uniform(size=(2, 3)), torch.rand(2, 3, 1)]


@pytest.mark.parametrize("array", ARRAYS, ids=["colour", "numpy", "grey"])
def test_bitmaps_and_envmaps_take_an_array_by_either_name(array):
    for kind, place in (("bitmap", lambda t: wall({"type": "diffuse", "reflectance": t})), ("envmap", lambda t: {"sky": t})):
        first, second = (
            rb.render(scene(**place(bitmap(name, array, kind))), spp=1, max_depth=2) for name in ("data", "bitmap")
        )
        assert torch.equal(first, second)


NAMES = {
    "both names": (
        {"type": "bitmap", "data": np.ones((2, 2)), "bitmap": np.ones((2, 2))},
        "a bitmap needs either filename or data",
    ),
    "no name": ({"type": "bitmap"}, "a bitmap needs either filename or data, and not both; bitmap is another name for data"),
    "file and array": (
        {"type": "bitmap", "filename": __file__, "bitmap": np.ones((2, 2))},
        "either filename or data, and not",
    ),
    "wrong shape": ({"type": "bitmap", "bitmap": np.ones((2, 2, 2))}, r"bitmap must have shape .*, got \(2, 2, 2\)"),
    "not finite": ({"type": "bitmap", "bitmap": np.full((2, 2), np.nan)}, "bitmap must be finite, got 4 of 4 values"),
    "misspelt": ({"type": "bitmap", "bitmaps": np.ones((2, 2))}, "no attribute 'bitmaps'; did you mean 'bitmap'"),
}


@pytest.mark.parametrize("texture, message", NAMES.values(), ids=NAMES)
def test_a_bitmap_is_given_once(texture, message):
    with pytest.raises(rb.SceneError, match=message):
        scene(**wall({"type": "diffuse", "reflectance": texture}))


def test_a_negative_envmap_is_named_as_it_was_given():
    with pytest.raises(rb.SceneError, match="data must be at least 0, got -1"):
        scene(sky=bitmap("data", -np.ones((2, 2)), "envmap"))
