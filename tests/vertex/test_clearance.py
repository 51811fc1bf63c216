"""Rays start just far enough off a surface not to meet it, at any scale and place that float32 can carry."""

import pytest
import torch

from torch_radbp.raycast import make_caster
from torch_radbp.scene.tables.triangle_corners import at_corners, clearance, edges
from torch_radbp.tensors.vec import Ray, Vec3, cross, dot, normalize, unit_normal
from torch_radbp.vertex.interaction import interpolated

PLACES = {"at the origin": (0.0, 0.0, 0.0), "100 sizes away": (100.0, 30.0, -50.0), "1000 sizes away": (1e3, 300.0, -500.0)}


def tilted_sheet(points: int, size: float, place: tuple) -> tuple[torch.Tensor, torch.Tensor]:
    """Vertices and faces of a tilted plane; with more than two points a side its triangles differ in size by 3000."""
    generator = torch.Generator().manual_seed(3)
    steps = torch.exp(8 * torch.rand(2, points, generator=generator, dtype=torch.float64)).cumsum(1)
    x, y = (steps - steps.mean(1, keepdim=True)) / steps.std(1, keepdim=True)
    flat = torch.stack([*torch.meshgrid(x, y, indexing="ij"), torch.zeros(points, points, dtype=torch.float64)], -1)
    turn = torch.linalg.qr(torch.randn(3, 3, generator=generator, dtype=torch.float64))[0]
    vertices = size * (flat.reshape(-1, 3) @ turn + torch.tensor(place, dtype=torch.float64))
    corner = (torch.arange(points - 1)[:, None] * points + torch.arange(points - 1)).reshape(-1)
    faces = torch.cat([torch.stack([corner, corner + points, corner + 1], 1),
                       torch.stack([corner + 1, corner + points, corner + points + 1], 1)])
    return vertices.float(), faces.int()


def departures_that_return(points: int, size: float, place: tuple, factor: float = 1.0, lanes: int = 50_000) -> float:
    """The fraction of rays leaving a sheet, on either side, that meet it."""
    vertices, faces = tilted_sheet(points, size, place)
    caster = make_caster("embree", vertices, faces)
    generator = torch.Generator().manual_seed(4)

    def directions() -> Vec3:
        return normalize(Vec3.of(torch.randn(lanes, 3, generator=generator)))

    # See the sheet from somewhere between a tenth of its size and a hundred sizes away.
    at = at_corners(Vec3.of(vertices), faces[torch.randint(len(faces), (lanes,), generator=generator)].unbind(1))
    target, away = interpolated(at, torch.full((lanes,), 0.3), torch.full((lanes,), 0.4)), directions()
    distance = size * 10 ** (3 * torch.rand(lanes, generator=generator) - 1)
    hit = caster.intersect(Ray(target + away * distance, -away))
    seen = hit.prim >= 0
    assert seen.float().mean() > 0.98

    # Leave it on a side picked at random.
    corners = at_corners(Vec3.of(vertices), faces[hit.prim.clamp_min(0).long()].unbind(1))
    p0, e1, e2 = edges(*corners)
    n, d = unit_normal(e1, e2), directions()
    o = p0 + e1 * hit.u + e2 * hit.v + n * (torch.sign(dot(n, d)) * factor * clearance(corners))
    return float(((caster.intersect(Ray(o, d)).prim >= 0) & seen).float().mean())


@pytest.mark.parametrize("size", [1e-4, 1.0, 1e5])
@pytest.mark.parametrize("place", PLACES.values(), ids=PLACES)
def test_rays_that_leave_a_quad_do_not_meet_it(size, place):
    assert departures_that_return(2, size, place) == 0


@pytest.mark.parametrize("size", [1e-4, 1.0, 1e5])
def test_rays_that_leave_a_triangle_do_not_meet_neighbours_of_another_size(size):
    # Rounding of the vertices tilts neighbours against each other: a grazing ray may meet one.
    assert departures_that_return(40, size, PLACES["at the origin"]) < 1e-4
    assert departures_that_return(40, size, PLACES["at the origin"], factor=0.0) > 0.4


def test_the_distance_is_not_larger_than_it_must_be():
    assert departures_that_return(2, 1.0, PLACES["at the origin"], factor=1 / 16) > 1e-3


def test_the_distance_is_relative_to_the_coordinates_and_constant_around_them():
    corners = tuple(Vec3.of(corner) for corner in torch.rand(3, 7, 3, dtype=torch.float64))
    distance = clearance(corners)
    assert torch.equal(clearance(tuple(corner * 1024.0 for corner in corners)), 1024 * distance)
    assert torch.equal(clearance(tuple(corner * (1 + 1e-9) for corner in corners)), distance)
    largest = torch.stack([component for corner in corners for component in corner]).amax(0)
    assert ((distance >= 16 * 2.0**-24 * largest) & (distance <= 32 * 2.0**-24 * largest)).all()
    assert torch.isfinite(clearance(tuple(corner * 0.0 for corner in corners))).all()


def test_distances_have_no_derivative():
    corners = tuple(Vec3(*torch.rand(3, 4).requires_grad_().unbind(0)) for _ in range(3))
    assert not clearance(corners).requires_grad and cross(*corners[:2]).x.requires_grad
