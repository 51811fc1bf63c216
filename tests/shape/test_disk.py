"""The tessellation of the disk: an exact area, and directions of u that follow the angle."""

import math

import torch

import torch_radbp as rb
from tests.io.documents import scene_dict
from torch_radbp.shape.disk import RINGS, SECTORS


def corners() -> tuple[torch.Tensor, torch.Tensor]:
    """Positions (F, 3, 3) and coordinates (F, 3, 2) of the corners of all triangles of the unit disk."""
    surface = rb.load_dict(scene_dict(disk={"type": "disk"})).disk.triangles()
    return surface.vertices.double()[surface.faces], surface.uv.double()[surface.faces]


def test_triangles_cover_a_disk_of_exact_area_once():
    p, _ = corners()
    areas = torch.linalg.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])[:, 2] / 2
    assert (areas > 0).all() and abs(float(areas.sum()) / math.pi - 1) < 1e-6
    assert p.norm(dim=-1).max() < 1.001


def test_u_grows_away_from_the_centre_through_the_middle_of_each_triangle():
    """As on an ideal disk in the mean over a triangle, so that the highlights of brushed metal are where they belong; the
    halves of triangles at the seam are off by a quarter of a sector at most."""
    p, uv = corners()
    edges, changes = ((each[:, 1:] - each[:, :1]) for each in (p, uv))
    growth, middle = torch.linalg.solve(changes, edges)[:, 0], p.mean(1)
    angle = torch.atan2(torch.linalg.cross(middle, growth)[:, 2], (middle * growth).sum(1)).abs()
    assert (angle > 1e-4).sum() <= 2 * RINGS
    assert angle.max() < 2 * math.pi / SECTORS / 4


def test_coordinates_are_radius_and_angle():
    p, uv = corners()
    away_from_centre = uv[..., 0] > 0
    angle = torch.atan2(p[..., 1], p[..., 0])[away_from_centre] / (2 * math.pi) % 1
    difference = (angle - uv[..., 1][away_from_centre] + 0.5) % 1 - 0.5
    assert difference.abs().max() < 1e-6
    assert ((p.norm(dim=-1) - uv[..., 0]).abs() < 1e-3).all()
