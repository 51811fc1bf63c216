"""Memoized adjoint radiance with a checkpoint schedule: the note's method, and the default."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from torch_radbp.adjoint.schedule import ADJOINT, ADVANCE, DROP, KEEP, LOAD, backward_plan, kept_depths
from torch_radbp.adjoint.strategy import AdjointStrategy
from torch_radbp.adjoint.sweep import Sweep
from torch_radbp.plugin import boolean, integer

STRIDES = ("sqrt", "log")


@dataclass(frozen=True)
class MemoizedAdjoint(AdjointStrategy):
    """Walks back over the bounces with the incident radiance of each in a memo; exact for every stride.

    With N bounces:

    | stride | path states kept | bounces replayed |
    |---|---|---|
    | 1 | N | 0 |
    | k | N / k + k | N |
    | "sqrt" | 2.1 sqrt N | N |
    | "log" | log2 N | N log2 N |

    N is the number of bounces that the longest path takes, which roulette keeps far below an unlimited `max_depth`.

    Args:
        stride: an integer >= 1, "sqrt" or "log".
        keep_hits: remember what each ray met (23 bytes a lane and bounce; 35 where lights are picked by a tree), and the
            values of networks (12 bytes each), so that the backward pass casts no ray and asks networks for gradients
            only. False bounds the memory strictly by the states above, at the price of doing both again.

    Raises:
        ValueError: for any other stride.

    Reference: Li 2020, "Deriving Radiative Backpropagation using the Recursive Form of Path Tracing", section 2.
    """

    stride: int | str = 1
    keep_hits: bool = True

    def __post_init__(self):
        object.__setattr__(self, "keep_hits", boolean("keep_hits", self.keep_hits))
        if self.stride not in STRIDES:
            try:
                object.__setattr__(self, "stride", integer("stride", self.stride, 1))
            except ValueError as error:
                raise ValueError(f"stride must be an integer of at least 1, {' or '.join(map(repr, STRIDES))}, "
                                 f"got {self.stride!r}") from error

    @property
    def records_all(self) -> bool:
        """True if the backward pass replays no bounce."""
        return self.stride == 1 and self.keep_hits

    def kept(self, bounces: int, most: int) -> tuple[int, ...]:
        """The depths at which the schedule keeps path states."""
        return kept_depths(bounces, self.stride, most)

    def replayed(self, reaching: Sequence[float], kept: tuple[int, ...], moving: bool) -> float:
        """The greatest number of path states that the schedule holds at once."""
        held = most = 0.0
        for action in backward_plan(len(reaching), kept, self.stride):
            if action.depth not in kept:
                held += {KEEP: 1, DROP: -1}.get(action.kind, 0) * reaching[action.depth]
                most = max(most, held)
        return most

    def backward(self, sweep: Sweep) -> None:
        """Differentiates all bounces in the order that the checkpoint schedule has planned."""
        record = sweep.record
        states = dict(record.states)
        if 0 not in states:
            states[0] = record.start()
        current = None
        for kind, depth in backward_plan(record.bounces, tuple(sorted(states)), self.stride):
            if kind == LOAD:
                current = states[depth]
            elif kind == ADVANCE:
                current = sweep.advance(current, depth)
            elif kind == KEEP:
                states[depth] = current
            elif kind == ADJOINT:
                sweep.adjoint(states[depth], depth)
            elif kind == DROP:
                del states[depth]
