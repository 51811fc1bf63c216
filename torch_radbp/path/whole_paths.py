"""Whole paths as machine code, for images alone: small blocks ("tiles") of lanes take all bounces at once.

Each bounce is recorded as in `taped_bounces.py`, but for its results: all that is left of it is who goes on.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from torch_radbp.jit.dual import dual, tangents_and_tensors
from torch_radbp.jit.tape import Played
from torch_radbp.jit.tiles import TILE, TileStep, run_in_tiles
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.state import Position
from torch_radbp.path.step import Onward
from torch_radbp.path.taped_bounces import Bounce, blank_lanes, recordable, tape_of, with_first_hit
from torch_radbp.path.wavefront import BroughtToFilm, bounced, film_buffer, radiance_buffer
from torch_radbp.tensors.vec import Vec3

MOST_BOUNCES = 64
FEW_BOUNCES = 8  # of which all may wait for their deposit on the film


def goes_whole(integrand: Integrand, lanes: int, depth: int = 0) -> bool:
    """True if `lanes` paths can be traced by machine code for whole paths: at least a tile of them, and no networks to
    evaluate."""
    return (lanes >= TILE and recordable(integrand) and not integrand.target.counts_stay
            and integrand.bounces - depth <= MOST_BOUNCES and not integrand.proposal.layout.reads_outside)


def traced_whole(integrand: Integrand, onward: Onward, depth: int = 0, bounce: Bounce = bounced) -> Vec3 | None:
    """The radiance of paths, (N,), traced from first to last bounce by machine code; None if that is not possible.

    Args:
        integrand, depth, bounce: as for `trace.trace`.
        onward: the paths.
    """
    if not goes_whole(integrand, onward.count, depth):
        return None
    L = radiance_buffer(integrand, onward.paths)
    return L if take_whole(integrand, onward, [L] * (integrand.bounces - depth), depth, bounce) else None


def brought_by_whole_paths(integrand: Integrand, onward: Onward, bounce: Bounce = bounced) -> list[BroughtToFilm] | None:
    """What each bounce of paths from lamps contributes to the film, (N,) each; None if whole paths cannot be traced. Args as
    for `traced_whole`."""
    if integrand.bounces > FEW_BOUNCES or not goes_whole(integrand, onward.count):
        return None
    brought = [film_buffer(integrand, onward.paths) for _ in range(integrand.bounces)]
    return brought if take_whole(integrand, onward, brought, 0, bounce) else None


def take_whole(integrand: Integrand, onward: Onward, totals: Sequence[Vec3 | BroughtToFilm], depth: int,
               bounce: Bounce) -> bool:
    """Takes all bounces of paths by machine code; each adds to one of `totals`. Returns False if they cannot be recorded."""
    dtype = onward.paths.pdf.dtype
    if not totals:
        return True
    if depth == 0 and onward.hit is None and integrand.rejects_hits:
        onward = with_first_hit(integrand, onward)
    tape, lanes, steps = tape_of(integrand, dtype), onward.count, []
    for number, total in enumerate(totals, depth):
        step, key = step_of(bounce, integrand, number), (bounce, *integrand.kind_at(number))
        link, given = tape.link(key, step, (onward, total, integrand.at(number)), blank_lanes)
        if link is None:
            return False
        steps.append(TileStep(link.recorded, link.handed, given, len(tangents_and_tensors(onward))))
        onward = dual(*link.results)
    integrand.caster.count(run_in_tiles(steps, lanes))
    return True


def step_of(bounce: Bounce, integrand: Integrand, depth: int) -> Callable[[Onward, Vec3, Position], Played]:
    """A recordable function that takes a bounce, adds its radiance to a total, and returns only the paths that go on."""
    def step(onward: Onward, total: Vec3 | BroughtToFilm, at: Position) -> Played:
        _, _, onward = bounce(integrand, onward, depth, total)
        return Played(() if depth + 1 == integrand.bounces else onward)

    return step
