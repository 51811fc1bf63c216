"""Where surfaces meet that move apart, samples of derivatives are bounded, and right.

A floor and a wall that stands on it, or passes through it, or is held a little above it, under a sky: seen from above, light
that the wall sends to the floor next to it. The wall slides along, or the camera's points slide over both.
"""

from __future__ import annotations

from typing import Any

import pytest
import torch

import torch_radbp as rb
from tests.deep import deep_but
from tests.scenes import diffuse, load, rgb, sensor
from torch_radbp.io.values.transform import rotate, scale, translate
from torch_radbp.tensors.vec import Vec3, dot
from torch_radbp.vertex.nearby import Floor, Nearby, slide_at

pytestmark = pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning")

SIZE, SPP, STEP = 16, 256, 0.005  # with twice the step the difference bends by 1 %
SKY = {"type": "constant", "radiance": rgb(1, 0.8, 0.6)}
POINT = {"type": "point", "position": [1.5, 0.3, 1.2], "intensity": rgb(3, 4, 5)}


def corner(bottom: float, lamp: dict[str, Any] = SKY, normals: torch.Tensor | None = None, **objects: Any) -> rb.Scene:
    """A wall along x = 0 whose lower edge is at this height, and a floor, from above; `normals`: of the wall's vertices."""
    view = sensor(SIZE, (0.6, -0.4, 3), (0.25, 0.1, 0), 20)
    square = torch.tensor([[0.0, -2, bottom], [0, 2, bottom], [0, 2, 1], [0, -2, 1]])
    wall = {"type": "mesh", "vertex_positions": square, "faces": torch.tensor([[0, 1, 2], [0, 2, 3]]),
            "bsdf": {"type": "twosided", "one": diffuse(0.9, 0.7, 0.8)}}
    wall |= {} if normals is None else {"vertex_normals": normals}
    floor = {"type": "rectangle", "to_world": rotate((0, 0, 1), 10) @ scale((3, 3, 1)), "bsdf": diffuse(0.6, 0.8, 0.7)}
    return load(torch.float32, sensor=view, lamp=lamp, floor=floor, wall=wall, **objects)


def aside(vertices: torch.Tensor) -> torch.Tensor:
    return torch.tensor([1.0, 0.0, 0.0]).expand_as(vertices).contiguous()


def difference(scene: rb.Scene, spp: int) -> torch.Tensor:
    """(1, 3, H, W) central difference of images with the same samples."""
    vertices, images = scene.wall.vertex_positions, []
    home = vertices.detach().clone()
    for side in (1, -1):
        vertices.data = home + side * STEP * aside(home)
        images.append(rb.render(scene, spp=spp, seed=5, max_depth=3).detach())
    vertices.data = home
    return (images[0] - images[1]) / (2 * STEP)


def derivative(scene: rb.Scene, seed: int, spp: int = SPP, **settings: Any) -> torch.Tensor:
    tangent = aside(scene.wall.vertex_positions.detach())
    return rb.jvp(scene, {"wall.vertex_positions": tangent}, spp=spp, seed=seed, max_depth=3, **settings)


BLOCKER = {"type": "rectangle", "to_world": translate((0.1, 0.1, 0.3)) @ rotate((0.1, 1, 0), 70) @ scale((0.06, 0.12, 1)),
           "bsdf": {"type": "twosided", "one": diffuse(0.2, 0.3, 0.4)}}
LEANING = torch.nn.functional.normalize(torch.tensor(
    [[1.0, 0.4, 0.2], [1, -0.3, 0.3], [1, -0.4, -0.3], [1, 0.3, -0.2]]), dim=1)
SCENES = {"stands on the floor": (0.0, SKY, {}), "passes through the floor": (-0.7, SKY, {}),
          "above the floor": (0.05, SKY, {}), "before it a plate": (-0.7, SKY, {"plate": BLOCKER}),
          "a sharp shadow on it": (-0.7, POINT, {"plate": BLOCKER}),
          "smoothly shaded": (-0.7, SKY, {"normals": LEANING}),
          "smoothly shaded, a sharp shadow on it": (-0.7, POINT, {"plate": BLOCKER, "normals": LEANING})}
TOGETHER = ("passes through the floor", "before it a plate", "smoothly shaded, a sharp shadow on it")  # as parts of others


@pytest.mark.parametrize("name", deep_but([name for name in SCENES if name not in TOGETHER], SCENES))
def test_light_from_a_wall_that_moves_along_a_floor_is_that_of_differences(name):
    bottom, lamp, objects = SCENES[name]
    scene = corner(bottom, lamp, **objects)
    expected = difference(scene, 16 * SPP).double()
    assert expected.isfinite().all() and expected.abs().max() > 0
    found = torch.stack([derivative(scene, seed) for seed in range(8)]).double()
    weights = expected.sign()
    sums = (found * weights).sum((1, 2, 3, 4))
    noise = float(sums.std()) / len(sums)**0.5
    whole = float(expected.abs().sum())
    assert noise < 0.05 * whole
    assert abs(float(sums.mean()) - whole) < 4 * noise + 0.01 * whole


@pytest.mark.parametrize("name", ["stands on the floor", "passes through the floor", "smoothly shaded"])
def test_no_sample_is_large_next_to_the_line_where_surfaces_meet(name):
    bottom, lamp, objects = SCENES[name]
    scene = corner(bottom, lamp, **objects)
    found = derivative(scene, 1, terms={"interior"}).abs()
    assert found.isfinite().all() and 0 < found.max() < 40 * found.mean()


def quadrilateral(smooth: bool, *corners: tuple[float, float, float]) -> dict[str, Any]:
    return {"type": "mesh", "vertex_positions": torch.tensor(corners), "faces": torch.tensor([[0, 1, 2], [0, 2, 3]]),
            "recompute_normals": smooth}


@pytest.mark.parametrize("smooth", deep_but([False], [False, True]))
def test_at_the_end_of_an_edge_that_touches_a_wall_light_is_that_of_differences(smooth):
    """A floor's edge lies in a wall and ends with it, and both slide along: at the foot both are as bright, but right
    beside the end light changes within less than a thousandth of the floor."""
    view = sensor(4, (0, 0, 4), (-0.9995, 0.994, 0), 0.08)
    scene = load(torch.float32, sensor=view, sky=SKY,
                 floor=quadrilateral(smooth, (-1.0, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)),
                 wall=quadrilateral(smooth, (-1.0, -1, -0.5), (-1, 1, -0.5), (-1, 1, 1.5), (-1, -1, 1.5)))
    home = {f"{name}.vertex_positions": scene.get_submodule(name).vertex_positions.detach().clone()
            for name in ("floor", "wall")}
    step, images = 0.0003, {1: [], -1: []}
    for side, own in images.items():
        for name, vertices in home.items():
            scene.get_parameter(name).data = vertices + side * step * aside(vertices)
        own += [rb.render(scene, spp=1 << 16, seed=10 + seed, max_depth=2).detach() for seed in range(4)]
    for name, vertices in home.items():
        scene.get_parameter(name).data = vertices
    expected = (sum(images[1]) - sum(images[-1])).double().sum((0, 1, 2)) / (2 * step * 4)  # of each column
    tangents = {name: aside(vertices) for name, vertices in home.items()}
    found = sum(rb.jvp(scene, tangents, spp=1024, seed=seed, max_depth=2) for seed in range(4)).double().sum((0, 1, 2)) / 4
    assert expected.isfinite().all() and expected.abs().min() > 0
    assert (found - expected).abs().max() < 0.1 * expected.abs().max(), (found, expected)


CORNERS = ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0))


def corners_of(count: int) -> tuple[Vec3, Vec3, Vec3]:
    """A triangle's, so many times."""
    return tuple(Vec3(*(torch.full((count,), at, dtype=torch.float64) for at in corner)) for corner in CORNERS)


def seen_at(u: torch.Tensor, v: torch.Tensor, start: Vec3) -> tuple[Nearby, Floor]:
    """Points of that triangle as they are seen from surfaces that face along y."""
    zero, plain = torch.zeros_like(u), torch.ones_like(u, dtype=torch.bool)
    reach = Vec3(u, v, zero) - start
    distance = torch.sqrt(dot(reach, reach))
    floor = Floor(start, Vec3(zero, zero + 1.0, zero), plain, zero + 1e-9)
    return Nearby(corners_of(len(u)), u, v, reach * (1.0 / distance), distance, plain), floor


def test_points_slide_past_edges_at_bounded_speed():
    """A point that stays in a fixed direction moves by r / h where that from which it is seen moves by one, h above its
    plane, r away. What edges add counts with this over their distance: at most 1 / h where the foot of h lies farther from
    the edge than the point, for there m falls linearly to the edge."""
    generator = torch.Generator().manual_seed(1)
    height, over, ahead, u = (size * torch.rand(20000, generator=generator, dtype=torch.float64)**power
                              for size, power in ((0.1, 3), (0.2, 3), (0.1, 2), (1.0, 1)))
    u = 0.2 + 0.6 * u * (1.0 - over - ahead)
    near, floor = seen_at(u, over, Vec3(u, over + ahead, height))
    share = slide_at(near, floor).share
    assert (share > 0.3).sum() > 1000 and (near.distance / height).max() > 100
    assert (share * near.distance / over).max() <= 1.0


def any_seen(count: int) -> tuple[Nearby, Floor]:
    """Points seen from places that lie above a triangle, many of them close to it, and to edges."""
    generator = torch.Generator().manual_seed(2)
    foot, point = (torch.sort(torch.rand(2, count, generator=generator, dtype=torch.float64), 0).values for _ in range(2))
    near = 0.01 + 0.99 * torch.rand(count, generator=generator, dtype=torch.float64)**2  # at the foot the share has a tip
    point = foot + (point - foot) * near
    height = 0.4 * torch.rand(count, generator=generator, dtype=torch.float64)**3
    return seen_at(point[0], point[1] - point[0], Vec3(foot[0], foot[1] - foot[0], height))


def test_the_change_of_the_share_is_that_of_differences():
    near, floor = any_seen(20000)
    found, step = slide_at(near, floor), 1e-7
    for by, u, v in ((found.by_u, step, 0.0), (found.by_v, 0.0, step)):
        sides = [slide_at(*seen_at(near.u + sign * u, near.v + sign * v, floor.p)).share for sign in (1.0, -1.0)]
        expected = (sides[0] - sides[1]) / (2.0 * step)
        assert (expected.abs() > 0.1).sum() > 1000
        off = (by - expected).abs() > 1e-3 * expected.abs().clamp_min(1.0)
        assert off.double().mean() < 1e-3  # the share has kinks


def test_turns_and_changes_of_solid_angle_are_bounded():
    """By 2 / (D + h) and 1 / h, with D the distance of the foot from the nearest edge or the end of the reach."""
    near, floor = any_seen(20000)
    slide, start = slide_at(near, floor), floor.p
    reach = 0.5 * 0.5**0.5
    nearest = torch.minimum(torch.minimum(start.x, start.y), (1.0 - start.x - start.y) * 0.5**0.5)
    nearest = torch.minimum(nearest, (reach**2 - start.z**2).clamp_min(0.0).sqrt())
    slides = slide.share > 0.0
    assert slides.sum() > 1000
    assert ((1.0 - slide.share) / near.distance * (nearest + start.z))[slides].max() <= 2.0
    rising = slide.by_u * (near.u - start.x) + slide.by_v * (near.v - start.y)  # times h: where x rises by one
    assert rising.abs()[slides].max() <= 1.0
