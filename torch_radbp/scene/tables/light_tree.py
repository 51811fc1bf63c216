"""A tree of lights for importance sampling of many lights at a given point.

Each node has bounds of the lights below it. From the root down, one of two children is picked in proportion to an estimate
of what its lights contribute at that place; so a light is picked in as many steps as the tree has levels. The probability of
a light is the product along its way, which the bits of its place among the leaves tell. The tree is complete: all leaves lie
at the same depth, and children follow from the number of their parent.

Lights are distributed over the leaves by halving: each node's lights are split at the median of the axis along which they
lie farthest apart. Its leaves are whole emitters, and inside of an emitter points are distributed by area. So the density
does not jump from triangle to triangle of an emitter.

Reference: Conty Estevez and Kulla 2018, "Importance Sampling of Many Lights with Adaptive Tree Splitting" (importance,
without the splitting); Pharr, Jakob and Humphreys 2023, "Physically Based Rendering", section 12.6.3.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.interface.emitter import NEAREST
from torch_radbp.interface.emitter_bounds import LEEWAY, LightBounds, bounds_of_groups
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.vec import TINY, Vec3, dot

LEAST_COSINE = 0.05  # at the illuminated surface: shading normals, and rounding, must not rule out a light that contributes


class Vantage(NamedTuple):
    """The illuminated point, with normal, for which a light is selected, (N,); detached."""

    p: Vec3  # world position
    n: Vec3  # unit shading normal, of either sign: light may come through the surface


class LightNodes(NamedTuple):
    """The nodes of a light tree but for the root, level by level, (2^(depth + 1) - 2,)."""

    middle: Vec3  # of the sphere around the lights
    squared_radius: Tensor
    intensity: Tensor  # times `sampling_weight`
    axis: Vec3 | None  # of the cone of directions; None: all lights shine into every direction
    spread: tuple[Tensor, Tensor] | None  # cosine and sine of that cone's angle
    reach: Tensor | None  # cosine of the angle beyond the cone up to which they shine


class LightTree(NamedTuple):
    """A complete binary tree of lights."""

    depth: int
    nodes: LightNodes
    emitter: Tensor  # (2^depth,) int32, at each leaf; 0 for an empty leaf, which is never selected


def light_tree(bounds: LightBounds, like: Tensor) -> tuple[LightTree, Tensor]:
    """Builds the light tree of some emitters; returns also the leaf of each, (K,) int32.

    Args:
        bounds: of K > 0 emitters, float64.
        like: gives dtype and device of the tree.
    """
    leaf, depth = halved(bounds.middle.stack())
    levels = [bounds_of_groups(bounds, leaf >> (depth - level), 1 << level) for level in range(1, depth + 1)]
    emitter = torch.zeros(1 << depth, dtype=torch.int32, device=leaf.device)
    emitter[leaf] = torch.arange(len(leaf), dtype=torch.int32, device=leaf.device)
    return LightTree(depth, nodes_of(joined_levels(levels, bounds), like), emitter), leaf.to(torch.int32)


def halved(places: Tensor) -> tuple[Tensor, int]:
    """Assigns K points (K, 3) to the leaves of a complete tree by median splits: the leaves, int64, and the depth."""
    depth = (len(places) - 1).bit_length()
    node = torch.zeros(len(places), dtype=torch.int64, device=places.device)
    for level in range(depth):
        extremes = [places.new_zeros(1 << level, 3).scatter_reduce(0, node[:, None].expand(-1, 3), places, way,
                                                                   include_self=False) for way in ("amin", "amax")]
        axis = (extremes[1] - extremes[0]).argmax(1)
        order = places.gather(1, axis[node][:, None]).squeeze(1).argsort(stable=True)
        order = order[node[order].argsort(stable=True)]
        count = node.bincount(minlength=1 << level)
        rank = torch.empty_like(node)
        rank[order] = torch.arange(len(node), device=node.device) - (count.cumsum(0) - count)[node[order]]
        node = 2 * node + (rank >= (count[node] + 1) // 2)
    return node, depth


def joined_levels(levels: list[LightBounds], like: LightBounds) -> LightBounds:
    """Joins the bounds of the nodes of all levels of the tree."""
    def joined(parts: list, of) -> Tensor | Vec3:
        if isinstance(of, Vec3):
            return Vec3(*(joined(list(column), part) for column, part in zip(zip(*parts), of))) if parts else of.map(
                lambda c: c[:0])
        return torch.cat(parts) if parts else of[:0]

    return LightBounds(*(joined([getattr(level, name) for level in levels], getattr(like, name))
                         for name in LightBounds._fields))


def nodes_of(bounds: LightBounds, like: Tensor) -> LightNodes:
    """Converts bounds of lights to the columns that the tree's nodes store."""
    radius = bounds.radius * (1.0 + LEEWAY)
    spread, reach = bounds.spread + LEEWAY, (bounds.reach + LEEWAY).clamp_max(torch.pi)
    oriented = bool((spread + reach < torch.pi).any())
    spread = spread.clamp_max(torch.pi)

    def column(values: Tensor) -> Tensor:
        return values.to(like)

    return LightNodes(bounds.middle.map(column), column(radius * radius), column(bounds.intensity),
                      bounds.axis.map(column) if oriented else None,
                      (column(spread.cos()), column(spread.sin())) if oriented else None,
                      column(reach.cos()) if oriented else None)


def importance(node: LightNodes, seen: Vantage) -> Tensor:
    """The importance of a node's lights for a point: an estimate of their contribution to the reflected light, (N,).

    It is 0 only where they contribute nothing, up to rounding.
    """
    reach = node.middle - seen.p
    squared = dot(reach, reach)
    d = reach * torch.rsqrt(squared.clamp_min(TINY))
    outside = squared > node.squared_radius
    limit = torch.maximum(squared, node.squared_radius).clamp_min(NEAREST**2)
    # The angle of the sphere, as it is seen: from inside, light may come from everywhere.
    sine_squared = node.squared_radius / limit
    cosine, sine = torch.sqrt((1.0 - sine_squared).clamp_min(0.0)), torch.sqrt(sine_squared)
    facing = dot(d, seen.n).abs().clamp_max(1.0)
    facing = less(facing, torch.sqrt(1.0 - facing * facing), cosine, sine)[0]
    estimate = node.intensity / limit * torch.where(outside, facing, 1.0).clamp_min(LEAST_COSINE)
    if node.axis is None:
        return estimate
    along = (-dot(d, node.axis)).clamp(-1.0, 1.0)
    emitted = less(*less(along, torch.sqrt(1.0 - along * along), *node.spread), cosine, sine)[0]
    emitted = torch.where(outside, emitted, 1.0)
    return estimate * torch.where(emitted > node.reach, emitted.clamp_min(0.0), 0.0)


def less(cosine: Tensor, sine: Tensor, other_cosine: Tensor, other_sine: Tensor) -> tuple[Tensor, Tensor]:
    """Cosine and sine of max(0, a - b), for angles a and b in [0, pi]."""
    positive = cosine < other_cosine
    return (torch.where(positive, cosine * other_cosine + sine * other_sine, 1.0),
            torch.where(positive, sine * other_cosine - cosine * other_sine, 0.0))


def _descended(tree: LightTree, seen: Vantage, turn: Callable[[int, Tensor], Tensor]) -> tuple[Tensor, Tensor]:
    """Descends the light tree: the leaf reached, (N,) int32, and its probability; 0 where no light contributes.

    Args:
        tree: detached.
        seen: the illuminated points.
        turn: decides at each level, given the probability of the left child, which lanes go right, (N,) bool.
    """
    leaf, chance = torch.zeros_like(seen.p.x, dtype=torch.int32), torch.ones_like(seen.p.x)
    for level in range(tree.depth):
        child = 2 * leaf + ((2 << level) - 2)
        left, right = (importance(lookup(tree.nodes, child + side), seen) for side in (0, 1))
        total = left + right
        share = left / torch.where(total > 0, total, 1.0)
        goes_right = turn(level, share)
        rest = torch.where(total > 0, 1.0 - share, 0.0)
        chance, leaf = chance * torch.where(goes_right, rest, share), 2 * leaf + goes_right.to(torch.int32)
    return leaf, chance


def drawn_leaf(tree: LightTree, seen: Vantage, u: Tensor) -> tuple[Tensor, Tensor]:
    """Samples a leaf of the light tree, (N,) int32, with its probability.

    Args:
        u: (N,) uniform in [0, 1), float64 with 32 random bits, of which each level takes what it needs.
    """
    def turn(level: int, share: Tensor) -> Tensor:
        nonlocal u
        share = share.to(u.dtype)
        right = u >= share
        part, start = torch.where(right, 1.0 - share, share), torch.where(right, share, 0.0)
        u = (u - start) / torch.where(part > 0, part, 1.0)
        return right

    return _descended(tree, seen, turn)


def chance_of_leaf(tree: LightTree, seen: Vantage, leaf: Tensor) -> Tensor:
    """The probability with which `drawn_leaf` samples the leaves (N,) int32."""
    return _descended(tree, seen, lambda level, share: ((leaf >> (tree.depth - 1 - level)) & 1) > 0)[1]
