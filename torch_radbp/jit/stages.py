"""Runs stages as compiled loops over lanes; `tensors/stage.py` says what a stage is."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from copy import copy

import torch

from torch_radbp.jit.arguments import PreparedArgument
from torch_radbp.jit.dual import DualFunction
from torch_radbp.jit.lane.refusal import UnknownOperation
from torch_radbp.jit.run import LaneFunction
from torch_radbp.jit.target import Target, target_of
from torch_radbp.tensors.differentiated import any_differentiated
from torch_radbp.tensors.stage import DECLARED, REPEATED, write
from torch_radbp.tensors.torch_internals import inside_dual_level
from torch_radbp.threads.allocator import keep_freed_memory
from torch_radbp.threads.made_once import made_once


class CompiledStage:
    """A stage compiled for each kind of scene; if it cannot be compiled, it runs in plain torch and warns once.

    Of dual tensors, in forward mode, values and tangents are computed in one loop.

    Args:
        function: the stage.
        tables: see `tensors.stage.stage`.
        target: see `CompiledStages`.
    """

    is_compiled = True

    def __init__(self, function: Callable, tables: tuple[str, ...], target: Target | None = None):
        self.function, self.fused = function, LaneFunction(function, tables, target, REPEATED.get(function))
        self.dual = DualFunction(function, tables, target)
        self.told: list[str] = []  # why it could not be compiled, once said; one list for all copies

    def knowing(self, *arguments) -> CompiledStage:
        other = copy(self)
        other.fused = self.fused.knowing(*arguments)
        other.dual = self.dual.knowing(*map(as_it_is, arguments))
        return other

    def taken(self, **arguments) -> tuple[PreparedArgument, ...]:
        return self.fused.taken(**arguments)

    def room(self, results) -> PreparedArgument:
        return self.fused.room(results)

    def __call__(self, *arguments):
        try:
            if inside_dual_level() and (parts := self.dual.parts(tuple(map(as_it_is, arguments)))).moving:
                return self.dual.of_parts(parts)
            return self.fused(*arguments)
        except UnknownOperation as error:
            return self.eagerly(error, arguments)

    def into(self, results, first: int, *arguments) -> None:
        try:
            if inside_dual_level() and any_differentiated(as_it_is(results)):
                parts = self.dual.parts(tuple(map(as_it_is, arguments)))
                return self.dual.into(as_it_is(results), first, parts)
            self.fused.into(results, first, *arguments)
        except UnknownOperation as error:
            write(as_it_is(results), first, self.eagerly(error, arguments))

    def eagerly(self, error: UnknownOperation, arguments: tuple):
        """Runs the stage in plain torch; warns once why."""
        if not self.told:
            self.told.append(str(error))
            warnings.warn(f"{self.function.__name__} runs eagerly, which is slower: {error}", RuntimeWarning, stacklevel=3)
        return self.function(*map(as_it_is, arguments))


class CompiledStages:
    """A way to run stages, functions over lanes: each as one loop, compiled at its first call.

    Args:
        target: for which they are compiled; None: for the device that the tensors of a call lie on.
    """

    is_compiled = True

    def __init__(self, target: Target | None = None):
        self.target, self.made = target, {}

    def __call__(self, function: Callable) -> CompiledStage:
        stage = self.made.get(function)
        if stage is None:
            stage = self.made.setdefault(function, CompiledStage(function, DECLARED[function], self.target))
        return stage

    def target_on(self, device: torch.device) -> Target:
        """The target for which stages are compiled if their tensors lie on a device."""
        return target_of(device) if self.target is None else self.target

    def __iter__(self) -> Iterator[CompiledStage]:
        """Iterates over the stages that were called."""
        return iter(self.made.values())


@made_once
def compiled() -> CompiledStages:
    """The way to run stages as compiled loops that all renderings of this process share."""
    keep_freed_memory()
    return CompiledStages()


def as_it_is(argument):
    """The records and tensors of an argument, which may have been wrapped with their addresses, for several calls."""
    return argument.argument if isinstance(argument, PreparedArgument) else argument
