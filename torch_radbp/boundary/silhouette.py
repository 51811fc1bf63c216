"""Which edges are silhouettes for a camera, and lie in its view."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.edges import Edges
from torch_radbp.sensor.perspective import PinholeTensors

MARGIN = 1e-4  # at the border of the image, a share of its size: a surface may end exactly there


class Sight(NamedTuple):
    """What a sensor sees of the world."""

    camera: PinholeTensors  # detached
    width: int  # of its crop window, pixels
    height: int


def silhouettes_in_view(edges: Edges, vertices: Tensor, sight: Sight) -> Tensor:
    """Which edges the image changes at by a jump, if nothing hides them.

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
    """(3,) where the camera is, float64."""
    return torch.stack(tuple(sight.camera.origin)).double()


def is_silhouette(edges: Edges, seen: Tensor) -> Tensor:
    """Whether all triangles at an edge lie on one side of it, as seen from the origin; (E,) bool.

    So do the one triangle at the rim of a surface, and two of which one is seen from the front and one from behind. However
    triangles are oriented, two of a flat surface lie on different sides.

    Args:
        edges: of the mesh.
        seen: (U, 3) their vertices relative to the eye.
    """
    plane = torch.linalg.cross(seen[edges.a], seen[edges.b])
    side = torch.sign((plane[edges.edge] * seen[edges.opposite]).sum(1))
    total, count = (torch.zeros(len(edges.a), dtype=side.dtype, device=side.device).index_add_(0, edges.edge, part)
                    for part in (side, torch.ones_like(side)))
    return total.abs() == count


def crosses_view(edges: Edges, vertices: Tensor, sight: Sight) -> Tensor:
    """Whether a part of an edge lies inside the camera's pyramid of view; (E,) bool.

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
    # Distances to the six planes, positive inside. Coordinates run to the left and up.
    inside = torch.stack([left * z - x, x - right * z, top * z - y, y - bottom * z, z - camera.near, camera.far - z])
    start, end = inside[:, edges.a], inside[:, edges.b]
    crossing = start / torch.where(start == end, 1.0, start - end)
    zero = torch.zeros_like(crossing)
    enters = torch.where(start < 0, torch.where(end < 0, 2.0, crossing), zero).amax(0)
    leaves = torch.where(end < 0, torch.where(start < 0, -1.0, crossing), zero + 1.0).amin(0)
    return enters < leaves


def limits(crop: Tensor, size: Tensor, shift: Tensor, pixels: int) -> Tensor:
    """The tangents, relative to the half image, between which a crop window lies; (2,), of its first and its last pixel."""
    first, last = crop + MARGIN * pixels, crop + (1.0 - MARGIN) * pixels
    return torch.stack([1.0 - 2.0 * (place / size + shift) for place in (first, last)]).double()
