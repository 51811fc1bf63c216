"""A tree over edges, for sampling silhouettes as seen from a point.

Each node has a box around its edges, the sum of their lengths, a cone around the normals of the triangles that meet there,
and a slab across the cone's axis that holds the edges, on surfaces that are nearly flat much thinner than the box. An edge
between two triangles is a silhouette from a point if a direction from there to it lies across a normal that turns from one
to the other; so a node may have one if directions to its box and to its slab lie across normals of its cone. From the root
down, one of the nodes some levels below is picked in proportion to an estimate of the angle under which its edges are seen,
0 where none may be a silhouette. Below the last nodes the angles of a few edges are computed.

Children follow from the number of their parent: 2 n and 2 n + 1. Only levels that ways reach have tables. The order of the
edges is found once; their bounds follow what moves. They have the scene's dtype, in float32 a row of 64 bytes for each node,
and are as much wider as rounding may be wrong.

References: Hertzmann and Zorin 2000, "Illustrating smooth surfaces", section 3.3 (silhouettes by a hierarchy); Li, Aittala,
Durand and Lehtinen 2018, "Differentiable Monte Carlo Ray Tracing through Edge Sampling", section 5 (importance sampling).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.curve.edge_order import GROUP
from torch_radbp.boundary.curve.geometry import Between, Geometry, in_world, positions
from torch_radbp.boundary.curve.outline import Outline
from torch_radbp.boundary.eye.eyes import COPLANAR, Eyes, how_much_counts, how_much_lobes_count
from torch_radbp.tensors.interleaved import interleaved
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.record import leaves_of, with_leaves
from torch_radbp.tensors.stage import Stages, stage
from torch_radbp.tensors.vec import TINY, Vec3, angle_between, cross, dot, max_component, normalize, rows, unit_normal, where

LEVELS = 3  # that places go down at once
LEAST = 0.02  # how much nodes count in which directions across are just possible
LEEWAY = 1e-6  # radians, by which rounding must not make cones too narrow
ROUNDED = 4 * 2.0**-24  # share of their coordinates by which it must not make boxes too small
SLACK = 1e-5  # share of the coordinates by which it must not make slabs too thin
PARALLEL = 32 * LEEWAY  # radians, by which cones around parallel axes may be wider than the widest of these
STRAIGHT = 0.5 * torch.pi


class EdgeNodes(NamedTuple):
    """M nodes of the edge tree with bounds of the edges below; detached, in the scene's dtype, world."""

    low: Vec3  # (M,) the corners of the box
    high: Vec3
    axis: Vec3  # (M,) unit, of the cone of normals
    cosine: Tensor  # (M,) of its half angle
    sine: Tensor  # (M,) likewise; 1: normals of all directions
    angle: Tensor  # (M,) the half angle
    sharpest: Tensor  # (M,) half angle of the edge with the sharpest pair of triangles
    bend: Tensor  # (M,) sum of length times angle between triangles; 0: no edge can be a silhouette
    plane: Tensor  # (M,) middle of the slab along the axis,
    thickness: Tensor  # (M,) and its half thickness


class EdgeTree(NamedTuple):
    """A tree over edges, by which viewpoints sample silhouettes."""

    levels: tuple[EdgeNodes, ...]  # levels that a descent visits, below the root; the last has L nodes
    slots: Tensor  # (GROUP L,) int32, edges below the last L nodes; -1: none


class Descent(NamedTuple):
    """The state of N descents of the edge tree; (N,)."""

    eye: Tensor  # int32, viewpoint that samples an edge
    node: Tensor  # int32, node in its level
    u: Tensor  # float64, remaining uniform random number
    chance: Tensor  # float64, probability of reaching the node; 0: no edge below may be a silhouette


def edge_tree(stages: Stages, geometry: Geometry, outline: Outline) -> EdgeTree:
    """Builds the tree over the edges of an outline; detached."""
    slots = outline.slots.edge
    return tree_over(stages, stages(edge_bounds)(geometry, outline, slots, numbers_to(len(slots), slots)), slots)


def tree_over(stages: Stages, bounds: EdgeNodes, slots: Tensor) -> EdgeTree:
    """Builds the tree over items with given bounds, (S,), one for each slot."""
    last, levels = len(slots) // GROUP, []
    for count in level_sizes(last):
        below, size = (levels[-1], len(levels[-1].bend)) if levels else (bounds, len(slots))
        levels.append(interleaved(stages(merged_bounds)(below, numbers_to(count, slots), size // count)))
    return EdgeTree(tuple(reversed(levels)), slots)


def level_sizes(last: int) -> list[int]:
    """The sizes of the levels that a descent visits, the last of size `last`, a power of 2."""
    sizes = []
    while last > 1:
        sizes.append(last)
        last >>= LEVELS
    return sizes


def numbers_to(count: int, like: Tensor) -> Tensor:
    """The int32 tensor 0, 1, ..., count - 1."""
    return torch.arange(count, dtype=torch.int32, device=like.device)


@stage("geometry", "outline", "slots")
def edge_bounds(geometry: Geometry, outline: Outline, slots: Tensor, slot: Tensor) -> EdgeNodes:
    """The bounds of single edges, (N,), the leaves of the tree.

    Args:
        geometry: of the scene, detached.
        outline: the edges.
        slots: the order of edges, as `EdgeTree.slots`.
        slot: (N,) int32, indices of slots.
    """
    edge = lookup(slots, slot)
    exists = edge >= 0
    edges, instance = rows((outline.edges, outline.instance), edge.clamp_min(0))
    a, b, *tips = in_world(geometry, (edges.a, edges.b, *edges.opposite[:2]), instance)
    along = b - a
    # The two turn round the edge in one sense, the first as its triangle does: so cones of neighbours may be narrow.
    one = unit_normal(along, tips[0] - a)
    other = where(edges.count == 2, unit_normal(tips[-1] - a, along), one)
    turned = torch.where(dot(one, _normal_of(geometry, edges.corner[0], instance)) < 0.0, -1.0, 1.0)
    axis = normalize(one + other) * turned
    own = geometry.triangles.vertices.p.x.dtype
    between = angle_between(*(rounded(normal, own) for normal in (one, other)))
    angle = torch.where(edges.count == 2, 0.5 * between + LEEWAY, STRAIGHT).clamp_max(STRAIGHT)
    bend = torch.where(exists, torch.sqrt(dot(along, along)) * 2.0 * angle, 0.0)
    low, high = box_around(a, b, exists)
    bounds = EdgeNodes(low, high, axis, torch.cos(angle), torch.sin(angle), angle, angle, bend, dot(axis, a + b) * 0.5,
                       dot(axis, along).abs() * 0.5)
    return rounded(bounds, own)


def box_around(a: Vec3, b: Vec3, exists: Tensor) -> tuple[Vec3, Vec3]:
    """The bounding boxes of segments from a to b, (N,) each; empty boxes where `exists`, (N,) bool, is False."""
    none = torch.full_like(a.x, torch.inf)
    low, high = (Vec3(*(extreme(p, q) for p, q in zip(a, b))) for extreme in (torch.minimum, torch.maximum))
    wider = ROUNDED * torch.maximum(max_component(a.map(torch.abs)), max_component(b.map(torch.abs)))
    low, high = low.map(lambda c: c - wider), high.map(lambda c: c + wider)
    return where(exists, low, Vec3(none, none, none)), where(exists, high, Vec3(-none, -none, -none))


def _normal_of(geometry: Geometry, corner: Tensor, instance: Tensor | None) -> Vec3:
    """The normals of the triangles to which corners, (N,) int32, belong, by the order of their vertices; of any length."""
    triangle = torch.div(corner, 3, rounding_mode="floor")
    p = positions(geometry, Between(*lookup(geometry.triangles.corners, triangle)), instance)
    return cross(p[1] - p[0], p[2] - p[0])


@stage("below")
def merged_bounds(below: EdgeNodes, node: Tensor, count: int) -> EdgeNodes:
    """The bounds of nodes of a tree, each of which bounds `count` neighbouring nodes of the level below.

    Args:
        below: that level.
        node: (N,) int32, numbers of the nodes.
        count: a power of 2.
    """
    nodes = [rows(below, node * count + place) for place in range(count)]
    while len(nodes) > 1:
        nodes = [merged(*pair) for pair in zip(nodes[::2], nodes[1::2])]
    return nodes[0]


def merged(one: EdgeNodes, other: EdgeNodes) -> EdgeNodes:
    """The bounds of each two nodes together."""
    low, high = (Vec3(*(extreme(p, q) for p, q in zip(*parts))) for extreme, parts in (
        (torch.minimum, (one.low, other.low)), (torch.maximum, (one.high, other.high))))
    both = (one.bend > 0.0) & (other.bend > 0.0)
    alone = where(one.bend > 0.0, one.axis, other.axis)
    axis = where(both, normalize(one.axis + other.axis), alone)
    angle = torch.maximum(*(torch.where(part.bend > 0.0, angle_between(axis, part.axis) + part.angle + LEEWAY, 0.0)
                            for part in (one, other))).clamp_max(STRAIGHT)
    slabs = [slab_along(axis, part) for part in (one, other)]
    lowest, highest = (torch.where(both, extreme(slabs[0][end], slabs[1][end]),
                                   torch.where(one.bend > 0.0, slabs[0][end], slabs[1][end]))
                       for end, extreme in enumerate((torch.minimum, torch.maximum)))
    return EdgeNodes(low, high, axis, torch.cos(angle), torch.sin(angle), angle,
                     torch.maximum(*(torch.where(part.bend > 0.0, part.sharpest, 0.0) for part in (one, other))),
                     one.bend + other.bend, 0.5 * (lowest + highest), 0.5 * (highest - lowest))


def slab_along(axis: Vec3, node: EdgeNodes) -> tuple[Tensor, Tensor]:
    """The least and the greatest coordinate of nodes' edges along another axis, (N,) each."""
    middle, half = (node.low + node.high) * 0.5, (node.high - node.low) * 0.5
    straight, across, at = dot(axis, node.axis), cross(axis, node.axis), dot(axis, middle)
    # Both the slab of the node and its box hold what lies off the middle.
    off = straight * (node.plane - dot(node.axis, middle))
    reach = straight.abs() * node.thickness + torch.sqrt(dot(across, across) * dot(half, half))
    most = dot(axis.map(torch.abs), half)
    return at + torch.maximum(off - reach, -most), at + torch.minimum(off + reach, most)


def angle_of_node(node: EdgeNodes, eye: Eyes, extent: Tensor) -> Tensor:
    """The importance of nodes for a viewpoint: about the angle that silhouettes subtend, times their weight; (N,).

    It is 0 only if no edge below is a silhouette of positive weight. All args have the dtype of nodes.
    """
    middle, half = (node.low + node.high) * 0.5, (node.high - node.low) * 0.5
    reach = middle * eye.w - eye.place
    squared, size = dot(reach, reach), dot(half, half)
    away = eye.w > 0.0
    limit = torch.where(away, torch.maximum(squared, size), extent * extent).clamp_min(TINY)
    d = reach * torch.rsqrt(squared.clamp_min(TINY))
    # The angle of the sphere around the box, as it is seen: from inside, edges may be everywhere.
    sine_squared = torch.where(away, (size / limit).clamp_max(1.0), 0.0)
    cosine, sine = torch.sqrt(1.0 - sine_squared), torch.sqrt(sine_squared)
    tilt = dot(node.axis, d).abs()
    straight = node.cosine * cosine - node.sine * sine <= LEEWAY  # all directions across may be met
    most = torch.where(straight, 1.0, node.sine * cosine + node.cosine * sine + LEEWAY)
    # Nor is there any silhouette where the eye lies off the slab by more than directions across can lead to.
    lifted, coordinates = (dot(node.axis, eye.place) - node.plane).abs(), max_component(eye.place.map(torch.abs)) + extent
    most_lifted = node.thickness + node.sine * (torch.sqrt(squared) + torch.sqrt(size)) + SLACK * coordinates
    possible = (tilt <= most) & (~away | (lifted <= most_lifted))
    # Normals in a cone are fewer towards its border, and edges towards where the slab ends, unless they are few.
    few = node.sharpest / node.angle.clamp_min(TINY)
    across = torch.where(straight, 1.0, (1.0 - (tilt / most)**2)**2)
    aside = torch.where(away, 1.0 - (lifted / most_lifted)**2, 1.0)
    near = torch.maximum(torch.minimum(across, aside).clamp_min(LEAST), few)
    counts = how_much_counts(eye, d, cosine, sine)
    if eye.lobes:
        counts = counts * how_much_lobes_count(eye, d, sine_squared)
    # Of normals that are spread evenly over the cone, so many have a direction across.
    share = near * node.bend / (2.0 * (node.angle + sine).clamp_min(TINY))
    flat = (node.angle - node.sharpest < PARALLEL) & (lifted + node.thickness < COPLANAR * extent)
    own = away & flat & (dot(node.axis, eye.n).abs() > 1.0 - COPLANAR)
    return torch.where(possible & (node.bend > 0.0) & ~own, share * torch.rsqrt(limit) * counts, 0.0)


def rounded(record, dtype: torch.dtype):
    """Converts a record, such as viewpoints, to the dtype of nodes."""
    return with_leaves(record, [leaf.to(dtype) for leaf in leaves_of(record)])


@stage("nodes", "eyes")
def descended(nodes: EdgeNodes, eyes: Eyes, extent: Tensor, at: Descent, count: int) -> Descent:
    """Descends several levels of the tree at once, sampling one of all nodes there by importance.

    Args:
        nodes: of the level that is reached.
        eyes: the viewpoints, in the dtype of the nodes.
        extent: () of the scene, in the same dtype.
        at: (N,) the descents so far.
        count: the number of nodes of that level below each present one.
    """
    eye, first = rows(eyes, at.eye), at.node * count
    angles = [angle_of_node(rows(nodes, first + place), eye, extent).double() for place in range(count)]
    place, share, u = picked_by_weight(angles, at.u)
    return Descent(at.eye, first + place, u, at.chance * share)


def picked_by_weight(weights: Sequence[Tensor], u: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Samples one item by weights, (N,) each: its number, (N,) int32, its probability, and the remaining random number."""
    total = weights[0]
    for weight in weights[1:]:
        total = total + weight
    aim, below = u * total, torch.zeros_like(total)
    place, own, start = torch.zeros_like(total, dtype=torch.int32), torch.zeros_like(total), below
    for number, weight in enumerate(weights):
        here = (weight > 0.0) & (aim >= below)
        place, own, start = torch.where(here, number, place), torch.where(here, weight, own), torch.where(here, below, start)
        below = below + weight
    left = ((aim - start) / torch.where(own > 0.0, own, 1.0)).clamp(0.0, 1.0)
    return place, own / torch.where(total > 0.0, total, 1.0), left
