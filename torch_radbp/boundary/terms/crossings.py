"""Points at which scans of the film cross discontinuity curves, by bisection between points that see different things."""

from __future__ import annotations

from itertools import accumulate
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.eye.differences import BENT, CHANCE, HORIZON, RIM, SURFACE, Difference, Pairing
from torch_radbp.boundary.eye.ideal_paths import IdealPath, LightLooks, along, begins, extended, some_paths
from torch_radbp.boundary.eye.ideal_steps import Reached
from torch_radbp.boundary.eye.seen_edges import salted, uniform_numbers
from torch_radbp.boundary.terms.scans import SALT, FilmPoints, Scans, Searched, neighbours, parting, paths_from, points_of
from torch_radbp.sampling.sampler import LaneKey, SampleKey
from torch_radbp.tensors.record import joined
from torch_radbp.tensors.stage import stage
from torch_radbp.tensors.vec import Vec2, rows

PARTS, TURNS = 6, 2  # into which steps are divided, again and again, as often
# And again at outlines of curved mirrors and glass that the camera sees, if some have black strips there, which are as wide
# as triangles lie off the surface that they stand for.
TURNS_AT_OUTLINES = 3
MOST_TURNS = 16


class Crossings(NamedTuple):
    """K points of the film at which scans cross discontinuity curves."""

    low: Vec2  # neighbouring points on either side; pixels from the upper left corner of the window
    high: Vec2
    aperture: Vec2 | None
    key: LaneKey
    looks: LightLooks | None
    times: Tensor  # (K,) float64, square pixels per scan, divided by the probability of being followed
    kind: Tensor  # (K,) int32, how the two paths differ
    depth: Tensor  # (K,) int64, number of vertices before they do
    below: Reached  # where the path from the low point goes there; on a horizon, what it leaves
    above: Reached  # where that from the high point goes


class ScanSteps(NamedTuple):
    """N steps between points of scans, and how the paths from both ends differ."""

    ends: Pairing
    times: Tensor  # (N,) float64, see `Crossings`
    found: Difference


def curve_crossings(searched: Searched, scans: Scans, lot: int) -> Crossings | None:
    """Finds crossings of scans and curves by bisection, at most one for each step of a scan; None: there are none.

    Args:
        scans: of the view.
        lot: the number of this part of all scans, for random numbers.
    """
    count, points = len(scans.times), points_of(scans)
    path, ends = paths_from(searched, points), neighbours(count, scans.times.device)
    found, begin = parting(searched, path, ends), begins(path)
    kept = torch.where(begin[ends.first] | begin[ends.second], found.likelihood, 0.0)
    own = (draws(searched, len(kept), MOST_TURNS * lot) < kept).nonzero().squeeze(1)
    pairs = ScanSteps(*rows((ends, scans.times[ends.first % count] / kept.clamp_min(1e-300), found), own))
    every, number = torch.cat(pairs.ends), torch.arange(len(own), device=own.device)
    points, path = rows(points, every), some_paths(path, every)  # most points are at no step that is looked at further
    pairs = pairs._replace(ends=Pairing(number, number + len(own)))
    for turn in range(TURNS):
        if not len(pairs.times):
            return None
        points, path, pairs = divided(searched, points, path, pairs, turn + 1 + MOST_TURNS * lot)
    if searched.strips:
        for turn in range(TURNS, TURNS + TURNS_AT_OUTLINES):
            points, path, pairs = divided_at_outlines(searched, points, path, pairs, turn + 1 + MOST_TURNS * lot)
    (first, second), times, found = pairs
    own = ((found.depth > 0) & (found.kind != CHANCE) & (found.kind != BENT)).nonzero().squeeze(1)
    if not len(own):
        return None
    first, second, times, kind, depth = rows((first, second, times, found.kind, found.depth.long()), own)
    met = depth - (kind == HORIZON).long()
    below, above = along(path, first, met), along(path, second, met)
    # Inside of a smooth mesh rays do not turn at edges, but the triangles do that they leave: they may pass behind there.
    at_edge = (kind == HORIZON) & (below.hit.prim != above.hit.prim)
    kind, depth = torch.where(at_edge, SURFACE, kind), torch.where(at_edge, met, depth)
    aperture, key, looks = rows(points[1:], first)
    return Crossings(rows(points.film, first), rows(points.film, second), aperture, key, looks, times, kind, depth, below,
                     above)


def divided_at_outlines(searched: Searched, points: FilmPoints, path: IdealPath, pairs: ScanSteps,
                        turn: int) -> tuple[FilmPoints, IdealPath, ScanSteps]:
    """Divides, as `divided` does, the steps that cross a horizon, outline or rim of an ideal surface; keeps the others."""
    (first, second), _, found = pairs
    begin = begins(path)
    outline = ((found.kind == SURFACE) | (found.kind == RIM)) & (found.depth == 0) & (begin[first] | begin[second])
    closer = outline | (found.kind == HORIZON)
    own, others = (chosen.nonzero().squeeze(1) for chosen in (closer, ~closer))
    if not len(own):
        return points, path, pairs
    points, path, parts = divided(searched, points, path, rows(pairs, own), turn)
    return points, path, joined([rows(pairs, others), parts])


def draws(searched: Searched, count: int, turn: int) -> Tensor:
    """Uniform random numbers, (count,) float64, for one round of the bisection of steps; different in each `turn`."""
    lane = torch.arange(count, dtype=torch.int32, device=searched.call.scene.device)
    key = salted(searched.call.views[searched.number], SALT + 2)
    return searched.call.stages(drawn_by_steps)(key, lane, torch.full_like(key.seed, SALT + turn))


@stage()
def drawn_by_steps(key: SampleKey, lane: Tensor, counter: Tensor) -> Tensor:
    """Uniform random numbers for bisections, (N,) float64.

    Args:
        key: of the view.
        lane: (N,) int32, the numbers of the steps.
        counter: () int32, different in each turn of the bisection.
    """
    return uniform_numbers(key, lane, counter, torch.float64)


def divided(searched: Searched, points: FilmPoints, path: IdealPath, pairs: ScanSteps,
            turn: int) -> tuple[FilmPoints, IdealPath, ScanSteps]:
    """One round of bisection: each step, at whose ends paths see different things, is replaced with a part of it, picked at
    random among those of which that is true, too; returns points, paths and steps."""
    count, (first, second) = len(pairs.times), pairs.ends
    low, high = rows(points.film, first), rows(points.film, second)
    shares = [part / PARTS for part in range(1, PARTS)]
    between = FilmPoints(Vec2(*(torch.cat([a + (b - a) * share for share in shares]) for a, b in zip(low, high))),
                         *(joined([part] * len(shares)) for part in rows(points[1:], first)))
    more = torch.arange((PARTS - 1) * count, device=first.device) + len(path[0].place)
    points, path = joined([points, between]), extended(path, paths_from(searched, between))
    every = torch.cat([first, more, second])
    ends = Pairing(every[:-count], every[count:])  # the first part of all steps, then the second one, ...
    found = parting(searched, path, ends)
    sums = torch.stack(list(accumulate(found.likelihood.view(PARTS, count))))
    total = sums[-1]
    drawn = (draws(searched, count, turn) * total >= sums[:-1]).sum(0)
    own = (total > 0).nonzero().squeeze(1)
    ends, found = rows((ends, found), drawn[own] * count + own)
    return points, path, ScanSteps(ends, pairs.times[own] * total[own] / found.likelihood.clamp_min(1e-300), found)
