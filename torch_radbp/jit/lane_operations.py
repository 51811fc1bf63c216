"""The operations that a `Recording` consists of."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol

import torch


class Span(NamedTuple):
    """Lanes between two counts, by their numbers; count 0 is zero, count 1 all lanes."""

    first: int
    last: int


class Place(NamedTuple):
    """Where a loop reads or writes."""

    made: bool  # a tensor that was made while recording; else one that is given
    tensor: int  # its number
    first: int = 0  # the number of the count of entries that come before
    size: int = 4  # bytes of an entry


class Body(Protocol):
    """A loop's body that may not have been compiled yet."""

    @property
    def address(self) -> int:
        """Where it lies, once it has been; see `team.LaneLoop`."""


class Loop(NamedTuple):
    """A loop over lanes."""

    body: int | Body  # or its address
    lanes: Span
    part: int
    inputs: tuple[Place, ...]
    lengths: tuple[Span, ...] | None  # of those that were made; None: lengths are not read
    outputs: tuple[Place, ...]


class Partition(NamedTuple):
    """`order.partition`."""

    number: Place
    lanes: Span
    queues: int
    order: Place
    first: int  # the number of the first count that it finds: where the queue 1 begins


class Chosen(NamedTuple):
    """`order.chosen`."""

    flags: Place
    lanes: Span
    order: Place
    count: int  # the number of the count that it finds


class Put(NamedTuple):
    """`order.put`, of entries of one size."""

    place: Place
    lanes: Span
    pairs: tuple[tuple[Place, Place], ...]  # entry and target


class Inverted(NamedTuple):
    """`order.inverted`, or `order.nothing` where there are no flags."""

    flags: Place | None
    lanes: Span
    result: Place


class Copy(NamedTuple):
    """Entries of one tensor, to another: a result that is the same as one before, see `LaneFunction.into`."""

    source: Place
    target: Place
    lanes: Span


class Added(NamedTuple):
    """An `Addition` of `scatter.scatter_add`."""

    loop: int  # address of the function
    index: Place
    touched: Place
    step: int  # from entry to entry of the totals
    mask: int  # the number of copies less 1
    numbers: tuple[Place, ...]
    totals: tuple[Place, ...]


class Scattered(NamedTuple):
    """`scatter.scatter_add`."""

    groups: tuple[tuple[Added, ...], ...]  # that may run side by side
    lanes: Span


class Given(NamedTuple):
    """What is given outside of some lanes, and handed back for them."""

    lanes: Span
    inputs: tuple[Place, ...]
    outputs: tuple[Place, ...]


class Outside(NamedTuple):
    """What is done by others than machine code, see `recording.outside`."""

    work: Callable
    context: int  # which of those that the recording is told
    parts: tuple[Given, ...]

    @property
    def outputs(self) -> tuple[Place, ...]:
        """Of all parts."""
        return tuple(place for part in self.parts for place in part.outputs)


class Made(NamedTuple):
    """A tensor that was made while recording."""

    dtype: torch.dtype
    lanes: Span


Operation = Loop | Partition | Chosen | Put | Inverted | Copy | Scattered | Outside
