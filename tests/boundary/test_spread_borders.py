"""Borders of sharp shadows that run past vertices of paths: in a corner, a plate before a point light."""

import math

import pytest
import torch

import torch_radbp as rb
from tests.scenes import load, rectangle, sensor
from tests.scenes.crossings import GREY
from torch_radbp.boundary.curve.geometry import geometry_of
from torch_radbp.boundary.eye.lit_behind import lit_surfaces
from torch_radbp.boundary.eye.seen_edges import Passed, corners_of, crossed_at, point_of_edge
from torch_radbp.boundary.terms import bounced
from torch_radbp.boundary.terms.spread_borders import planes_met, spread_borders
from torch_radbp.io.values.transform import rotate, scale, translate
from torch_radbp.tensors.vec import Ray, Vec3, angle_between, cross, dot, interpolated, normalize, rows, unit_normal

STEP = 1e-6
LAMPS = {"point": {"type": "point", "position": [0.2, -0.9, 1.3]},
         "directional": {"type": "directional", "direction": [-0.2, 0.7, -0.9]}}


@pytest.fixture(params=LAMPS)
def spread(request, monkeypatch):
    """The arguments that a rendering calls `spread_borders` with, and what this returns."""
    found, function = [], bounced.spread_borders

    def noted(*arguments):
        found.append((*arguments, function(*arguments)))
        return found[-1][-1]

    monkeypatch.setattr(bounced, "spread_borders", noted)
    plate = translate((0.1, 0.1, 0.5)) @ rotate((1, 0.3, 0.2), 25) @ scale((0.4, 0.25, 1))
    scene = load(sensor=sensor(32, (0.3, -2.5, 1.5)), lamp=LAMPS[request.param], floor=rectangle((0, 0, 0), 1.0, **GREY),
                 wall=rectangle((0, 1, 0), 1.0, (1, 0, 0), 90, **GREY),
                 plate=GREY | {"type": "rectangle", "to_world": plate})
    rb.jvp(scene.double(), {"plate.to_world": 0.1 * torch.eye(4, dtype=torch.float64)}, spp=128, max_depth=3)
    return found[0]


def turns(call, outline, lit, passed: Passed, start: Vec3, corners) -> torch.Tensor:
    """Angles by which borders on planes are seen to turn for each share of the way along edges."""
    own, geometry = rows(lit.eyes, passed.eye), geometry_of(call.scene)

    def towards(along: torch.Tensor) -> Vec3:
        p = point_of_edge(geometry, outline, passed.edge, along)
        line = Ray(p, p * own.w - own.place)
        return normalize(interpolated(corners, *crossed_at(corners, line)) - start)

    return angle_between(towards(passed.along - STEP), towards(passed.along + STEP)) / (2 * STEP)


def beyond(call, passed: Passed) -> tuple:
    """The corners and unit normals of what lies beyond places on edges, and whether there is anything."""
    hit = call.integrand.caster.intersect(passed.onwards)
    corners = corners_of(geometry_of(call.scene), hit)
    return corners, unit_normal(corners[1] - corners[0], corners[2] - corners[0]), hit.prim >= 0


def densities(lit, outline, call, passed: Passed) -> torch.Tensor:
    """Of places that are spread along their edges as the light has it."""
    own, geometry = rows(lit.eyes, passed.eye), geometry_of(call.scene)
    a, b, p = (point_of_edge(geometry, outline, passed.edge, along) * own.w - own.place
               for along in (torch.zeros_like(passed.along), torch.ones_like(passed.along), passed.along))
    area = torch.sqrt(dot(cross(a, b), cross(a, b)))
    return torch.where(own.w > 0, area / (dot(p, p) * angle_between(normalize(a), normalize(b))), 1.0)


def test_no_border_counts_for_more_than_the_angle_under_which_it_may_be_seen(spread):
    """That is at most a half turn, and one of three places is spread by it; from points close to the border, too, which
    places that stay count for the more the closer they are."""
    call, outline, lit, _, choice, turn, _ = spread
    geometry, generator = geometry_of(call.scene), torch.Generator().manual_seed(1)
    corners, _, _ = beyond(call, lit.passed)
    met = interpolated(corners, *crossed_at(corners, Ray(lit.passed.p, lit.passed.onwards.d.map(torch.Tensor.double))))
    off = torch.randn(4, len(choice), generator=generator, dtype=torch.float64)
    start = met + normalize(Vec3(*off[:3])) * 10.0**(off[3] - 2.0)
    moved, largest = spread_borders(call, outline, lit, start, choice, turn), []
    whole = lit.passed.times * densities(lit, outline, call, lit.passed)
    for passed in (lit.passed, moved):
        corners, n, met = beyond(call, passed)
        on_plane = torch.zeros_like(met)
        for other, exists in planes_met(call, geometry, outline, lit):
            across = unit_normal(other[1] - other[0], other[2] - other[0])
            on_plane |= exists & (dot(n, across).abs() > 1 - 1e-9) & (dot(n, other[0] - corners[0]).abs() < 1e-9)
        counts = on_plane & met & (dot(n, start - corners[0]).abs() > 1e-3)
        assert counts.sum() > 100
        counted = passed.times * turns(call, outline, lit, passed, start, corners) / whole
        largest.append(float(counted[counts].max()))
    assert largest[1] <= 3.01 * math.pi < 100 < largest[0]


def test_places_that_are_moved_stand_for_as_much_of_their_edges(spread):
    _, _, lit, *_, moved = spread
    assert (moved.along != lit.passed.along).sum() > 500  # those whose shadows fall on something
    for power in range(3):
        before, after = (passed.times * passed.along**power for passed in (lit.passed, moved))
        assert before.sum() > 0
        noise = float((before - after).std()) * len(before)**0.5
        assert noise < 0.1 * float(before.sum())
        assert abs(float((before - after).sum())) < 4 * noise


def test_moved_places_lie_on_their_edges_beside_which_rays_pass(spread):
    call, outline, _, _, _, _, moved = spread
    p = point_of_edge(geometry_of(call.scene), outline, moved.edge, moved.along)
    assert torch.equal(p.stack(), moved.p.stack()) and ((moved.along >= 0) & (moved.along <= 1)).all()
    off = moved.onwards.o - p
    assert dot(off, off).max() < 1e-8
    assert len(lit_surfaces(call, outline, moved)[0]) > 100
