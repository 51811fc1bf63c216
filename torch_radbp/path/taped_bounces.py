"""Bounces as machine code: a bounce is recorded once for scenes of one kind, and then replayed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import TypeVar

import torch

from torch_radbp.jit.cpu.board import Board, board
from torch_radbp.jit.dual import tangents_and_tensors, values_and_tangents
from torch_radbp.jit.recording.lane_count import LaneCount
from torch_radbp.jit.recording.recording import ALL, Reserve
from torch_radbp.jit.recording.repetitions import Repetitions
from torch_radbp.jit.tape import Played, Tape, without_contents
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.queues import EMPTY
from torch_radbp.path.sorting import first_hit
from torch_radbp.path.state import PathState, Position
from torch_radbp.path.step import Onward, Step
from torch_radbp.path.wavefront import bounced
from torch_radbp.tensors.differentiated import detached
from torch_radbp.tensors.record import leaves_of
from torch_radbp.tensors.torch_internals import inside_dual_level
from torch_radbp.tensors.vec import Vec3

Result = TypeVar("Result")
Bounce = Callable[[Integrand, Onward, int, Vec3 | None], tuple[PathState, Step, Onward]]  # `bounced`, or one that is like it
BounceOf = Callable[[Onward, int, Vec3 | None], tuple[PathState, Step, Onward]]  # the same of an integrand


@contextmanager
def bounces_taken(integrand: Integrand, dtype: torch.dtype, bounce: Bounce = bounced, waits: bool = True
                  ) -> Iterator[BounceOf]:
    """Yields a function that takes one bounce: `bounce`, or recorded machine code that does the same; `dtype`: of rays.

    Args:
        waits: False: do not wait for numbers of lanes that only a device knows; see `PathState.number`.
    """
    if not recordable(integrand):
        yield partial(bounce, integrand)
        return
    with board() as helpers:
        yield partial(played, bounce, integrand, tape_of(integrand, dtype, helpers), waits)


def recordable(integrand: Integrand) -> bool:
    """True if bounces can be recorded as machine code: stages are compiled, and autograd does not record them. Paths through
    boundaries of media are recorded on a processor if nothing moves, and on a GPU if the caller checks that repetitions were
    enough (`Integrand.repetitions`). Bounces with networks are not recorded in forward mode."""
    layout = integrand.proposal.layout
    return (integrand.stages.is_compiled and not (integrand.attached and torch.is_grad_enabled())
            and not (layout.traces_segments and integrand.repetitions is None
                     and (integrand.settings.moving or integrand.target.counts_stay))
            and not (layout.reads_outside and inside_dual_level())
            and (integrand.caster is None or integrand.caster.recorded_as is not None))


def keeps_all_lanes(integrand: Integrand) -> bool:
    """True if records of bounces have room for all lanes, since only the device knows how many lanes reach each."""
    return recordable(repeating(integrand, Repetitions(0, []))) and integrand.target.counts_stay


def repeating(integrand: Integrand, repetitions: Repetitions) -> Integrand:
    """The integrand with a fixed number of repetitions for loops whose end the host does not see; unchanged without such
    loops. The caller checks that they were enough."""
    return integrand._replace(repetitions=repetitions) if repeats_unseen(integrand) else integrand


def repeats_unseen(integrand: Integrand) -> bool:
    """True if there are loops (through media) on a device whose end the host does not see without waiting."""
    return integrand.proposal.layout.traces_segments and integrand.stages.is_compiled and integrand.target.counts_stay


def found_out(integrand: Integrand, work: Callable[[Integrand], Result]) -> Result:
    """The result of `work(integrand)`, redone with more repetitions until these were enough, unless the caller checks it.

    Args:
        integrand: the scene and how to step.
        work: a function that may be called several times.
    """
    if integrand.repetitions is not None or integrand.learnt is None or not repeats_unseen(integrand):
        return work(integrand)
    return integrand.learnt.found_out(lambda some: work(repeating(integrand, some)))


def tape_of(integrand: Integrand, dtype: torch.dtype, board: Board | None = None, more: tuple = (),
            kind: tuple = ()) -> Tape:
    """The tape that records and replays bounces through a scene.

    Args:
        integrand: the scene and how to step.
        dtype: of the rays.
        board: of the helper threads.
        more: further tensors that steps read.
        kind: further static values that steps depend on.
    """
    caster = integrand.caster
    numbers = [integrand.no_appearance, *([] if integrand.differentiated is None else [integrand.differentiated])]
    tables = [*numbers, *tangents_and_tensors(integrand.scene), *(() if caster is None else caster.reads(dtype)), *more]
    present = [part is not None for part in (integrand.clipping, integrand.differentiated)]
    casts = None if caster is None else caster.recorded_as
    # Stages have the code that recordings call.
    kind = integrand.stages, integrand.proposal.layout, casts, *present, moving_leaves(integrand), *kind
    return Tape(tables, kind, (integrand.scene,), board, caster, integrand.target, integrand.repetitions)


def played(bounce: Bounce, integrand: Integrand, tape: Tape, waits: bool, onward: Onward, depth: int,
           L: Vec3 | None) -> tuple[PathState, Step, Onward]:
    """Takes a bounce by recorded machine code, or by `bounce` where that is not possible; other args as for `bounced`."""
    if depth == 0 and onward.hit is None and integrand.rejects_hits:
        tape.rest()
        onward = with_first_hit(integrand, onward)  # who knows how many rays it casts
    later = onward.hit is None and onward.alive is not None and not inside_dual_level()
    count = onward.count
    arguments = onward._replace(number=None), L, positions_taken(integrand, depth)
    found = tape.play(*recipe(bounce, integrand, depth), arguments, count, blank_lanes, "later" if later else None,
                      waits=waits)
    if found is None:
        return bounce(integrand, onward.cut_to_count(), depth, L)
    (state, step, onward), (*borders, going_on), queues = found
    places = zip(queues, borders[::2], borders[1::2], step.texture_values)
    there = [(queue._replace(first=first, last=last), values) for queue, first, last, values in places
             if isinstance(last, LaneCount) or last > first]
    queues, values = zip(*there) if there else ((EMPTY,), ((),))
    step = step._replace(queues=queues, texture_values=values)
    if isinstance(count, LaneCount):
        state = state._replace(number=count)
    return state, step, onward._replace(number=going_on) if isinstance(going_on, LaneCount) else onward


def positions_taken(integrand: Integrand, depth: int) -> tuple[Position, ...]:
    """The position of a bounce on its path; and of the next one, where its free flights are sampled in advance."""
    ahead = integrand.attached and integrand.settings.moving and bool(integrand.proposal.layout.media)
    return (integrand.at(depth), integrand.at(depth + 1)) if ahead else (integrand.at(depth),)


def recipe(bounce: Bounce, integrand: Integrand, depth: int) -> tuple[tuple, Callable]:
    """The key under which a tape keeps the recording of a bounce, and the function that takes the bounce to be recorded."""
    def step(onward: Onward, L: Vec3 | None, at: tuple[Position, ...]) -> Played:
        state, step, onward = bounce(integrand, onward, depth, L)
        counts = [border for queue in step.queues for border in (queue.first, queue.last)]
        return Played((state, step._replace(queues=()), onward), [*counts, len(onward.alive)], step.queues)

    return (bounce, *integrand.kind_at(depth)), step


def blank_lanes(arguments: tuple, reserve: Reserve) -> tuple:
    """The arguments of a bounce as empty tensors of the right shapes."""
    onward, L, at = arguments
    paths = without_contents(onward.paths, reserve, ALL if onward.alive is None else ALL + 1)  # of which some end
    alive, hit, flight, L = without_contents((onward.alive, onward.hit, onward.flight, L), reserve)
    return Onward(paths, alive, hit, flight=flight), L, at


def with_first_hit(integrand: Integrand, onward: Onward) -> Onward:
    """Camera paths with the hits of their first rays."""
    return onward._replace(hit=first_hit(integrand, detached(onward.packed(integrand).ray), 0))


def moving_leaves(integrand: Integrand) -> tuple[int, ...]:
    """The indices of the scene's tensors that have tangents in forward mode."""
    tangents = leaves_of(values_and_tangents(integrand.scene)[1]) if integrand.attached else ()
    return tuple([place for place, tangent in enumerate(tangents) if tangent is not None])
