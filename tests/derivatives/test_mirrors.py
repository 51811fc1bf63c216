"""What jumps seen by way of mirrors and glass add to derivatives is that of finite differences, and of a closed form."""

from __future__ import annotations

import math

import pytest
import torch

import torch_radbp as rb
from tests.deep import deep, deep_but
from tests.derivatives.in_expectation import Effort, Estimate, Row, assert_agrees
from tests.scenes import diffuse, load, overhead, rgb, sensor
from tests.scenes.mirrors import CUBE, IN_MIRROR, METAL, MIRROR, MIRRORED, SKY, shaded
from torch_radbp.boundary.terms import of_call as terms
from torch_radbp.io.values.transform import rotate, scale, translate

pytestmark = pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning")

BATCHES = 8

# The bias that a batch of so many samples shows.
SHOWN = {
    (0.1, 512): ("camera before a pane", "cube in a mirror", "mirror before a cube", "camera before a mirror",
                 "instance in a mirror", "cube in a ball", "index of a lens", "plate, its shadow in a mirror",
                 "lamp, a shadow in a mirror", "floor, a shadow in a mirror", "camera, a shadow in a mirror",
                 "squares in a mirror", "mirror before squares", "mirror before a shadow"),
    (0.2, 512): ("block before a cube", "cube behind a pane", "vertices behind a pane", "cube through a block",
                 "camera before a block"),
    (0.3, 512): ("vertices in a mirror",),
    (0.4, 512): ("cube through a lens",),
    (0.5, 512): ("lens before a cube",),
    # What a ball shows lies closer together towards its outline.
    (0.3, 1024): ("camera before a ball",),
    (0.6, 1024): ("ball before a cube",),
}
ROWS = [Row(name, bias, spp) for (bias, spp), names in SHOWN.items() for name in names]
QUICK = ("cube behind a pane", "mirror before squares")  # a mirror alone is examined by hand below


def test_every_scene_is_examined():
    assert {row.name for row in ROWS} == set(MIRRORED) and len(ROWS) == len(MIRRORED) >= 24


@pytest.mark.parametrize("row", deep_but([row for row in ROWS if row.name in QUICK], ROWS), ids=str)
def test_derivatives_are_those_of_finite_differences(row):
    """And if they were wrong by the stated bias, that would be noticed; most would be without what jumps."""
    measured = Estimate(MIRRORED[row.name], Effort(row.spp, BATCHES))
    measured.add_round()
    assert_agrees(measured, row, ("agrees", "too noisy"))


RADIANCE, EDGE = 3.0, 0.35


def half_plane(low: float = EDGE - 18, high: float = EDGE) -> rb.Scene:
    """A mirror at 45 degrees, x + z = 0, seen from above without perspective, from -1 to 1: x is seen at the height -x of
    what is bright, from `low` to `high`."""
    view = overhead()
    mirror = {"type": "rectangle", "to_world": rotate((0, 1, 0), 45) @ scale((9, 9, 1)), "bsdf": {"type": "conductor"}}
    place = translate((15, 0, 0.5 * (low + high))) @ rotate((0, 1, 0), -90) @ scale((0.5 * (high - low), 9, 1))
    bright = {"type": "rectangle", "to_world": place, "emitter": {
        "type": "area", "radiance": rgb(RADIANCE, RADIANCE, RADIANCE)}}
    return load(torch.float64, sensor=view, mirror=mirror, bright=bright)


@pytest.mark.parametrize("moving, speed", [  # each along an axis
    ({"bright": (2, 1.0), "mirror": (0, 0.5), "sensor": (0, 0.25)}, 1.0 - 0.5 + 0.25),  # what one lacks is seen
    deep({"bright": (2, 1.0)}, 1.0), deep({"bright": (0, 1.0)}, 0.0), deep({"mirror": (2, 1.0)}, -1.0),
    deep({"mirror": (0, 1.0)}, -1.0), deep({"sensor": (0, 1.0)}, 1.0), deep({"sensor": (1, 1.0)}, 0.0)], ids=str)
def test_an_edge_in_a_plane_mirror_moves_as_it_does_by_hand(moving, speed):
    """Where x > shift of the mirror - EDGE the half plane is seen; its border is 2 long, of an image of area 4."""
    scene = half_plane()
    tangents = {f"{name}.to_world": torch.zeros(4, 4, dtype=torch.float64) for name in moving}
    for tangent, (axis, size) in zip(tangents.values(), moving.values()):
        tangent[axis, 3] = size
    image = rb.render(scene, spp=64, max_depth=2)
    assert torch.allclose(image.mean(), torch.tensor(RADIANCE * (1 + EDGE) / 2, dtype=torch.float64), rtol=0.02)
    found = torch.stack([rb.jvp(scene, tangents, seed=seed, spp=64, max_depth=2).mean() for seed in range(8)])
    error = float(found.std()) / math.sqrt(len(found))
    expected = speed * RADIANCE / 2
    assert abs(float(found.mean()) - expected) <= 4 * error + 1e-3 * RADIANCE
    assert error < 0.02 * RADIANCE


@pytest.mark.parametrize("width", deep_but([0.12], [0.12, 0.6]))
def test_a_strip_in_a_plane_mirror_grows_as_it_does_by_hand(width):
    """Most pixels, which are 0.25 wide, see nothing of it at their corners; its two borders are 2 long, of an image of
    area 4."""
    scene = half_plane(EDGE - width, EDGE)
    tangent = torch.zeros(4, 4, dtype=torch.float64)
    pose = scene.get_parameter("bright.to_world")
    tangent[:3, 0] = pose.detach()[:3, 0] / (0.5 * width)  # both borders recede by 1
    found = torch.stack([rb.jvp(scene, {"bright.to_world": tangent}, seed=seed, spp=256, max_depth=2).mean()
                         for seed in range(8)])
    error = float(found.std()) / math.sqrt(len(found))
    assert abs(float(found.mean()) - RADIANCE) <= 4 * error + 1e-3 * RADIANCE
    assert error < 0.04 * RADIANCE


def jumps(moving: str, direction: torch.Tensor, scene: rb.Scene, **settings) -> torch.Tensor:
    """What `terms` add to the derivative of the image of a scene."""
    chosen = settings.pop("terms")
    whole, without = (rb.jvp(scene, {moving: direction}, seed=3, spp=16, max_depth=3, terms=some, **settings)
                      for some in (("interior", *chosen), ("interior",)))
    return whole - without


def test_what_is_seen_belongs_to_the_primary_term_and_borders_of_shadows_to_that_of_shadows():
    moving = MIRRORED["plate, its shadow in a mirror"]
    scene = shaded()
    tangent = moving.tangent(scene)
    assert jumps(moving.name, tangent, scene, terms=("shadow",)).abs().max() > 0.1
    assert not jumps(moving.name, tangent, scene, terms=("primary",)).any()  # the plate is out of sight
    moving = MIRRORED["cube in a mirror"]
    scene = moving.build()
    assert jumps(moving.name, moving.tangent(scene), scene, terms=("primary",)).abs().max() > 0.1
    assert not jumps(moving.name, moving.tangent(scene), scene, terms=("primary",), sampling="detached").any()


ROUGH = {"type": "roughdielectric", "alpha": 0.2}


@pytest.mark.parametrize("mirror, cube, wanted", [
    (METAL, CUBE["bsdf"], "cube.bsdf.reflectance.value"), (diffuse(0.5), CUBE["bsdf"], "cube.to_world"),
    (METAL, ROUGH, "cube.bsdf.alpha.value"), (METAL, ROUGH, "cube.bsdf.eta")])
def test_nothing_is_looked_for_where_nothing_moves_or_nothing_is_seen_by_way_of_others(mirror, cube, wanted, monkeypatch):
    monkeypatch.setattr(terms, "reflected_jumps", lambda *arguments: pytest.fail("mirrors have been looked into"))
    scene = load(sensor=IN_MIRROR, mirror=MIRROR | {"bsdf": mirror}, cube=CUBE | {"bsdf": cube}, sky=SKY)
    parameter = scene.get_parameter(wanted).requires_grad_()
    rb.Renderer(scene, max_depth=3)(seed=1, spp=4).sum().backward()
    assert float(parameter.grad.abs().sum()) > 0


def test_threads_and_chunks_change_no_bit_and_single_precision_serves():
    found = []
    for dtype, settings in ((torch.float32, {}), (torch.float32, {"chunk": 512}), (torch.float64, {})):
        scene = load(dtype, sensor=IN_MIRROR, mirror=MIRROR, cube=CUBE, sky=SKY)
        pose = scene.get_parameter("cube.to_world").requires_grad_()
        image = rb.Renderer(scene, max_depth=3, **settings)(seed=1, spp=64)
        image.square().sum().backward()
        found.append(pose.grad.double())
    assert found[0].abs().max() > 0.1
    assert torch.equal(found[0], found[1])
    assert torch.allclose(found[0], found[2], rtol=0.05, atol=0.05 * float(found[2].abs().max()))


GLOWING = {"sphere": {"type": "sphere", "radius": 0.1}, "cube": {"type": "cube", "to_world": scale((0.08, 0.08, 0.08))}}


@pytest.mark.parametrize("lamp, moving", [
    ("sphere", ("glass", "lamp")), *(deep(lamp, (alone,)) for lamp in GLOWING for alone in ("glass", "lamp"))])
def test_a_lamp_in_a_ball_of_glass_loses_on_one_side_what_it_gains_on_the_other(lamp, moving):
    """Moved across the view, either of them leaves the sum as it is; both together move the image of a sphere likewise."""
    view = sensor(32, (0, 0, 4), (0, 0, 0), fov=30, rfilter="gaussian")
    scene = load(sensor=view, glass={"type": "sphere", "radius": 0.5, "bsdf": {"type": "dielectric"}},
                 lamp=GLOWING[lamp] | {"emitter": {"type": "area", "radiance": rgb(5, 5, 5)}})
    light = rb.render(scene, spp=256, max_depth=2).detach().sum(2)[0, 0]
    tangent = torch.zeros(4, 4)
    tangent[0, 3] = 4 * math.tan(math.radians(15)) / 16  # a pixel at the distance of the lamp
    tangents = {f"{name}.to_world": tangent for name in moving}
    found = torch.stack([rb.jvp(scene, tangents, seed=seed, spp=128, max_depth=2)[0, 0].sum(0) for seed in range(8)])
    moments = (found * (torch.arange(32) - 15.5)).sum(1)  # about the middle, where the noise of the sum is least
    both = [(moments, float(light.sum()))] if len(moving) == 2 else []
    for sums, expected in ((found.sum(1), 0.0), *both):
        error = float(sums.std()) / math.sqrt(len(sums))
        assert error < 0.1 * float(light.sum())
        assert abs(float(sums.mean()) - expected) <= 4 * error
