"""Edges that are silhouettes for a camera and lie in its view."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.edges import Edges
from torch_radbp.sensor.kind import Camera
from torch_radbp.vec import Vec3

FAR_AWAY = 1e4  # extents of the mesh: the distance at which an eye or a light in a direction is placed
MARGIN = 1e-4  # left out at the border of the image, as a share of its size: a surface may end exactly there


class Sight(NamedTuple):
    """The view of one sensor."""

    camera: Camera  # detached
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
    camera, vertices = sight.camera, vertices.double()
    eye, vertices = viewpoint(camera.kind.eye(camera.lens), vertices), vertices[edges.vertex]
    found = is_silhouette(edges, vertices - eye)
    outline = found.nonzero().squeeze(1)
    found[outline] = crosses_view(edges._replace(a=edges.a[outline], b=edges.b[outline]), vertices, sight)
    return found


def viewpoint(place: Tensor, vertices: Tensor) -> Tensor:
    """The position of an eye or a light, (3,); one that is a direction is put far away from a mesh.

    Args:
        place: (4,) homogeneous: a position, or with 0 at the end the direction towards it; float64.
        vertices: (V, 3) of the mesh, float64.
    """
    if place[3]:
        return place[:3]
    extent = (vertices.amax(0) - vertices.amin(0)).max()
    return vertices.mean(0) + FAR_AWAY * extent * place[:3]


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
    """True if part of an edge is in the camera's view; (E,) bool.

    Args:
        edges: between `vertices`, (U, 3) float64, world space; an edge of length zero is a point.
        sight: of the camera.
    """
    camera, width, height = sight
    x, y = limits(camera.film.crop_x, camera.film.size_x, width), limits(camera.film.crop_y, camera.film.size_y, height)
    start, end = (Vec3.of(vertices[index]) for index in (edges.a, edges.b))
    return camera.kind.crosses_view(camera.lens, x, y, start, end)


def limits(crop: Tensor, size: Tensor, pixels: int) -> Tensor:
    """The positions on the image of the borders of a crop window, less a margin; (2,) float64."""
    return torch.stack([(crop + share * pixels) / size for share in (MARGIN, 1.0 - MARGIN)]).double()
