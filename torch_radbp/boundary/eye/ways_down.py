"""Descents of a tree over edges or segments, and the samples that they yield."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.curve.places import NEIGHBOURS, Lot, lot_of
from torch_radbp.boundary.eye.edge_tree import Descent, EdgeTree, descended, numbers_to, picked_by_weight, rounded
from torch_radbp.boundary.eye.eyes import Eyes
from torch_radbp.sampling.running_sum import running_sum
from torch_radbp.sampling.sampler import SampleKey, fine_unit, hash32
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.stage import Stages
from torch_radbp.tensors.vec import rows

# Steps of a sequence that fills a square evenly, in units of 2^-32: the powers of the inverse of the root of x^3 = x + 1.
STEPS = 0xC13FA9A9 - (1 << 32), 0x91E10DA5 - (1 << 32)
FIRST = 1 << 30  # more than there are edges
SALT = 0x6A09E667  # tells the random numbers of eyes that are tried from others


def ways_down(stages: Stages, tree: EdgeTree, eyes: Eyes, seed: SampleKey, each: int, extent: Tensor,
              tried: Tensor | None = None) -> Descent:
    """Descends the tree from all viewpoints to the last nodes; args as for `places_seen`, and `extent`: () of the scene."""
    way = numbers_to(each * len(eyes.w), tree.slots)
    eye, shift = torch.div(way, each, rounding_mode="floor"), hash32(seed.seed)
    if tried is not None:
        shift = torch.where(rows(tried, eye), hash32(seed.seed ^ SALT), shift)
    u = fine_unit(eye * STEPS[0] + shift) + (way - eye * each)  # as many in each part of the edges
    at, above = Descent(eye, torch.zeros_like(way), u / each, torch.ones_like(u)), 1
    dtype = tree.levels[0].bend.dtype if tree.levels else extent.dtype
    seen_from, wide = rounded(eyes, dtype), extent.to(dtype)
    for nodes in tree.levels:
        at, above = stages(descended)(nodes, seen_from, wide, at, len(nodes.bend) // above), len(nodes.bend)
    return at


class EdgeLot(NamedTuple):
    """The edges that K descents have found, and a distribution of samples over them."""

    found: PickedEdges
    eye: Tensor  # (K,) int32, viewpoint of each
    lot: Lot


def lot_of_found(found: PickedEdges, eye: Tensor, each: int, count: int,
                 tried: Tensor | None = None) -> tuple[EdgeLot, Tensor] | None:
    """A distribution of `count` samples over the edges found, and the samples' numbers, int32; None: nothing was found.

    Args:
        each: the number of descents per viewpoint.
        tried: as for `seen_edges.places_seen`.
    """
    own = None if tried is None else rows(tried, eye)
    order = found.edge if own is None else torch.where(own, found.edge - FIRST, found.edge)
    order = order.argsort(stable=True)  # places on an edge are well spread along it
    found, eye, own = rows((found._replace(times=found.times / each), eye, own), order)
    weight = found.times * found.angle
    if own is not None:
        weight, count = weights_apart(weight, own, count, float(tried.double().mean()))
    total = running_sum(weight)
    if not len(total) or not float(total[-1]) > 0.0:
        return None
    return EdgeLot(found, eye, lot_of(weight, count, total)), numbers_to(count, eye)


def weights_apart(weight: Tensor, tried: Tensor, count: int, share: float) -> tuple[Tensor, int]:
    """The weights, scaled so that pilot and other samples get separate numbers of samples; and the total number.

    Args:
        weight: (N,) the weights before.
        tried: (N,) bool, of pilot samples, which come first.
        count: the greatest number of samples.
        share: the fraction of it for pilot samples.
    """
    places, scaled = 0, torch.zeros_like(weight)
    for among, most in ((tried, count * share), (~tried, count * (1.0 - share))):
        own = torch.where(among, weight, 0.0)
        total, wanted = float(own.sum()), min(math.ceil(most), int(torch.count_nonzero(own)))
        if among is tried:
            wanted = -(-wanted // NEIGHBOURS) * NEIGHBOURS
        if total > 0.0:
            scaled, places = scaled + own * (wanted / total), places + wanted
    return scaled, places


class PickedEdges(NamedTuple):
    """The edges that N descents of the tree have found."""

    edge: Tensor  # (N,) int32; -1: no silhouette
    times: Tensor  # (N,) float64, weight: number of edges that it stands for
    angle: Tensor  # (N,) float64, angle that it subtends


def found_among(slots: Tensor, at: Descent, first: Tensor, angles: Sequence[Tensor]) -> PickedEdges:
    """The edge that each descent samples among the `GROUP` slots from `first` on, by the angles that they subtend."""
    place, share, _ = picked_by_weight(angles, at.u)
    angle = torch.zeros_like(share)
    for number, its in enumerate(angles):
        angle = torch.where(place == number, its, angle)
    chance = at.chance * share
    exists = chance > 0.0
    times = torch.where(exists, 1.0 / torch.where(exists, chance, 1.0), 0.0)
    return PickedEdges(torch.where(exists, lookup(slots, first + place), -1), times, angle)
