"""Whole paths as machine code: where nobody asks for what happens on the way, tiles of lanes take all bounces at once.

Each bounce is recorded as in `recorded_bounce.py`, but for its results: all that is left of it is who goes on.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import torch

from torch_radbp.jit.recorded import Given, Recorded
from torch_radbp.jit.recording import ALL, NotRecordable, Recording, Reserve, listening
from torch_radbp.jit.structure import flatten
from torch_radbp.jit.tiles import TILE, Handed, Step, handed, run_in_tiles
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.recorded_bounce import RECORDINGS, Tables, recordable, tensors_of, without_contents
from torch_radbp.path.state import PathState
from torch_radbp.path.wavefront import Onward, bounced, first_hit
from torch_radbp.raycast.protocol import Hit
from torch_radbp.tensors.vec import Vec3

MOST_BOUNCES = 64


class Link(NamedTuple):
    """A bounce of which only those are asked for that go on."""

    recorded: Recorded
    handed: Handed
    onward: Onward  # without contents


def goes_whole(integrand: Integrand, lanes: int, depth: int = 0) -> bool:
    """True if so many paths from a depth on may be traced whole: there are enough to make a tile's memory worth it, and what
    they meet asks nobody outside."""
    return (lanes >= TILE and recordable(integrand) and integrand.max_depth - depth <= MOST_BOUNCES
            and not integrand.proposal.layout.reads_outside)


def traced_whole(integrand: Integrand, start: PathState, hit: Hit | None = None, depth: int = 0) -> Vec3 | None:
    """What `trace.trace` returns, (N,), for paths that nobody visits; None if they cannot be traced so. Args as there."""
    if not goes_whole(integrand, len(start.lane), depth):
        return None
    L = Vec3.buffer(start.beta.x)
    if integrand.max_depth <= depth:
        return L
    if depth == 0 and hit is None and integrand.rejects_hits:
        hit = first_hit(integrand, start.ray, depth)
    tables, onward = Tables(integrand, start.pdf.dtype), Onward(start, None)
    steps = []
    for bounce in range(depth, integrand.max_depth):
        lanes = tensors_of((onward, hit))
        varying = Given([*lanes, *tensors_of((L, integrand.at(bounce)))])
        if not all([leaf.is_contiguous() for leaf in varying.items]):
            return None
        structure: list = []
        flatten((onward, hit, L), [], structure)
        key = ("whole", RECORDINGS.kind(tables.kind, *structure), varying.pattern, integrand.settings_at(bounce),
               integrand.is_last(bounce), bounce == 0)
        link = RECORDINGS.of(key, partial(record_link, integrand, tables, onward, bounce, hit, L))
        if link is None:
            return None
        steps.append(Step(link.recorded, link.handed, Given([*varying.items, *tables.given.items]), len(lanes)))
        onward, hit = link.onward, None
    integrand.caster.count(run_in_tiles(steps, len(start.lane)))
    return L


def record_link(integrand: Integrand, tables: Tables, onward: Onward, depth: int, hit: Hit | None, L: Vec3) -> Link | None:
    """Records a bounce like this one; None if that is not possible."""
    reserve = Reserve()
    paths = without_contents(onward.paths, reserve, ALL if onward.alive is None else ALL + 1)  # of which some end
    onward = Onward(paths, without_contents((onward.alive,), reserve)[0])
    hit, L = without_contents((hit, L), reserve)
    given = [*tensors_of((onward, hit, L, integrand.at(depth))), *tables.given.items]
    listener = Recording(given, reserve=reserve)
    try:
        with torch.no_grad(), listening(listener):
            _, _, onward = bounced(integrand, onward, depth, hit, L)
        recorded = Recorded(listener, given, () if integrand.is_last(depth) else onward)
        return Link(recorded, handed(recorded), onward)
    except NotRecordable:
        return None
