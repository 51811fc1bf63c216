"""Whole paths as machine code: where nobody asks for what happens on the way, tiles of lanes take all bounces at once.

Each bounce is recorded as in `recorded_bounce.py`, but for its results: all that is left of it is who goes on.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import torch

from torch_radbp.jit.dual import dual, parted, tensors_of
from torch_radbp.jit.recorded import Given, Recorded
from torch_radbp.jit.recording import NotRecordable, Recording, Reserve, listening
from torch_radbp.jit.tiles import TILE, Handed, Step, handed, run_in_tiles
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.recorded_bounce import (
    RECORDINGS,
    Bounce,
    Tables,
    lanes_without_contents,
    recordable,
    structure_of,
    with_first_hit,
)
from torch_radbp.path.wavefront import Onward, bounced, radiance_buffer
from torch_radbp.tensors.vec import Vec3

MOST_BOUNCES = 64


class Link(NamedTuple):
    """A bounce of which only those are asked for that go on."""

    recorded: Recorded
    handed: Handed
    onward: tuple[Onward, Onward]  # without contents, values and tangents: dual tensors do not outlive a call


def goes_whole(integrand: Integrand, lanes: int, depth: int = 0) -> bool:
    """True if so many paths from a depth on may be traced whole: there are enough to make a tile's memory worth it, and what
    they meet asks nobody outside."""
    return (lanes >= TILE and recordable(integrand) and integrand.max_depth - depth <= MOST_BOUNCES
            and not integrand.proposal.layout.reads_outside)


def traced_whole(integrand: Integrand, onward: Onward, depth: int = 0, bounce: Bounce = bounced) -> Vec3 | None:
    """What `trace.trace` returns, (N,), for paths that nobody visits; None if they cannot be traced so.

    Args:
        integrand, depth, bounce: as there.
        onward: all paths.
    """
    if not goes_whole(integrand, onward.count, depth):
        return None
    L, dtype = radiance_buffer(integrand, onward.paths), onward.paths.pdf.dtype
    if integrand.max_depth <= depth:
        return L
    if depth == 0 and onward.hit is None and integrand.rejects_hits:
        onward = with_first_hit(integrand, onward)
    tables, lanes, steps = Tables(integrand, dtype), onward.count, []
    for number in range(depth, integrand.max_depth):
        handed_on = tensors_of(onward)
        varying = Given([*handed_on, *tensors_of((L, integrand.at(number)))])
        if not all([leaf.is_contiguous() for leaf in varying.items]):
            return None
        key = ("whole", bounce, RECORDINGS.kind(tables.kind, *structure_of((onward, L))), varying.pattern,
               integrand.settings_at(number), integrand.is_last(number), number == 0)
        link = RECORDINGS.of(key, partial(record_link, bounce, integrand, tables, onward, number, L))
        if link is None:
            return None
        steps.append(Step(link.recorded, link.handed, Given([*varying.items, *tables.given.items]), len(handed_on)))
        onward = dual(*link.onward)
    integrand.caster.count(run_in_tiles(steps, lanes))
    return L


def record_link(bounce: Bounce, integrand: Integrand, tables: Tables, onward: Onward, depth: int, L: Vec3) -> Link | None:
    """Records a bounce like this one; None if that is not possible."""
    reserve = Reserve()
    onward, L = lanes_without_contents(onward, L, reserve)
    given = [*tensors_of(onward), *tensors_of((L, integrand.at(depth))), *tables.given.items]
    listener = Recording(given, reserve=reserve)
    try:
        with torch.no_grad(), listening(listener):
            _, _, onward = bounce(integrand, onward, depth, L)
        recorded = Recorded(listener, given, () if integrand.is_last(depth) else tensors_of(onward))
        return Link(recorded, handed(recorded), parted(onward))
    except NotRecordable:
        return None
