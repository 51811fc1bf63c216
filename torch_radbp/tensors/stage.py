"""Stages: functions over lanes, declared where they are defined; and how plain torch runs them.

    run = EAGER     # or `jit.stages.compiled()`
    place = run(film_place)(size, order, number, sample)
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol, TypeVar

import torch

from torch_radbp.tensors.plain_tangents import PlainTangents
from torch_radbp.tensors.record import leaves_of
from torch_radbp.tensors.torch_internals import inside_dual_level

Function = TypeVar("Function", bound=Callable)

DECLARED: dict[Callable, tuple[str, ...]] = {}  # each stage that is imported, with the names of its tables
REPEATED: dict[Callable, str] = {}  # stages that a kernel of a GPU repeats by itself, with the name of what they return anew


def stage(*tables: str, repeats: str | None = None) -> Callable[[Function], Function]:
    """Declares a function as a stage, which runs in plain torch or is compiled to one loop over lanes.

    It stays an ordinary function of torch, and other stages may call it. Depth and seed are tensors, so that bounces,
    chunks, iterations and scenes of the same kinds of things share one loop.

    Args:
        tables: names of the arguments that are read at indices, of any length; tensors of shape (N,) in the others have a
            value for each lane.
        repeats: the name of the table, a record with a flag `running`, whose next state the stage returns for its lanes.
            Where kernels repeat by themselves (`Target.repeats`) a call goes on until the flag of each lane is false;
            elsewhere it makes one step. None: the stage is not repeated.
    """
    def declare(function: Function) -> Function:
        DECLARED[function] = tables
        if repeats is not None:
            REPEATED[function] = repeats
        return function

    return declare


class Stage(Protocol):
    """A stage that can be run: compiled, or in plain torch.

    Attributes:
        is_compiled: whether it is one loop over lanes, which writes into what exists as easily as into new tensors.
    """

    is_compiled: bool

    def __call__(self, *arguments): ...

    def knowing(self, *arguments) -> Stage:
        """A copy of the stage, prepared for calls whose first arguments are these objects."""

    def taken(self, **arguments) -> tuple:
        """Prepares arguments, given by name, for several calls."""

    def room(self, results) -> Any:
        """Prepares tensors of results for several calls of `into`."""

    def into(self, results, first: int, *arguments) -> None:
        """Writes what a call would return into the tensors of `results`, from the entry `first` on."""


class Stages(Protocol):
    """A way to run stages: plain torch, or compiled. Called with a function it returns its `Stage`, always the same."""

    is_compiled: bool

    def __call__(self, function: Callable) -> Stage: ...


class PlainStage:
    """A stage that runs in plain torch."""

    is_compiled = False

    def __init__(self, function: Callable):
        self.function = function

    def __call__(self, *arguments):
        if not inside_dual_level() or torch.is_grad_enabled():
            return self.function(*arguments)
        with PlainTangents():
            return self.function(*arguments)

    def knowing(self, *arguments) -> PlainStage:
        return self

    def taken(self, **arguments) -> tuple:
        return tuple(arguments.values())

    def room(self, results) -> Any:
        return results

    def into(self, results, first: int, *arguments) -> None:
        write(results, first, self.function(*arguments))


class PlainStages:
    """Runs all stages in plain torch.

    Args:
        instead: functions that run in the place of stages.
    """

    is_compiled = False

    def __init__(self, instead: Mapping[Callable, Callable] = {}):
        self.instead, self.made = instead, {}

    def __call__(self, function: Callable) -> PlainStage:
        stage = self.made.get(function)
        if stage is None:
            stage = self.made.setdefault(function, PlainStage(self.instead.get(function, function)))
        return stage


EAGER = PlainStages()


def write(results, first: int, values) -> None:
    """Copies values into the tensors of `results` from the entry `first` on; skips None."""
    for target, value in zip(leaves_of(results), leaves_of(values)):
        if target is not None and value is not None:
            target[first:first + len(value)] = value
