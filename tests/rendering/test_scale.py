"""Images are the same at any scale from 1e-4 to 1e5, and far from the origin, up to what rounding decides otherwise."""

from functools import partial

import pytest
import torch
from torch import Tensor

import torch_radbp as rb
from tests.scenes import diffuse, load, rgb
from torch_radbp.io.values.transform import rotate, scale, translate

SCALES = (1e-4, 1e-3, 3e-3, 1e-2, 1e3, 1e5)
ORIGIN, FAR, FURTHER = (0.0, 0.0, 0.0), (100.0, -70.0, 40.0), (1000.0, -700.0, 400.0)  # in units of the scene's size


def similarity(factor: float, place) -> tuple:
    """Poses and points of a unit scene made `factor` times as large, at `place` in units of its new size."""
    pose = translate([factor * x for x in place]) @ scale((factor, factor, factor))

    def moved(point) -> list[float]:
        return [factor * (x + offset) for x, offset in zip(point, place)]

    return pose, moved


def view(factor: float, place, origin, target, size: int = 16) -> dict:
    moved = similarity(factor, place)[1]
    return {"type": "perspective", "fov": 39.0, "to_world": rb.look_at(moved(origin), moved(target), (0, 1, 0)),
            "near_clip": 1e-3 * factor, "far_clip": 1e3 * factor,
            "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}}}


def rectangle(pose, at, axis=(1, 0, 0), angle: float = 0.0, half: float = 1.0, **attributes) -> dict:
    pose = pose @ translate(at) @ rotate(axis, angle) @ scale((half, half, half))
    return {"type": "rectangle", "to_world": pose} | attributes


def cornell(factor: float = 1.0, place=ORIGIN, dtype: torch.dtype = torch.float32) -> rb.Scene:
    """The Cornell box with one block that stands on its floor: light leaks where rays start too far off."""
    pose, _ = similarity(factor, place)
    white = {"type": "ref", "id": "white"}
    return load(
        dtype, sensor=view(factor, place, (0, 0, 3.9), (0, 0, 0)), white=diffuse(0.88, 0.7, 0.67),
        floor=rectangle(pose, (0, -1, 0), angle=-90, bsdf=white), ceiling=rectangle(pose, (0, 1, 0), angle=90, bsdf=white),
        back=rectangle(pose, (0, 0, -1), bsdf=white),
        left=rectangle(pose, (-1, 0, 0), (0, 1, 0), 90, bsdf=diffuse(0.57, 0.04, 0.04)),
        right=rectangle(pose, (1, 0, 0), (0, 1, 0), -90, bsdf=diffuse(0.11, 0.44, 0.09)),
        block={"type": "cube", "bsdf": white,
               "to_world": pose @ translate((0.3, -0.6, 0.1)) @ rotate((0, 1, 0), 25) @ scale((0.3, 0.4, 0.3))},
        light=rectangle(pose, (0, 0.98, 0), angle=90, half=0.3, bsdf=diffuse(0.2, 0.2, 0.2),
                        emitter={"type": "area", "radiance": rgb(9, 7, 4)}))


def slab(factor: float = 1.0, place=ORIGIN, dtype: torch.dtype = torch.float32, gap: float = 1e-3) -> rb.Scene:
    """A slab of smooth glass that nearly touches a floor, under a lamp and a sky."""
    pose, _ = similarity(factor, place)
    return load(
        dtype, sensor=view(factor, place, (0.3, 1.4, 2.6), (0, 0, 0)),
        sky={"type": "constant", "radiance": rgb(0.3, 0.4, 0.6)},
        floor=rectangle(pose, (0, 0, 0), angle=-90, half=2.0, bsdf=diffuse(0.7, 0.5, 0.3)),
        glass={"type": "cube", "bsdf": {"type": "dielectric", "int_ior": 1.5},
               "to_world": pose @ translate((0, 0.05 + gap, 0)) @ rotate((0, 1, 0), 20) @ scale((0.6, 0.05, 0.5))},
        light=rectangle(pose, (0.4, 1.5, 0), angle=90, half=0.4, emitter={"type": "area", "radiance": rgb(9, 8, 7)}))


def image(scene: rb.Scene, **settings) -> Tensor:
    return rb.render(scene, spp=64, max_depth=8, seed=1, **settings)


def assert_same(found: Tensor, expected: Tensor, mean: float, pixels: int) -> None:
    """The same in the mean to `mean`, and in all but `pixels` pixels to 1e-3 of the brightest."""
    assert expected.mean() > 0.05
    assert abs(float(found.double().mean() / expected.double().mean()) - 1) < mean
    differs = ((found - expected).abs() > 1e-3 * expected.max()).any(1)
    assert int(differs.sum()) <= pixels, int(differs.sum())


@pytest.fixture(scope="module")
def expected() -> dict[str, Tensor]:
    """At unit scale, at the origin, in float64 with rays by brute force: no float32 has a part in it."""
    return {build.__name__: image(build(dtype=torch.float64), caster="brute").float() for build in (cornell, slab)}


@pytest.mark.parametrize("build", [cornell, slab], ids=["cornell", "glass nearly touching"])
@pytest.mark.parametrize("factor", (1.0, *SCALES))
def test_images_do_not_depend_on_scale(build, factor, expected):
    assert_same(image(build(factor)), expected[build.__name__], mean=1e-4, pixels=4)


@pytest.mark.parametrize("build", [cornell, slab], ids=["cornell", "glass nearly touching"])
@pytest.mark.parametrize("factor", [1e-4, 1.0, 1e5])
def test_images_do_not_depend_on_a_distance_of_100_sizes_from_the_origin(build, factor, expected):
    assert_same(image(build(factor, FAR)), expected[build.__name__], mean=3e-4, pixels=12)


@pytest.mark.parametrize("build", [cornell, partial(slab, gap=0.01)], ids=["cornell", "glass close to a floor"])
@pytest.mark.parametrize("factor", [1e-4, 1.0, 1e5])
def test_images_do_not_depend_on_a_distance_of_1000_sizes_from_the_origin(build, factor):
    """There vertices are rounded to 6e-5 of the scene's size, so that single paths through glass take other ways."""
    expected = image(build(dtype=torch.float64), caster="brute").float()
    assert_same(image(build(factor, FURTHER)), expected, mean=3e-3, pixels=48)
