"""Reflectances above 1, and images of high dynamic range in their places: taken as they are, with one warning."""

import re
import warnings

import numpy as np
import pytest
import torch

import torch_radbp as rb
from tests.bsdf import reference
from tests.bsdf.lanes import directions, material, values_of
from tests.scenes import load, rectangle, rgb, sensor
from torch_radbp.formats.image import save_image
from torch_radbp.plugin import REGISTRY, attributes

SKY = {"type": "constant", "radiance": rgb(0.5, 1.0, 2.0)}
BRIGHT = torch.tensor([[[2.0, 0.5, 1.0], [3.0, 1.0, 0.25]], [[0.0, 8.0, 1.5], [1.0, 0.1, 4.0]]])
OTHERS = {"roughconductor": {"material": "Au", "alpha": 0.3}, "principled": {"roughness": 0.4},
          "principledthin": {"roughness": 0.4, "spec_trans": 0.3}}
# Of kinds with smooth lobes.
NAMES = ("reflectance", "diffuse_reflectance", "specular_reflectance", "specular_transmittance", "base_color")
SLOTS = [(kind, name) for kind, cls in REGISTRY["bsdf"].items() for name in NAMES
         if name in attributes(cls) and kind not in ("conductor", "dielectric", "thindielectric")]


def wall(reflectance) -> rb.Scene:
    """A wall that fills the view, under a sky: of it the image is reflectance times radiance."""
    return load(sensor=sensor(8, (0, 0, 2), fov=30), sky=SKY,
                wall=rectangle((0, 0, 0), bsdf={"type": "diffuse", "reflectance": reflectance}))


def image_of(scene: rb.Scene) -> torch.Tensor:
    return rb.render(scene, spp=4, max_depth=2, nee=False)


@pytest.mark.filterwarnings("ignore:.*values above 1")
def test_a_bright_reflectance_is_taken_as_it_is():
    expected = torch.tensor([2.5, 1.5, 1.0], dtype=torch.float64) * torch.tensor([0.5, 1.0, 2.0], dtype=torch.float64)
    image = image_of(wall(rgb(2.5, 1.5, 1.0)))
    torch.testing.assert_close(image, expected[None, :, None, None].expand_as(image), rtol=1e-12, atol=0)


@pytest.mark.filterwarnings("ignore:.*values above 1")
@pytest.mark.parametrize("raw", [False, True])
def test_an_image_of_high_dynamic_range_is_taken_as_it_is(tmp_path, raw):
    save_image(tmp_path / "bright.exr", BRIGHT.movedim(2, 0))
    scene = wall({"type": "bitmap", "filename": str(tmp_path / "bright.exr"), "raw": raw})
    torch.testing.assert_close(scene.get_parameter("wall.bsdf.reflectance.data"), BRIGHT.double(), rtol=0, atol=0)
    assert image_of(scene).amax() > 2.5


def test_one_warning_tells_of_it():
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        scene = wall(rgb(0.3, 1.5, 1.0))
        renderer = rb.Renderer(scene, spp=1, max_depth=2)
        for seed in range(3):
            renderer(seed=seed)
    told = [str(one.message) for one in caught if "above 1" in str(one.message)]
    assert len(told) == 1
    assert re.match("parameter 'wall.bsdf.reflectance.value' has values above 1: the surface reflects more", told[0])


def test_white_is_no_reason_to_warn():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        image_of(wall(rgb(1, 1, 1)))


@pytest.mark.filterwarnings("ignore:.*values above 1")
def test_a_network_may_be_bright_too():
    scene = wall(0.5)
    network = torch.nn.Linear(2, 3, dtype=torch.float64)
    with torch.no_grad():
        network.weight.zero_()
        network.bias.copy_(torch.tensor([1.5, 2.0, 0.5]))
    scene.wall.bsdf.reflectance = rb.NeuralTexture(network)
    with pytest.warns(UserWarning, match="the texture 'wall.bsdf.reflectance' has values above 1"):
        image = image_of(scene)
    assert image[0, :, 0, 0].tolist() == pytest.approx([0.75, 2.0, 1.0])


@pytest.mark.filterwarnings("ignore:.*values above 1")
def test_the_gradient_is_right_above_one():
    """Between two such walls the radiance is a polynomial of the reflectance: against central differences."""
    scene = load(sensor=sensor(4, (0, 0, 0.5), (0, 0, -1), 60), sky=SKY,
                 wall=rectangle((0, 0, -1), 3.0, bsdf={"type": "diffuse", "id": "bright", "reflectance": 1.5}),
                 behind=rectangle((0, 0, 1), 1.0, (0, 1, 0), 180, bsdf={"type": "ref", "id": "bright"}))
    reflectance = scene.get_parameter("wall.bsdf.reflectance.value").requires_grad_()

    def total(change: float) -> torch.Tensor:
        reflectance.data.fill_(1.5 + change)
        return rb.Renderer(scene, spp=16, max_depth=5, rr_depth=99, share_samples=True)(seed=1).sum()

    total(0.0).backward()
    with torch.no_grad():
        difference = float(total(1e-5) - total(-1e-5)) / 2e-5
    assert abs(difference) > 1
    assert float(reflectance.grad) == pytest.approx(difference, rel=1e-7)


@pytest.mark.parametrize("kind, slot", SLOTS)
def test_scattering_of_a_bright_material_agrees_with_mitsuba(kind, slot):
    """Of smooth lobes. Mitsuba takes bright numbers, and refuses bright <rgb>."""
    pytest.importorskip("mitsuba")
    description = {"type": kind} | OTHERS.get(kind, {}) | {slot: 1.75}
    bsdf = material(description)
    wi, wo = directions(300, 1), directions(300, 2)
    wi = wi._replace(z=wi.z.abs())
    value = bsdf.kind().eval(values_of(bsdf, wi.z), wi, wo).stack().detach().numpy()
    theirs, _ = reference.by_mitsuba(description, wi.stack().numpy(), wo.stack().numpy())
    assert np.isfinite(theirs).all() and theirs.max() > 0.1
    np.testing.assert_allclose(value, theirs, rtol=2e-3, atol=1e-5 * theirs.max())
