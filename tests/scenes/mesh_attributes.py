"""Meshes with attributes."""

from __future__ import annotations

from typing import Any

import torch

import torch_radbp as rb

PLY = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
property float r
property float g
property float b
property float rough_x
element face 2
property list uchar int vertex_indices
property float tint_r
property float tint_g
property float tint_b
property float amount_1
end_header
-1 -1 0 0.1 0.2 0.3 0.5
1 -1 0 0.4 0.2 0.3 0.6
1 1 0.5 0.1 0.7 0.3 0.7
-1 1 0 0.1 0.2 0.9 0.8
3 0 1 2 0.1 0.2 0.3 0.25
3 0 2 3 0.4 0.5 0.6 0.75
"""


def tetrahedron(**attributes: Any) -> dict[str, Any]:
    """A closed mesh with surface coordinates."""
    vertices = [[0.0, 0.7, 0], [-0.6, -0.4, 0.5], [0.7, -0.4, 0.4], [0.1, -0.4, -0.7]]
    faces = [[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]]
    texcoords = [[0.1, 0.2], [0.9, 0.1], [0.4, 0.8], [0.7, 0.6]]
    return {"type": "mesh", "vertex_positions": vertices, "faces": faces, "vertex_texcoords": texcoords} | attributes


def panel(**attributes: Any) -> dict[str, Any]:
    """A quadrilateral that is not flat, with surface coordinates, which faces +z."""
    vertices = [[-0.6, -0.6, 0.1], [0.7, -0.5, -0.1], [0.6, 0.7, 0.1], [-0.6, 0.6, 0.0]]
    texcoords = [[0.11, 0.23], [1.31, 0.07], [1.17, 1.42], [-0.21, 1.13]]
    mesh = {"type": "mesh", "vertex_positions": vertices, "faces": [[0, 1, 2], [0, 2, 3]], "vertex_texcoords": texcoords}
    return mesh | attributes


def add_attributes(scene: rb.Scene) -> rb.Scene:
    """Gives the `subject` colours of vertices between 0.2 and 0.8, and amounts of faces above 0.6."""
    generator = torch.Generator().manual_seed(0)
    subject = scene.subject
    subject.add_attribute("vertex_color", 0.2 + 0.6 * torch.rand(subject.vertex_count, 3, generator=generator))
    subject.add_attribute("face_amount", 0.6 + 0.3 * torch.rand(len(subject.faces), 3, generator=generator))
    return scene
