"""Where bodies pass through themselves is found once: for all instances, for views and shadows, and until vertices move."""

from __future__ import annotations

import pytest
import torch

from tests.boundary.closed_forms import DARK, parallel
from tests.gradients import unwarned_renderer
from tests.scenes import diffuse, load
from tests.scenes.meshes import crossing_sheets
from torch_radbp.boundary.curve import passing, single_bodies
from torch_radbp.boundary.curve.segments import Segments
from torch_radbp.io.values.transform import scale, translate


@pytest.fixture
def looked(monkeypatch) -> list:
    """One entry for each time that bodies are looked at."""
    found, look = [], single_bodies.self_intersections
    monkeypatch.setattr(single_bodies, "self_intersections", lambda *args: found.append(look(*args)) or found[-1])
    return found


@pytest.fixture
def shown(monkeypatch) -> list[Segments]:
    """The segments of all instances, for each time that these are asked for."""
    found, show = [], passing.shown_by_all
    monkeypatch.setattr(passing, "shown_by_all", lambda *args: found.append(show(*args)) or found[-1])
    return found


def sheets(size: int) -> dict:
    """Two sheets that cross, of a mesh that reflects."""
    mesh, _ = crossing_sheets(size)
    return {"type": "mesh", "vertex_positions": mesh["vertex_positions"], "faces": mesh["faces"], "bsdf": diffuse(0.5)}


def test_all_instances_have_the_curves_of_their_group(looked, shown):
    poses = {f"shown{k}": {"type": "instance", "shapegroup": {"type": "ref", "id": "group"}, "to_world":
                           translate((0.5 * k - 0.5, 0, 0)) @ scale((0.1 + 0.1 * k, 0.1, 0.1))} for k in range(3)}
    scene = load(torch.float64, camera=parallel(), sky=DARK, group={"type": "shapegroup", "sheets": sheets(4)}, **poses)
    moving = [scene.get_parameter(f"shown{k}.to_world").requires_grad_() for k in range(3)]
    renderer = unwarned_renderer(scene, spp=4, max_depth=2)
    for seed in range(3):
        renderer(seed=seed).sum().backward()
        for pose in moving:
            pose.data[0, 3] += 0.01
    assert len(looked) == 1 and len(looked[0].triangle) >= 8  # poses change nothing in the group
    for segments in shown:
        own = [[(int(one), int(other)) for one, other, instance, by in zip(
            segments.triangle, segments.through, segments.instance, segments.shown_by) if instance == by == number]
            for number in range(4)]
        assert own[1] == own[2] == own[3] and len(own[1]) == len(looked[0].triangle) and not own[0]


def test_views_and_shadows_look_once_for_what_moves(looked):
    scene = load(torch.float64, camera=parallel(), sky=DARK, sheets=sheets(2))
    vertices = scene.get_parameter("sheets.vertex_positions").requires_grad_()
    renderer = unwarned_renderer(scene, spp=4, max_depth=2)
    for seed in range(2):
        renderer(seed=seed).sum().backward()
        vertices.data[:, 0] += 0.01
    assert len(looked) == 2 and all(len(segments.triangle) > 2 for segments in looked)


def test_other_seeds_look_at_other_edges_of_what_may_move(looked, monkeypatch):
    monkeypatch.setattr(single_bodies, "edges_looked_at", lambda call: 40)
    scene = load(torch.float64, camera=parallel(), sky=DARK, sheets=sheets(8))
    scene.get_parameter("sheets.vertex_positions").requires_grad_()
    renderer = unwarned_renderer(scene, spp=4, max_depth=1)
    for seed in (0, 0, 1):
        renderer(seed=seed)
    assert len(looked) == 2
