"""The schedule of checkpoints: depths at which path states are kept, and the order of the backward sweep.

Pure functions of (number of bounces, stride) that return plain values, so that coverage, order of replayed steps and number
of states can be tested without a renderer. "Depth d" below is the d-th bounce, counted from 0.

How many bounces paths take is known only when the last has ended: roulette ends them long before the greatest depth, which
may be unlimited. So the forward pass asks after every bounce which of its states it still needs.

Reference: Li 2020, section 2 (every k-th depth; or log N of them); Griewank 1992 for recursive bisection.
"""

from __future__ import annotations

from typing import NamedTuple

LOAD, ADVANCE, KEEP, ADJOINT, DROP = "load", "advance", "keep", "adjoint", "drop"


class Action(NamedTuple):
    """One step of the backward sweep's plan: restore, replay, keep, differentiate or drop a state."""

    kind: str
    """load: make the kept state of `depth` the current one. advance: replay bounce `depth` of the current state. keep: keep
    the current state, which has reached `depth`. adjoint: differentiate bounce `depth` from its kept state. drop: forget
    the kept state of `depth`."""
    depth: int


def kept_depths(bounces: int, stride: int | str, most: int | None = None) -> tuple[int, ...]:
    """The depths whose path states are kept after `bounces` bounces: some of those kept one bounce before, and the last.

    Args:
        bounces: how many were taken so far, N.
        stride: every `stride`-th; "sqrt" for about sqrt(N) of them, every s-th with s the least power of two whose square
            is at least N / 2; "log" for the depths most * (1 - 2^-i), i = 0, 1, ..., about log2(most) of them.
        most: the greatest number of bounces that there may be; None: `bounces`. Used by "log" only.
    """
    if stride == "log":
        depths, first, most = [], 0, bounces if most is None else most
        while first < bounces:
            depths.append(first)
            first = first + (most - first + 1) // 2
        return tuple(depths)
    return tuple(range(0, bounces, square_root_step(bounces) if stride == "sqrt" else int(stride)))


def square_root_step(bounces: int) -> int:
    """The step s for stride "sqrt": the least power of two with 2 s^2 >= N; at most 2.13 sqrt(N) states are held at once."""
    step = 1
    while 2 * step * step < bounces:
        step *= 2
    return step


def backward_plan(bounces: int, kept: tuple[int, ...], stride: int | str) -> list[Action]:
    """The plan that differentiates bounces `bounces - 1` down to 0, each once.

    Args:
        bounces: how many bounces the forward pass took.
        kept: depths whose states it kept, ascending, the first of them 0.
        stride: as given to `kept_depths`; decides how a segment between two kept states is replayed.
    """
    kept = tuple(depth for depth in kept if depth < bounces)
    plan: list[Action] = []
    for first, end in reversed(list(zip(kept, kept[1:] + (bounces,)))):
        if stride == "log":
            bisect(first, end, plan)
        else:
            replay_segment(first, end, plan)
    return plan


def replay_segment(first: int, end: int, plan: list[Action]) -> None:
    """Plans to replay the bounces `first` to `end` once, keeping every state."""
    plan.append(Action(LOAD, first))
    for depth in range(first, end - 1):
        plan += [Action(ADVANCE, depth), Action(KEEP, depth + 1)]
    for depth in reversed(range(first, end)):
        plan += [Action(ADJOINT, depth), Action(DROP, depth)]


def bisect(first: int, end: int, plan: list[Action]) -> None:
    """Plans to halve a segment recursively: log2(length) states at a time, length * log2(length) / 2 replays."""
    if end - first == 1:
        plan += [Action(ADJOINT, first), Action(DROP, first)]
        return
    middle = first + (end - first + 1) // 2
    plan.append(Action(LOAD, first))
    plan += [Action(ADVANCE, depth) for depth in range(first, middle)]
    plan.append(Action(KEEP, middle))
    bisect(middle, end, plan)
    bisect(first, middle, plan)
