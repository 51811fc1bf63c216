"""Points at which scans of the film cross curves at which the image jumps, by bisection between points that see different
things."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.places import APART
from torch_radbp.boundary.reflections.differences import CHANCE, Difference, difference
from torch_radbp.boundary.reflections.ideal_paths import IdealPath, Reached, along, begins, either
from torch_radbp.boundary.reflections.scans import SALT, STEPS, FilmPoints, Scans, neighbours, paths_from, points_of
from torch_radbp.boundary.shadows.seen_edges import numbers, salted
from torch_radbp.call.render_call import RenderCall
from torch_radbp.path.integrand import Integrand
from torch_radbp.sampling.sampler import LaneKey
from torch_radbp.tensors.vec import Vec2, rows, where

FINEST = 12  # halvings of a step, at most


class Crossings(NamedTuple):
    """K points of the film at which scans cross curves."""

    low: Vec2  # the points on either side, right beside each other; pixels from the upper left corner of the window
    high: Vec2
    aperture: Vec2 | None
    key: LaneKey
    times: Tensor  # (K,) float64, how many square pixels there are for each scan, over the probability to be followed
    kind: Tensor  # (K,) int64, how the paths part there
    depth: Tensor  # (K,) int64, after how many vertices
    below: Reached  # what the path from the low point meets there
    above: Reached  # and that from the high point


class Pairs(NamedTuple):
    """Two points of the film each, N, and what is seen from there."""

    low: Vec2
    high: Vec2
    aperture: Vec2 | None
    key: LaneKey
    times: Tensor
    below: IdealPath
    above: IdealPath


def crossings(call: RenderCall, number: int, integrand: Integrand, continues: Tensor, scans: Scans,
              lot: int) -> Crossings | None:
    """Where scans in view `number` cross curves, one for each step of a scan at most; None: nowhere.

    Args:
        call: without derivatives.
        integrand: from `only_ideal`.
        continues: from `continued`.
        scans: of the view.
        lot: another number for other scans, of which random numbers are made.
    """
    count, points = len(scans.times), points_of(scans)
    path = paths_from(call, number, integrand, points)
    low, high = neighbours(count, scans.times.device)
    first, second = rows(path, low), rows(path, high)
    found = difference(integrand.proposal, continues, first, second)
    own = ((found.likelihood > 0) & (begins(first) | begins(second))).nonzero().squeeze(1)
    if not len(own):
        return None
    low, high = low[own], high[own]
    pairs = Pairs(rows(points.film, low), rows(points.film, high), rows(points.aperture, low), rows(points.key, low),
                  scans.times[low % count], rows(first, own), rows(second, own))
    found = rows(found, own)
    for turn in range(halvings(call, number)):
        pairs, found = halved(call, number, integrand, continues, pairs, turn + FINEST * lot)
        if not len(pairs.times):
            return None
    own = ((found.depth > 0) & (found.kind != CHANCE)).nonzero().squeeze(1)
    if not len(own):
        return None
    pairs, found = rows(pairs, own), rows(found, own)
    return Crossings(*pairs[:5], found.kind, found.depth, along(pairs.below, found.depth), along(pairs.above, found.depth))


def halvings(call: RenderCall, number: int) -> int:
    """How often a step of a scan is halved: until rounding of camera rays would decide."""
    film = call.views[number].camera.film
    least = 2.0 * APART * float(torch.maximum(film.size_x, film.size_y))
    return max(1, min(FINEST, math.ceil(-math.log2(STEPS * least))))


def halved(call: RenderCall, number: int, integrand: Integrand, continues: Tensor, pairs: Pairs,
           turn: int) -> tuple[Pairs, Difference]:
    """Halves of pairs between which something differs: where it does in both, one of them, by chance."""
    middle = Vec2(*(0.5 * (one + other) for one, other in zip(pairs.low, pairs.high)))
    path = paths_from(call, number, integrand, FilmPoints(middle, pairs.aperture, pairs.key))
    scene = integrand.proposal
    first, second = difference(scene, continues, pairs.below, path), difference(scene, continues, path, pairs.above)
    total = first.likelihood + second.likelihood
    lane = torch.arange(len(total), dtype=torch.int32, device=total.device)
    draw = numbers(salted(call.views[number], SALT + 2), lane, SALT + turn, torch.float64)
    lower = draw * total < first.likelihood
    found = Difference(*(torch.where(lower, one, other) for one, other in zip(first, second)))
    pairs = pairs._replace(low=Vec2(*(torch.where(lower, a, b) for a, b in zip(pairs.low, middle))),
                           high=Vec2(*(torch.where(lower, a, b) for a, b in zip(middle, pairs.high))),
                           times=pairs.times * total / found.likelihood.clamp_min(1e-300),
                           below=either(lower, pairs.below, path), above=either(lower, path, pairs.above))
    own = (total > 0).nonzero().squeeze(1)
    return rows(pairs, own), rows(found, own)
