"""Edges that are silhouettes for a camera and lie in its view."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.edges import Edges
from torch_radbp.sensor.kind import Camera
from torch_radbp.vec import Vec3

ROUNDING = 1e-9  # of sums of products, relative
NEITHER = math.inf  # in place of a side: no edge of this triangle is a silhouette
MARGIN = 1e-4  # left out at the border of the image, as a share of its size: a surface may end exactly there


class CameraSight(NamedTuple):
    """The view of one sensor."""

    camera: Camera  # detached
    width: int  # of its crop window, pixels
    height: int


def silhouettes_in_view(edges: Edges, vertices: Tensor, sight: CameraSight) -> Tensor:
    """The edges at which the image is discontinuous, unless something hides them.

    Args:
        edges: of the mesh.
        vertices: (V, 3) of the mesh as it is now, world space, detached.
        sight: of the camera.

    Returns:
        (E,) bool.
    """
    camera, vertices = sight.camera, vertices.double()
    vertices = vertices[edges.vertex]
    found = is_silhouette(edges, vertices, camera.kind.eye(camera.lens))
    outline = found.nonzero().squeeze(1)
    found[outline] = crosses_view(edges._replace(a=edges.a[outline], b=edges.b[outline]), vertices, sight)
    return found


def is_silhouette(edges: Edges, vertices: Tensor, eye: Tensor, radius: Tensor | None = None) -> Tensor:
    """True if all triangles at an edge lie on one side of it, as an eye sees it, or may do so from nearby; (E,) bool.

    That is so for the single triangle at the rim of a surface, and for two triangles of which one is seen from the front
    and the other from behind. The orientation of triangles does not matter: two neighbours in a plane always lie on
    different sides of their common edge. Of the edges of a triangle that is seen edge-on only the nearer ones count.

    Args:
        edges: of the mesh.
        vertices: (U, 3) of the edges, float64.
        eye: (4,) homogeneous: a position, or with 0 at the end the direction towards it.
        radius: () about the eye, within which an edge may be seen from anywhere; None: 0.
    """
    towards = vertices[edges.a] * eye[3] - eye[:3]
    normal = normals(edges, vertices, edges.edge, edges.opposite)
    side = side_of(normal, towards[edges.edge])
    nearer = behind_itself(edges, vertices, edges.edge, edges.opposite, towards[edges.edge]) & (side == 0.0)
    side = torch.where(nearer, NEITHER, side)
    if radius is None:
        return on_one_side(side, edges.edge, len(edges.a))
    either = (normal * towards[edges.edge]).sum(1).abs() <= radius * normal.norm(dim=1)
    found = on_one_side(torch.where(either, 0.0, side), edges.edge, len(edges.a))
    return found.index_fill(0, edges.edge[either], True)


def is_silhouette_from(edges: Edges, vertices: Tensor, edge: Tensor, eyes: Tensor) -> Tensor:
    """`is_silhouette` of some edges, each seen from an eye of its own; (N,) bool.

    Args:
        edges: between `vertices`, (U, 3).
        edge: (N,) int64, which.
        eyes: (N, 3).
    """
    count = torch.bincount(edges.edge, minlength=len(edges.a))
    first, order = (count.cumsum(0) - count)[edge], edges.edge.argsort(stable=True)
    own = count[edge]
    asked = torch.arange(len(edge), device=edge.device).repeat_interleave(own)
    number = torch.arange(len(asked), device=edge.device) - (own.cumsum(0) - own)[asked]
    opposite, towards = edges.opposite[order[first[asked] + number]], (vertices[edges.a[edge]] - eyes)[asked]
    side = side_of(normals(edges, vertices, edge[asked], opposite), towards)
    nearer = behind_itself(edges, vertices, edge[asked], opposite, towards) & (side == 0.0)
    return on_one_side(torch.where(nearer, NEITHER, side), asked, len(edge))


def normals(edges: Edges, vertices: Tensor, edge: Tensor, opposite: Tensor) -> Tensor:
    """The normals of triangles, of any length, that point to one side of the edge if the triangles do; (H, 3).

    Args:
        edges: between `vertices`, (U, 3).
        edge: (H,) int64, at which each triangle lies.
        opposite: (H,) int64, its third vertex.
    """
    a = vertices[edges.a]
    return torch.linalg.cross((vertices[edges.b] - a)[edge], vertices[opposite] - a[edge])


def side_of(normal: Tensor, towards: Tensor) -> Tensor:
    """The side from which triangles are seen, (H,): -1, 1, or 0 where they are seen edge-on.

    Args:
        normal: (H, 3) of the triangles, of any length.
        towards: (H, 3) from the eye.
    """
    products = normal * towards
    along = products.sum(1)
    return torch.where(along.abs() <= ROUNDING * products.abs().sum(1), 0.0, torch.sign(along))


def behind_itself(edges: Edges, vertices: Tensor, edge: Tensor, opposite: Tensor, towards: Tensor) -> Tensor:
    """True where a triangle that is seen edge-on lies on the eye's side of an edge, which it hides; (H,) bool.

    Args:
        edges, vertices, edge, opposite: as for `normals`.
        towards: (H,) from the eye to the edge.
    """
    a = vertices[edges.a]
    along, inwards = (vertices[edges.b] - a)[edge], vertices[opposite] - a[edge]
    share = (inwards * along).sum(1) / (along * along).sum(1)
    return ((inwards - along * share[:, None]) * towards).sum(1) < 0.0


def on_one_side(side: Tensor, edge: Tensor, count: int) -> Tensor:
    """True for edges with all triangles that are not seen edge-on, at least one, on one side; (E,) bool.

    Args:
        side: (H,) of each triangle, from `side_of`, or `NEITHER`.
        edge: (H,) of each triangle.
        count: E.
    """
    total, seen = (torch.zeros(count, dtype=side.dtype, device=side.device).index_add_(0, edge, part)
                   for part in (side, side.abs()))
    return (total.abs() == seen) & (seen > 0) & torch.isfinite(seen)


def crosses_view(edges: Edges, vertices: Tensor, sight: CameraSight) -> Tensor:
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
