"""A tree over intersection segments, for sampling them as seen from a point.

It is one of edges (`edge_tree.py`) of which no direction across is left out: on either side of a segment another surface is
seen, from wherever it is seen.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.curve.edge_order import GROUP, slots_of
from torch_radbp.boundary.curve.geometry import Corners, Geometry
from torch_radbp.boundary.curve.places import picked
from torch_radbp.boundary.curve.segments import Segments, faces_viewer, height_above, place_of
from torch_radbp.boundary.eye.edge_tree import (
    STRAIGHT,
    Descent,
    EdgeNodes,
    EdgeTree,
    box_around,
    numbers_to,
    rounded,
    tree_over,
)
from torch_radbp.boundary.eye.eyes import Eyes
from torch_radbp.boundary.eye.seen_edges import Passed, angle_of, numbers_of_places, passed_at, place_between
from torch_radbp.boundary.eye.ways_down import EdgeLot, PickedEdges, found_among
from torch_radbp.sampling.sampler import SampleKey
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.stage import Stages, stage
from torch_radbp.tensors.vec import Vec3, dot, interpolated, masked, normalize, rows, unit_normal


class SegmentTree(NamedTuple):
    """Intersection segments, and a tree by which viewpoints sample them; detached."""

    segments: Segments
    tree: EdgeTree


def segment_tree(stages: Stages, geometry: Geometry, segments: Segments) -> SegmentTree:
    """Builds the tree over segments; `geometry`: of the scene, detached."""
    start, _ = ends_of(geometry, segments)
    slots = slots_of(torch.zeros_like(segments.triangle), start.stack())
    bounds = stages(segment_bounds)(geometry, segments, slots, numbers_to(len(slots), slots))
    return SegmentTree(segments, tree_over(stages, bounds, slots))


def ends_of(geometry: Geometry, segments: Segments) -> tuple[Vec3, Vec3]:
    """The end points of segments, (S,) world each."""
    corners = segments.corners(geometry)
    return tuple(interpolated(corners, end.x, end.y) for end in (segments.start, segments.end))


@stage("geometry", "segments", "slots")
def segment_bounds(geometry: Geometry, segments: Segments, slots: Tensor, slot: Tensor) -> EdgeNodes:
    """The bounds of single segments, (N,), the leaves of the tree.

    Args:
        geometry: of the scene, detached.
        segments: (S,) the segments.
        slots: the order of segments in the tree.
        slot: (N,) int32, indices of slots.
    """
    number = lookup(slots, slot)
    exists = number >= 0
    a, b = ends_of(geometry, rows(segments, number.clamp_min(0)))
    along, none = b - a, torch.zeros_like(a.x)
    low, high = box_around(a, b, exists)
    bend = torch.where(exists, torch.sqrt(dot(along, along)) * 2.0 * STRAIGHT, 0.0)
    straight = none + STRAIGHT
    bounds = EdgeNodes(low, high, Vec3(none, none, none + 1.0), none, none + 1.0, straight, straight, bend, none,
                       none + torch.inf)
    return rounded(bounds, geometry.triangles.vertices.p.x.dtype)


@stage("geometry", "segments", "slots", "eyes")
def segment_found(geometry: Geometry, segments: Segments, slots: Tensor, eyes: Eyes, at: Descent,
                  extent: Tensor) -> PickedEdges:
    """Samples a segment below each descent's last node of the tree, in proportion to the angles that they subtend.

    Args:
        geometry: of the scene, detached.
        segments: (S,) the segments.
        slots: the order of segments in the tree.
        eyes: the viewpoints.
        at: (N,) descents at the last nodes.
        extent: () of the scene.
    """
    own, first = rows(eyes, at.eye), at.node * GROUP
    angles = []
    for place in range(GROUP):
        number = lookup(slots, first + place)
        chosen = rows(segments, number.clamp_min(0))
        exists, (a, b) = number >= 0, ends_of(geometry, chosen)
        if chosen.seen_from is not None:
            exists = exists & faces_viewer(geometry, chosen, chosen.corners(geometry), lambda p: own.place - p * own.w)
        angles.append(torch.where(exists, angle_of(a, b, own, extent), 0.0))
    return found_among(slots, at, first, angles)


@stage("geometry", "segments", "eyes", "found")
def segment_passed(geometry: Geometry, segments: Segments, eyes: Eyes, found: EdgeLot, seed: SampleKey, extent: Tensor,
                   place: Tensor) -> Passed:
    """Samples points on the segments that viewpoints have selected; `Passed.outwards` lies between the two surfaces.

    Args:
        geometry, segments, eyes, extent: as for `segment_found`.
        found, seed, place: as for `edge_passed`.
    """
    key, aim, turn = numbers_of_places(seed, place)
    number, _, times = picked(found.lot, place, aim)
    (segment, repeated, _), eye = rows((found.found, found.eye), number)
    own, segments = rows(eyes, eye), rows(segments, segment.clamp_min(0))
    along, times, p = place_between(*ends_of(geometry, segments), own, turn, times * repeated)
    times = times if segments.share is None else times / segments.share
    towards = [_facing(place_of(geometry, *surface), own.place) for surface in surfaces_along(segments)]
    towards[1] = masked(segments.through >= 0, towards[1])
    return passed_at(own, Passed(segment, eye, along, times, p, normalize(towards[0] + towards[1]), None, None, None, key),
                     extent, geometry.triangles.n.x.dtype)


def surfaces_along(segments: Segments) -> list[tuple[Tensor, Tensor | None]]:
    """The two intersecting triangles of each segment, with their instances."""
    return [(segments.triangle, segments.instance), (segments.through, segments.shown_by)]


def _facing(corners: Corners, eye: Vec3) -> Vec3:
    """The unit normals of triangles, (N,), on the side of the viewpoint; 0 if that lies in their planes."""
    return unit_normal(corners[1] - corners[0], corners[2] - corners[0]) * torch.sign(height_above(corners, eye))
