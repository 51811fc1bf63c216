"""The cylinder: what it is built of, and what is refused. Normals and uv: `test_like_mitsuba.py`."""

import math

import pytest
import torch

import torch_radbp as rb
from tests.scenes import load, sensor
from torch_radbp.io.values.transform import rotate, translate


def cylinder(**attributes) -> torch.nn.Module:
    return load(sensor=sensor(2), sky={"type": "constant"}, shape={"type": "cylinder"} | attributes).shape


def area(surface) -> float:
    first, second, third = surface.vertices[surface.faces].unbind(1)
    return float(torch.linalg.cross(second - first, third - first).norm(dim=1).sum() / 2)


def test_its_area_is_exact():
    """So that an area light on it has the power that it should."""
    assert area(cylinder().triangles()) == pytest.approx(2 * math.pi, rel=1e-6)
    between = cylinder(p0=[1, 2, 3], p1=[1, 2, 5.5], radius=0.3)
    assert area(between.triangles()) == pytest.approx(2 * math.pi * 0.3 * 2.5, rel=1e-6)


def test_vertices_are_on_it_but_for_the_stated_deviation():
    p0, p1 = torch.tensor([0.1, 0.2, -0.9], dtype=torch.float64), torch.tensor([0.5, 0.9, 0.8], dtype=torch.float64)
    surface = cylinder(p0=p0, p1=p1, radius=0.5).triangles()
    middles = surface.vertices[surface.faces[:, :2]].mean(1)
    axis = (p1 - p0) / (p1 - p0).norm()
    for points in (surface.vertices, middles):
        off = points - p0 - ((points - p0) @ axis)[:, None] * axis
        assert ((off.norm(dim=1) / 0.5 - 1).abs() < 1.3e-5).all()
    height = (surface.vertices - p0) @ axis / (p1 - p0).norm()
    torch.testing.assert_close(height, surface.uv[:, 1], rtol=0, atol=1e-6)


def test_points_and_pose_make_one_pose():
    pose = translate((0.4, -0.1, 0.2)) @ rotate((1, 2, 3), 50)
    p0, p1, radius = [0.1, 0.2, -0.9], [0.5, 0.9, 0.8], 0.5
    inside = cylinder(p0=p0, p1=p1, radius=radius).to_world
    both = cylinder(p0=p0, p1=p1, radius=radius, to_world=pose).to_world
    torch.testing.assert_close(both, torch.as_tensor(pose) @ inside, rtol=0, atol=1e-6)
    assert torch.equal(cylinder().to_world, torch.eye(4, dtype=torch.float64))


@pytest.mark.parametrize("attributes, message", [
    ({"p1": [0, 0, 0]}, "p0 and p1 must differ, got"),
    ({"radius": 0.0}, "radius must be greater than 0 and finite, got 0"),
    ({"radius": -1.0}, "radius must be greater than 0"),
    ({"p0": [0, float("nan"), 0]}, "p0 must be finite"),
    ({"height": 2.0}, "cylinder has no attribute 'height'; known: bsdf, emitter, exterior, "),
])
def test_bad_attributes(attributes, message):
    with pytest.raises(rb.SceneError, match=message):
        cylinder(**attributes)
