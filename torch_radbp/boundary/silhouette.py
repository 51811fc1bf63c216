"""Edges that are silhouettes for a camera and lie in its view."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.edges import Edges
from torch_radbp.sensor.perspective import PinholeTensors

MARGIN = 1e-4  # left out at the border of the image, as a share of its size: a surface may end exactly there


class Sight(NamedTuple):
    """The view of one sensor."""

    camera: PinholeTensors  # detached
    width: int  # of its crop window, pixels
    height: int


def silhouettes_in_view(edges: Edges, vertices: Tensor, sight: Sight) -> Tensor:
    """The edges at which the image is discontinuous, unless something hides them.

    Args:
        edges: of the mesh.
        vertices: (V, 3) of the mesh as it is now, world space, detached.
        sight: of the camera.

    Returns:
        (E,) bool.
    """
    vertices = vertices[edges.vertex].double()
    return is_silhouette(edges, vertices - eye(sight)) & crosses_view(edges, vertices, sight)


def eye(sight: Sight) -> Tensor:
    """The camera's position, (3,) float64."""
    return torch.stack(tuple(sight.camera.origin)).double()


def is_silhouette(edges: Edges, seen: Tensor) -> Tensor:
    """True if all triangles at an edge lie on one side of it, as seen from the origin; (E,) bool.

    That is so for the single triangle at the rim of a surface, and for two triangles of which one is seen from the front
    and the other from behind. The orientation of triangles does not matter: two neighbours in a plane always lie on
    different sides of their common edge.

    Args:
        edges: of the mesh.
        seen: (U, 3) their vertices, relative to the eye.
    """
    plane = torch.linalg.cross(seen[edges.a], seen[edges.b])
    side = torch.sign((plane[edges.edge] * seen[edges.opposite]).sum(1))
    total, count = (torch.zeros(len(edges.a), dtype=side.dtype, device=side.device).index_add_(0, edges.edge, part)
                    for part in (side, torch.ones_like(side)))
    return total.abs() == count


def crosses_view(edges: Edges, vertices: Tensor, sight: Sight) -> Tensor:
    """True if part of an edge lies inside the camera's view frustum; (E,) bool.

    Args:
        edges: between `vertices`, (U, 3) float64, world space; an edge of length zero is a point.
        sight: of the camera.

    Reference: Cyrus and Beck 1978, "Generalized Two- and Three-Dimensional Clipping".
    """
    camera, width, height = sight
    axes = torch.stack([torch.stack(tuple(axis)) for axis in camera.axes]).double()
    x, y, z = ((vertices - eye(sight)) @ axes.T).unbind(1)
    left, right = limits(camera.crop_x, camera.size_x, camera.shift_x, width) * camera.tan_x
    top, bottom = limits(camera.crop_y, camera.size_y, camera.shift_y, height) * camera.tan_x / camera.aspect
    # Distances to the six planes, positive inside; x points to the left, y up.
    inside = torch.stack([left * z - x, x - right * z, top * z - y, y - bottom * z, z - camera.near, camera.far - z])
    start, end = inside[:, edges.a], inside[:, edges.b]
    crossing = start / torch.where(start == end, 1.0, start - end)
    zero = torch.zeros_like(crossing)
    enters = torch.where(start < 0, torch.where(end < 0, 2.0, crossing), zero).amax(0)
    leaves = torch.where(end < 0, torch.where(start < 0, -1.0, crossing), zero + 1.0).amin(0)
    return enters < leaves


def limits(crop: Tensor, size: Tensor, shift: Tensor, pixels: int) -> Tensor:
    """The image coordinates, from 1 to -1, of the first and the last pixel of a crop window; (2,) float64."""
    first, last = crop + MARGIN * pixels, crop + (1.0 - MARGIN) * pixels
    return torch.stack([1.0 - 2.0 * (place / size + shift) for place in (first, last)]).double()
