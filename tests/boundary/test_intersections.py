"""Where surfaces pass through each other, against closed forms and against all pairs of triangles."""

from __future__ import annotations

import pytest
import torch

from tests.boundary.closed_forms import DARK, GLOW, JUMP, SIZE, along, assert_close, derivative, parallel
from tests.boundary.random_places import triangles
from tests.scenes import diffuse, load, rectangle, rgb
from torch_radbp.boundary.curve import intersections as module
from torch_radbp.boundary.curve.intersections import Bodies, Pairs, intersections, segments_between
from torch_radbp.io.values.transform import rotate, scale, translate
from torch_radbp.tensors.stage import EAGER

DIM = {"emitter": {"type": "area", "radiance": rgb(0.25, 0.25, 0.25)}}


@pytest.mark.parametrize("most", [module.MOST, 64], ids=["at once", "in parts"])
def test_all_pairs_of_triangles_of_two_bodies_that_meet_are_found(most, monkeypatch):
    monkeypatch.setattr(module, "MOST", most)
    geometry, faces, sizes = triangles(120, 3)
    moves = torch.tensor([True, False, False])
    body = torch.repeat_interleave(sizes)
    one, other = torch.triu_indices(120, 120, 1)
    wanted = (body[one] != body[other]) & (moves[body[one]] | moves[body[other]])
    expected = segments_between(geometry, faces, Pairs(one[wanted], other[wanted]))
    found, _ = intersections(EAGER, geometry, Bodies(faces, sizes, moves))
    pairs = [set(zip(own.triangle.tolist(), own.through.tolist())) for own in (found, expected)]
    assert pairs[0] == pairs[1] and len(found.triangle) == len(expected.triangle) > 30


def test_segments_lie_on_both_triangles_and_end_at_an_edge_of_one():
    geometry, faces, sizes = triangles(60, 2)
    found, _ = intersections(EAGER, geometry, Bodies(faces, sizes, torch.tensor([True, True])))
    p = geometry.triangles.vertices.p.stack().view(-1, 3, 3)
    ends_on_edges = torch.zeros(2, len(found.triangle), dtype=torch.bool)
    for place, end in enumerate((found.start, found.end)):
        weights = torch.stack([1 - end.x - end.y, end.x, end.y], 1)
        at = (weights[:, :, None] * p[found.triangle.long()]).sum(1)
        of_other = torch.linalg.solve(p[found.through.long()].transpose(1, 2), at)  # no triangle's plane meets the origin
        assert (of_other.sum(1) - 1).abs().max() < 1e-9
        assert weights.min() > -1e-9 and of_other.min() > -1e-9
        ends_on_edges[place] = (weights.amin(1).abs() < 1e-9) | (of_other.amin(1).abs() < 1e-9)
    assert len(found.triangle) > 10 and ends_on_edges.all()


def test_bodies_that_touch_do_not_pass_through_each_other():
    """A cube that stands on a floor, and two walls with a common edge."""
    scene = load(torch.float64, camera=parallel(), sky=DARK, floor=rectangle((0, 0, 0), 3, bsdf=diffuse(0.5)),
                 cube={"type": "cube", "to_world": translate((0, 0, 0.5)) @ scale((0.5, 0.5, 0.5)), "bsdf": diffuse(0.5)},
                 wall=rectangle((0, 3, 3), 3, (1, 0, 0), 90, bsdf=diffuse(0.5)))
    seen = []
    original = module.segments_on
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "segments_on", lambda *arguments: seen.append(original(*arguments)) or seen[-1])
        derivative(scene, "cube.to_world", along(0), spp=4)
    assert seen and all(len(found.triangle) == 0 for found in seen)


@pytest.mark.parametrize("moving, sign", [("flat", 1), ("steep", -1)])
def test_the_line_where_two_sheets_cross_moves_with_either(moving, sign):
    """A steep sheet, 45 degrees, higher on the right, hides a level one there: raised by d, that one hides d more of it."""
    scene = load(torch.float64, camera=parallel(), sky=DARK, flat=rectangle((0, 0, 0.05), 9, **GLOW),
                 steep=rectangle((0, 0, 0), 9, (0, 1, 0), -45, **DIM))
    expected = sign * JUMP * SIZE / (2 / SIZE)
    assert_close(derivative(scene, f"{moving}.to_world", along(2), spp=256), expected, 0.02)


def test_what_instances_show_crosses_too():
    sheet = rectangle((0, 0, 0), 9, (0, 1, 0), -45, **DIM)
    found = []
    for shown in (False, True):
        things = {"steep": sheet} if not shown else {
            "group": {"type": "shapegroup", "sheet": {key: value for key, value in sheet.items() if key != "emitter"} | {
                "bsdf": diffuse(0.0)}},
            "steep": {"type": "instance", "group": {"type": "ref", "id": "group"}, "to_world": rotate((0, 0, 1), 0)}}
        scene = load(torch.float64, camera=parallel(), sky=DARK, flat=rectangle((0, 0, 0.05), 9, **GLOW), **things)
        found.append(derivative(scene, "steep.to_world", along(2), spp=256))
    pixel = torch.tensor([3.0, 2.0, 1.0], dtype=torch.float64) * SIZE / (2 / SIZE)
    assert_close(found[0], -JUMP * SIZE / (2 / SIZE), 0.02)
    assert_close(found[1], -pixel, 0.02)
