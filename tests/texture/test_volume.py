"""The texture `volume`: values of space on surfaces, as Mitsuba reads them, with derivatives by them and by the surface."""

from __future__ import annotations

import math

import pytest
import torch

import torch_radbp as rb
from tests.gradients import EXACT, assert_informative, image_and_gradients, relative_error
from tests.scenes import load, overhead, rectangle, rgb
from tests.scenes.every_plugin import build, grid
from torch_radbp.check.lanes import texture_at
from torch_radbp.io.build import build_plugin
from torch_radbp.tensors.vec import Vec3

SETTINGS = {"spp": 8, "max_depth": 3}
NAMES = ["floor.bsdf.reflectance.volume.data", "floor.to_world"]


def coloured(**attributes) -> dict:
    return {"type": "volume", "volume": grid(3, **attributes)}


def room() -> rb.Scene:
    """A tilted floor that is coloured by a volume, under a point light, seen by way of itself as well."""
    floor = rectangle((0.1, -0.2, 0), 1.5, (1, 0, 0), 20, bsdf={"type": "diffuse", "reflectance": coloured()})
    wall = rectangle((0, 1.2, 0.6), 1.0, (1, 0, 0), 80, bsdf={"type": "roughplastic", "alpha": 0.4,
                                                              "diffuse_reflectance": coloured(seed=5)})
    return load(torch.float64, camera=overhead(6, 4.0, 1.0), floor=floor, wall=wall,
                bulb={"type": "point", "position": [0.4, -0.5, 1.5], "intensity": rgb(5, 4, 3)})


def test_values_are_those_of_the_volume_at_the_surface(mi):
    """And Mitsuba's, of a diffuse material: pi times what it reflects."""
    texture = build_plugin(coloured(), "texture").double()
    p = 4 * torch.rand(40, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0)) - 2
    found = texture_at(texture, Vec3.of(p)).stack().detach()
    volume = texture.volume
    assert torch.equal(found, volume.kind().eval(volume.table(), Vec3.of(p)).stack().detach())
    theirs = mi.load_dict({"type": "diffuse", "reflectance": {"type": "volume", "volume": {
        "type": "gridvolume", "grid": mi.VolumeGrid(volume.data.detach().numpy().astype("f4")),
        "to_world": mi.ScalarTransform4f(volume.to_world.numpy())}}})
    si = mi.SurfaceInteraction3f()
    si.wi = up = mi.Vector3f(0, 0, 1)
    for place, value in zip(p.tolist(), found.tolist()):
        si.p = mi.Point3f(*place)
        assert [math.pi * float(c) for c in theirs.eval(mi.BSDFContext(), si, up)] == pytest.approx(value, abs=1e-5)


@pytest.fixture(scope="module")
def tape():
    image, gradients = image_and_gradients(room(), NAMES, adjoint=rb.TapeAdjoint(), compile=False, **SETTINGS)
    assert_informative(image, gradients)
    return image, gradients


@pytest.mark.parametrize("adjoint", [*EXACT[:4], *EXACT[-3:-1]], ids=str)
def test_every_strategy_gives_the_gradient_of_the_tape(adjoint, compiled, tape):
    image, gradients = image_and_gradients(room(), NAMES, adjoint=adjoint, compile=compiled, **SETTINGS)
    for found, expected in zip((image, *gradients), (tape[0], *tape[1])):
        assert relative_error(found, expected) < 1e-10


def test_forward_mode_is_the_transpose_of_backward(compiled):
    scene = room()
    generator = torch.Generator().manual_seed(4)
    tangents = {name: torch.randn(scene.get_parameter(name).shape, generator=generator, dtype=torch.float64)
                for name in NAMES}
    tangents["floor.to_world"][3] = 0
    change = rb.jvp(scene, tangents, seed=3, compile=compiled, **SETTINGS)
    cotangent = torch.randn(change.shape, generator=generator, dtype=torch.float64)
    _, gradients = image_and_gradients(scene, NAMES, adj_image=cotangent, compile=compiled, **SETTINGS)
    backward = sum(float((gradient * tangents[name]).sum()) for gradient, name in zip(gradients, NAMES))
    assert float((change * cotangent).sum()) == pytest.approx(backward, rel=1e-9)


def test_a_colour_that_moves_over_a_surface_has_the_derivative_of_differences():
    """A diffuse floor in its own plane, under an even sky: only what it reads changes."""
    def scene():
        return load(torch.float64, camera=overhead(4, 4.0, 1.0), sky={"type": "constant"}, floor=rectangle(
            (0, 0, 0), 3.0, bsdf={"type": "diffuse", "reflectance": coloured()}))

    shift = torch.zeros(4, 4, dtype=torch.float64)
    shift[2, 3] = 1.0
    change = rb.jvp(scene(), {"floor.to_world": shift}, spp=1024, max_depth=2, seed=1)
    ends = []
    for step in (-1e-4, 1e-4):
        moved = scene()
        moved.floor.to_world.data[2, 3] += step
        ends.append(rb.render(moved, spp=1024, max_depth=2, seed=1))
    torch.testing.assert_close(change, (ends[1] - ends[0]) / 2e-4, rtol=0.02, atol=0.02 * float(change.abs().max()))
    assert change.abs().max() > 0.01


def test_a_saved_volume_looks_the_same(tmp_path):
    for name in ("volume", "volume of roughness"):
        scene = build(name, torch.float32)
        rb.save(scene, tmp_path / "scene.xml")
        again = rb.load(tmp_path / "scene.xml")
        assert torch.equal(*(rb.render(each, spp=2, max_depth=2, seed=1) for each in (scene, again)))


@pytest.mark.parametrize("described, category, message", [
    ({"type": "area", "radiance": coloured()}, "emitter", "radiance of an area must not vary in space, got a volume"),
    ({"type": "diffuse", "reflectance": {"type": "volume", "volume": grid(6)}}, "bsdf",
     "volume of volume must have 1 or 3 channels, got a gridvolume of 6"),
    ({"type": "mask", "opacity": {"type": "volume", "volume": 2.0}, "nested": {"type": "diffuse"}}, "bsdf",
     r"opacity must be in \[0, 1\], got 2"),
])
def test_what_makes_no_sense_is_refused_by_name(described, category, message):
    with pytest.raises(ValueError, match=message):
        build_plugin(described, category)
