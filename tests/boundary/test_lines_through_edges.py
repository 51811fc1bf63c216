"""What counts of edges that are seen from close by; and no triangle takes its own for silhouettes."""

import math

import pytest
import torch

import torch_radbp as rb
from tests.scenes import diffuse, load, rectangle, sensor
from tests.scenes.meshes import wavy
from torch_radbp.boundary.curve.geometry import Between, geometry_of, positions
from torch_radbp.boundary.eye.eyes import Eyes
from torch_radbp.boundary.eye.lines_through_edges import solid_angle
from torch_radbp.boundary.eye.seen_edges import corners_of, places_seen
from torch_radbp.boundary.terms import cuts as cuts_module
from torch_radbp.boundary.terms import hidden_light
from torch_radbp.boundary.terms.cuts import Cuts, cut_at, cut_course
from torch_radbp.io.values.transform import rotate, scale, translate
from torch_radbp.jit.stages import compiled
from torch_radbp.sampling.sampler import SampleKey
from torch_radbp.scene.tables.scene_tensors import extent_of
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.stage import EAGER
from torch_radbp.tensors.vec import Ray, Vec2, dot, interpolated, normalize, rows, unit_normal

GREY = diffuse(0.5, 0.5, 0.5)


def asked_of(name: str, monkeypatch, dtype: torch.dtype, size: float, floor: float, module=hidden_light) -> tuple:
    """The arguments that a rendering of waves of some size above a floor of some half width calls a function of
    a module with, and what this returns."""
    found, function = [], getattr(module, name)

    def noted(*arguments):
        found.append((*arguments, function(*arguments)))
        return found[-1][-1]

    monkeypatch.setattr(module, name, noted)
    pose = translate((0.13, -0.21, 0.6)) @ rotate((1, 0.7, 0.4), 20) @ scale((size, size, size))
    scene = load(sensor=sensor(32, (0, -1.5, 2.5)), sky={"type": "constant", "radiance": 1.0},
                 floor=rectangle((0, 0, 0), floor, bsdf=GREY),
                 group={"type": "shapegroup", "waves": wavy() | {"bsdf": GREY}},
                 shown={"type": "instance", "group": {"type": "ref", "id": "group"}, "to_world": pose}).to(dtype)
    rb.jvp(scene, {"shown.to_world": 0.1 * torch.eye(4, dtype=dtype)}, spp=64, max_depth=3)
    return found[0]


@pytest.mark.parametrize("stages", [EAGER, compiled()], ids=["eager", "compiled"])
def test_no_triangle_of_an_instance_takes_its_own_edges_for_silhouettes(stages, monkeypatch):
    """Close to an edge, a point lies as far off its plane as rounding has it, and loops round otherwise than plain torch."""
    _, geometry, casting, *_ = asked_of("places_seen", monkeypatch, torch.float32, 0.1, 1.0)
    edges, shown = casting.outline.edges, casting.outline.instance
    inner = (shown > 0) & (edges.count == 2)
    triangle, instance = torch.div(edges.corner[0], 3, rounding_mode="floor")[inner], shown[inner]
    corners = positions(geometry, Between(*lookup(geometry.triangles.corners, triangle)), instance)
    side, near, one = torch.arange(len(triangle)) % 3, 0.01, torch.ones(len(triangle), dtype=torch.float64)
    u, v = (torch.where(side == 0, *at) for at in ((near, 0.1 * one), (0.1 * one, near)))
    v = torch.where(side == 2, 1.0 - u - near, v)
    n = unit_normal(corners[1] - corners[0], corners[2] - corners[0])
    eyes = Eyes(interpolated(corners, u, v), one, n, one, 0.1 * one)
    key = SampleKey(torch.tensor(1, dtype=torch.int32), torch.tensor(-1, dtype=torch.int32))
    found = places_seen(stages, geometry, casting, eyes, key, 64, 1 << 16)
    eye, edge = found.eye.long(), found.edge.long()
    meet = torch.stack([torch.div(corner[edge], 3, rounding_mode="floor") for corner in edges.corner])
    assert len(triangle) > 100 and len(eye.unique()) == len(triangle)
    assert not ((meet == triangle[eye]).any(0) & (shown[edge] == instance[eye])).any()


def test_places_count_for_no_more_than_the_angle_that_their_edges_sweep(monkeypatch):
    """Radiance is at most 1, and surfaces scatter 0.5 / pi times its cosine. On a wide floor rays pass edges at a distance
    from which planes that lie edge-on behind these look otherwise."""
    _, geometry, casting, points, at, passed, hit, _, found = asked_of("all_cuts", monkeypatch, torch.float64, 0.7, 300.0,
                                                                                cuts_module)
    nothing = hit._replace(prim=torch.full_like(hit.prim, -1))
    basis, across, _ = EAGER(cut_course)(geometry, casting.outline, at, passed, nothing, extent_of(geometry))

    def swept(cuts: Cuts, normal: Vec2) -> torch.Tensor:
        here, moved = (cut_at(geometry, casting.outline, at, cuts, off=off) for off in (None, passed.outwards * 1e-9))
        return ((moved.x - here.x) * normal.x + (moved.y - here.y) * normal.y).abs()

    corners = rows(corners_of(geometry, points.hit), passed.eye)
    cosine = dot(unit_normal(corners[1] - corners[0], corners[2] - corners[0]), normalize(passed.p - rows(at, passed.eye)))
    most = cosine.abs() * (0.5 / math.pi) * swept(found.cuts._replace(hit=nothing, basis=basis), across)
    counted = found.strength.abs() * swept(found.cuts, found.normal)
    assert (most > 0).all() and (counted > 0).any(0).sum() > 1000
    assert (counted <= 1.001 * most * torch.stack(tuple(rows(points.beta, passed.eye)))).all()


def test_nothing_of_a_triangle_is_seen_from_within_its_plane(monkeypatch):
    """By rounding lines within a plane meet it somewhere, and as slowly as they come near it, as fast moves that place."""
    scene, hit, line, found = asked_of("solid_angle", monkeypatch, torch.float64, 0.7, 1.0)
    lies = hit.prim >= 0
    hit, line, found = rows((hit, line, found), lies.nonzero().squeeze(1))
    corners, generator = corners_of(geometry_of(scene), hit), torch.Generator().manual_seed(1)
    weights = torch.rand(4, len(hit.prim), generator=generator, dtype=torch.float64)
    start, end = interpolated(corners, *weights[:2]), interpolated(corners, *weights[2:])
    n = unit_normal(corners[1] - corners[0], corners[2] - corners[0])
    assert len(hit.prim) > 1000 and (found > 0).double().mean() > 0.9
    for height, sees in ((0.0, False), (1e-12, False), (1e-4, True)):
        seen = solid_angle(scene, hit, Ray(start + n * height, end - start - n * height))
        assert ((seen > 0) == sees).all()
        assert (dot(n, start + n * height - corners[0]).abs() > 0).any()
