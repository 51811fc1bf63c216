"""Points at which scans of the film cross curves at which the image jumps, by bisection between points that see different
things."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.places import APART
from torch_radbp.boundary.reflections.differences import CHANCE, HORIZON, SHADOW, Difference, difference
from torch_radbp.boundary.reflections.ideal_paths import (
    IdealPath,
    LightLooks,
    Reached,
    along,
    begins,
    either,
)
from torch_radbp.boundary.reflections.scans import (
    SALT,
    STEPS,
    FilmPoints,
    Scans,
    Searched,
    neighbours,
    paths_from,
    points_of,
)
from torch_radbp.boundary.shadows.seen_edges import numbers, salted
from torch_radbp.sampling.sampler import LaneKey
from torch_radbp.tensors.vec import Vec2, rows

FINEST = 12  # halvings of a step, at most


class Crossings(NamedTuple):
    """K points of the film at which scans cross curves."""

    low: Vec2  # the points on either side, right beside each other; pixels from the upper left corner of the window
    high: Vec2
    aperture: Vec2 | None
    key: LaneKey
    looks: LightLooks | None
    times: Tensor  # (K,) float64, how many square pixels there are for each scan, over the probability to be followed
    kind: Tensor  # (K,) int64, how the paths part there
    depth: Tensor  # (K,) int64, after how many vertices
    below: Reached  # what the path from the low point meets there; on a horizon, what it leaves
    above: Reached  # and that from the high point


class Pairs(NamedTuple):
    """Two points of the film each, N, and what is seen from there."""

    low: Vec2
    high: Vec2
    aperture: Vec2 | None
    key: LaneKey
    looks: LightLooks | None
    times: Tensor
    below: IdealPath
    above: IdealPath


def crossings(searched: Searched, scans: Scans, lot: int) -> Crossings | None:
    """Where scans cross curves, one for each step of a scan at most; None: nowhere.

    Args:
        scans: of the view.
        lot: another number for other scans, of which random numbers are made.
    """
    count, points = len(scans.times), points_of(scans)
    path = paths_from(searched, points)
    low, high = neighbours(count, scans.times.device)
    first, second = rows(path, low), rows(path, high)
    found = difference(searched.call.scene, searched.surfaces, first, second)
    own = ((found.likelihood > 0) & (begins(first) | begins(second))).nonzero().squeeze(1)
    low, high = low[own], high[own]
    pairs = Pairs(rows(points.film, low), rows(points.film, high), *rows((points.aperture, points.key, points.looks), low),
                  scans.times[low % count], rows(first, own), rows(second, own))
    found = rows(found, own)
    for turn in range(halvings(searched)):
        if not len(pairs.times):
            return None
        pairs, found = halved(searched, pairs, turn + FINEST * lot)
    own = ((found.depth > 0) & (found.kind != CHANCE)).nonzero().squeeze(1)
    if not len(own):
        return None
    pairs, found = rows(pairs, own), rows(found, own)
    met = found.depth - (found.kind == HORIZON).long()
    if pairs.looks is not None:
        chance = torch.where(found.kind == SHADOW, pairs.looks.draw.picked.pmf.double(), 1.0)
        pairs = pairs._replace(times=pairs.times / chance)
    return Crossings(*pairs[:6], found.kind, found.depth, along(pairs.below, met), along(pairs.above, met))


def halvings(searched: Searched) -> int:
    """How often a step of a scan is halved: until rounding of camera rays would decide."""
    film = searched.call.views[searched.number].camera.film
    least = 4.0 * APART * float(torch.maximum(film.size_x, film.size_y))
    return max(1, min(FINEST, math.ceil(-math.log2(STEPS * least))))


def halved(searched: Searched, pairs: Pairs, turn: int) -> tuple[Pairs, Difference]:
    """Halves of pairs between which something differs: where it does in both, one of them, by chance."""
    middle = Vec2(*(0.5 * (one + other) for one, other in zip(pairs.low, pairs.high)))
    path = paths_from(searched, FilmPoints(middle, pairs.aperture, pairs.key, pairs.looks))
    first, second = (difference(searched.call.scene, searched.surfaces, *ends)
                     for ends in ((pairs.below, path), (path, pairs.above)))
    total = first.likelihood + second.likelihood
    lane = torch.arange(len(total), dtype=torch.int32, device=total.device)
    draw = numbers(salted(searched.call.views[searched.number], SALT + 2), lane, SALT + turn, torch.float64)
    lower = draw * total < first.likelihood
    found = Difference(*(torch.where(lower, one, other) for one, other in zip(first, second)))
    pairs = pairs._replace(low=Vec2(*(torch.where(lower, a, b) for a, b in zip(pairs.low, middle))),
                           high=Vec2(*(torch.where(lower, a, b) for a, b in zip(middle, pairs.high))),
                           times=pairs.times * total / found.likelihood.clamp_min(1e-300),
                           below=either(lower, pairs.below, path), above=either(lower, path, pairs.above))
    own = (total > 0).nonzero().squeeze(1)
    return rows(pairs, own), rows(found, own)
