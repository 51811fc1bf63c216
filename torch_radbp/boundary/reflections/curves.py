"""The curves that scans cross, as levels of what moves: an edge, a rim, a line along which surfaces cross.

The level is 0 on the curve. At a fixed point of the film it changes with what the path follows there, mirrors, glass and the
camera, and with the surfaces that are seen.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.geometry import Between, Corners, Geometry, positions, vertex_normals
from torch_radbp.boundary.reflections.crossings import Crossings
from torch_radbp.boundary.reflections.differences import RIM as TURNED
from torch_radbp.boundary.reflections.differences import SURFACE
from torch_radbp.boundary.reflections.ideal_paths import Reached
from torch_radbp.boundary.shadows.seen_edges import crossed_at
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.vec import TINY, Ray, Vec3, cross, dot, interpolated, rows, where

EDGE, RIM, MEETING = range(3)
OFF = 4.0  # times the distance of the two rays, by which an edge may lie off them
ROUNDED = 2e-5  # the same as a share of the distance, for the rounding of what rays meet


class Curves(NamedTuple):
    """K curves."""

    kind: Tensor  # (K,) int64
    prim: Tensor  # (K,) int32, the triangle of the edge, or of the rim, or one of those that cross
    instance: Tensor | None  # (K,) int32
    side: Tensor  # (K,) int64, of the triangle, the one opposite this corner
    other: Tensor  # (K,) int32, the triangle that crosses
    shown_by: Tensor | None  # (K,) int32, its instance


def curves_crossed(geometry: Geometry, crossed: Crossings) -> tuple[Curves, Tensor]:
    """The curves, and (K,) bool which of them are known; of edges the nearest to the rays."""
    both = crossed.below, crossed.above
    corners = [corners_of(geometry, met.hit.prim, met.hit.instance) for met in both]
    rays = [Ray(*(part.map(torch.Tensor.double) for part in met.ray)) for met in both]
    nearest, prim, side = None, both[0].hit.prim, torch.zeros_like(crossed.depth)
    instance, far = both[0].hit.instance, torch.zeros_like(crossed.times)
    for met, own in zip(both, corners):
        for number in range(3):
            off, reach = distance_to_side(rays[0], own[(number + 1) % 3], own[(number + 2) % 3])
            off = torch.where(met.hit.prim >= 0, off, torch.inf)
            if nearest is None:
                nearest, far = off, reach
                continue
            nearer = off < nearest
            nearest, far = torch.where(nearer, off, nearest), torch.where(nearer, reach, far)
            prim, side = torch.where(nearer, met.hit.prim, prim), torch.where(nearer, number, side)
            instance = None if instance is None else torch.where(nearer, met.hit.instance, instance)
    apart = rays[1].o + rays[1].d * far - rays[0].o - rays[0].d * far
    apart = torch.sqrt(dot(apart, apart))
    is_edge = nearest <= OFF * apart + ROUNDED * far
    meets = (both[0].hit.prim >= 0) & (both[1].hit.prim >= 0) & inside(corners[1], rays[0]) & inside(corners[0], rays[1])
    rim = crossed.kind == TURNED
    kind = torch.where(rim, RIM, torch.where(meets, MEETING, EDGE))
    known = rim | ((crossed.kind == SURFACE) & (meets | is_edge))
    of_low = rim | meets
    prim = torch.where(of_low, both[0].hit.prim, prim)
    instance = None if instance is None else torch.where(of_low, both[0].hit.instance, instance)
    return Curves(kind, prim, instance, side, both[1].hit.prim, both[1].hit.instance), known


def corners_of(geometry: Geometry, prim: Tensor, instance: Tensor | None) -> Corners:
    """The corners of triangles, (N,) int32, in the world, attached; float64. Of any where it is -1."""
    return positions(geometry, between(geometry, prim), instance)


def between(geometry: Geometry, prim: Tensor) -> Between:
    """The vertices of triangles."""
    return Between(*lookup(geometry.triangles.corners, prim.clamp_min(0)))


def distance_to_side(ray: Ray, a: Vec3, b: Vec3) -> tuple[Tensor, Tensor]:
    """How far the segments from a to b lie off rays, (N,), and how far along these."""
    w, e = a - ray.o, b - a
    w_along, e_along = dot(w, ray.d), dot(e, ray.d)
    w, e = w - ray.d * w_along, e - ray.d * e_along
    at = (-dot(w, e) / dot(e, e).clamp_min(TINY)).clamp(0.0, 1.0)
    off = w + e * at
    reach = w_along + e_along * at
    return torch.where(reach > 0, torch.sqrt(dot(off, off)), torch.inf), reach


def inside(corners: Corners, ray: Ray) -> Tensor:
    """(N,) bool: rays cross triangles."""
    u, v = crossed_at(corners, ray)
    return (u > 0) & (v > 0) & (u + v < 1)


def level(geometry: Geometry, curves: Curves, ray: Ray) -> Tensor:
    """(K,) float64, attached: 0 on the curves, but for what they lie off the points of the film.

    Args:
        geometry: attached.
        curves: (K,).
        ray: by which they are seen, attached.
    """
    ray = Ray(*(part.map(torch.Tensor.double) for part in ray))
    found = torch.zeros_like(ray.d.x)
    for kind, of_kind in LEVELS.items():
        own = (curves.kind == kind).nonzero().squeeze(1)
        if len(own):
            found = found.index_add(0, own, of_kind(geometry, rows(curves, own), rows(ray, own)))
    return found


def beside_edge(geometry: Geometry, curves: Curves, ray: Ray) -> Tensor:
    """Of edges: on which side rays pass them."""
    first, second, third = corners_of(geometry, curves.prim, curves.instance)
    a = where(curves.side == 0, second, where(curves.side == 1, third, first))
    b = where(curves.side == 0, third, where(curves.side == 1, first, second))
    return dot(cross(b - a, ray.d), a - ray.o)


def facing(geometry: Geometry, curves: Curves, ray: Ray) -> Tensor:
    """Of rims: how far shading normals are turned away."""
    corners = corners_of(geometry, curves.prim, curves.instance)
    normals = vertex_normals(geometry, between(geometry, curves.prim), curves.instance)
    return dot(interpolated(normals, *crossed_at(corners, ray)), ray.d)


def nearer(geometry: Geometry, curves: Curves, ray: Ray) -> Tensor:
    """Of triangles that cross: how much farther the one is than the other."""
    distances = []
    for prim, instance in ((curves.prim, curves.instance), (curves.other, curves.shown_by)):
        corners = corners_of(geometry, prim, instance)
        n = cross(corners[1] - corners[0], corners[2] - corners[0])
        along = dot(ray.d, n)
        distances.append(dot(corners[0] - ray.o, n) / torch.where(along != 0, along, 1.0))
    return distances[0] - distances[1]


LEVELS = {EDGE: beside_edge, RIM: facing, MEETING: nearer}
