"""Losses for smooth meshes; their derivatives have no noise."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.optim.adjacency import neighbours_of, unique_edges, welded_vertices
from torch_radbp.optim.large_steps import laplacian
from torch_radbp.tensors.vec import TINY


def laplacian_loss(vertices: Tensor, faces: Tensor) -> Tensor:
    """The mean squared distance of vertices from the mean of their neighbours.

    Args:
        vertices: (V, 3), world or group units, attached. Those at one place are one.
        faces: (F, 3) integers.

    Returns:
        A scalar, in squared units.

    Reference: Sorkine 2005, "Laplacian Mesh Processing", section 2 (uniform weights).
    """
    place, count = welded_vertices(vertices)
    edges = unique_edges(place[faces.long()])
    members = torch.bincount(place, minlength=count)[:, None]
    at = vertices.new_zeros(count, 3).index_add(0, place, vertices) / members
    degree = torch.bincount(edges.flatten(), minlength=count).clamp_min(1)[:, None]
    return (laplacian(edges, at) / degree).square().sum(1).mean()


def normal_consistency_loss(vertices: Tensor, faces: Tensor) -> Tensor:
    """The mean of 1 - cos of the angle between the normals of triangles that share an edge.

    Args:
        vertices: (V, 3), attached. Those at one place are one.
        faces: (F, 3) integers, wound alike.

    Returns:
        A scalar from 0, flat, to 2; 0 for a mesh without a shared edge.
    """
    corners = vertices[faces.long()]
    normal = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal = normal / normal.norm(dim=1, keepdim=True).clamp_min(TINY)
    pairs = neighbours_of(welded_vertices(vertices)[0][faces.long()])
    if not len(pairs):
        return (0.0 * vertices).sum()
    return (1 - (normal[pairs[:, 0]] * normal[pairs[:, 1]]).sum(1)).mean()
