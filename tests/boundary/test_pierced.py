"""Where bodies pass through themselves, against closed forms and against all pairs of triangles."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

import pytest
import torch

from tests.boundary.closed_forms import DARK, JUMP, SIZE, assert_close, derivative, parallel
from tests.boundary.random_places import triangles
from tests.gradients import unwarned_renderer
from tests.scenes import load
from tests.scenes.meshes import crossing_sheets
from torch_radbp.boundary.curve import pierced as module
from torch_radbp.boundary.curve.edges import edges_of
from torch_radbp.boundary.curve.faces import Faces
from torch_radbp.boundary.curve.geometry import Geometry
from torch_radbp.boundary.curve.intersections import Pairs, segments_between
from torch_radbp.boundary.curve.pierced import BodyEdges, Probes, probes, self_intersections
from torch_radbp.boundary.curve.segments import Segments
from torch_radbp.raycast.brute import Brute
from torch_radbp.tensors.stage import EAGER

CELL = 2.0 / SIZE


def meeting(geometry: Geometry, faces: Faces) -> set[tuple[int, int]]:
    """All pairs of triangles that meet, the lesser number first."""
    pairs = torch.triu_indices(len(faces.triangle), len(faces.triangle), 1)
    return set(pairs_of(segments_between(geometry, faces, Pairs(*pairs))))


def pairs_of(segments: Segments) -> list[tuple[int, int]]:
    return [tuple(sorted(pair)) for pair in zip(segments.triangle.tolist(), segments.through.tolist())]


def of_edges(geometry: Geometry, looked_at: Callable[[int], Probes], sizes: torch.Tensor) -> Segments:
    p, corners = geometry.triangles.vertices.p.stack(), torch.stack(geometry.triangles.corners, 1)
    edges = edges_of(p, corners)
    return self_intersections(Brute(p, corners), EAGER, geometry, BodyEdges(edges, None), looked_at(len(edges.a)),
                              sizes.cumsum(0))


def test_all_triangles_that_meet_are_found_once():
    geometry, faces, sizes = triangles(60, 1)
    found = of_edges(geometry, lambda count: probes(count, 1000, torch.Generator()), sizes)
    expected = meeting(geometry, faces)
    assert len(expected) > 60 and sorted(pairs_of(found)) == sorted(expected) and found.share is None


def test_each_edge_finds_the_triangles_that_it_pierces():
    """Edges that are looked at one after the other find every pair twice, from either end of its segment."""
    geometry, faces, sizes = triangles(60, 1)
    counts, expected = Counter(), meeting(geometry, faces)
    for edge in range(180):
        found = of_edges(geometry, lambda count, edge=edge: Probes(torch.tensor([edge]), 1 / count), sizes)
        if found is not None:
            assert ((found.share * 180 - 2).abs() < 1e-9).all()
            counts.update(pairs_of(found))
    assert counts == Counter(dict.fromkeys(expected, 2))


def test_other_shapes_are_left_to_pairs_of_bodies():
    geometry, _, sizes = triangles(120, 2)
    found = of_edges(geometry, lambda count: probes(count, 1000, torch.Generator()), sizes)
    assert len(found.triangle) > 20 and ((found.triangle < 60) == (found.through < 60)).all()


def test_edges_are_looked_at_as_often_as_their_share_says():
    generator = torch.Generator().manual_seed(0)
    counts = torch.zeros(100, dtype=torch.int64)
    for _ in range(4000):
        some = probes(100, 7, generator)
        counts += some.edge.bincount(minlength=100)
    assert some.share == 0.07
    assert (counts - 280).abs().max() < 5 * 280 ** 0.5


@pytest.mark.parametrize("size", [1, 16])
@pytest.mark.parametrize("part, sign", [("level", 1), ("steep", -1)])
def test_the_line_where_two_sheets_of_a_mesh_cross_moves_with_either(part, sign, size):
    """The steep sheet hides the level one on the right: raised by d, it hides d more of that."""
    mesh, steep = crossing_sheets(size)
    scene = load(torch.float64, camera=parallel(), sky=DARK, sheets=mesh)
    found = derivative(scene, "sheets.vertex_positions", raised(steep == (part == "steep")), spp=64)
    assert_close(found, sign * JUMP * SIZE / CELL, 0.02)


def test_where_few_edges_are_looked_at_they_count_for_all(monkeypatch):
    monkeypatch.setattr(module, "FEWEST", 600)
    monkeypatch.setattr(module, "MOST", 600)
    mesh, steep = crossing_sheets(24)
    scene = load(torch.float64, camera=parallel(), sky=DARK, sheets=mesh)
    parameter, direction = scene.get_parameter("sheets.vertex_positions").requires_grad_(), raised(steep)
    renderer = unwarned_renderer(scene, spp=16, max_depth=1)
    found = torch.stack([(torch.autograd.grad(renderer(seed=seed)[0, 0].sum(), parameter)[0] * direction).sum()
                         for seed in range(24)])
    expected, error = -JUMP[0] * SIZE / CELL, found.std() / 24 ** 0.5
    assert 0.02 * expected.abs() < error < 0.15 * expected.abs()
    assert (found.mean() - expected).abs() < 3.5 * error, (found.mean(), expected, error)


def raised(which: torch.Tensor) -> torch.Tensor:
    """(V, 3) the direction in which some vertices rise."""
    return torch.stack([torch.zeros_like(which), torch.zeros_like(which), which], 1).double()
