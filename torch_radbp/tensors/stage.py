"""Stages: functions that run over lanes, declared where they are defined."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

Function = TypeVar("Function", bound=Callable)

DECLARED: dict[Callable, tuple[str, ...]] = {}  # each stage that is imported, with the names of its tables


def stage(*tables: str) -> Callable[[Function], Function]:
    """Declares a function as a stage: `jit.stages` runs it in plain torch or as one loop.

    It stays an ordinary function of torch, and other stages may call it. Depth and seed are tensors, so that bounces,
    chunks, iterations and scenes of the same kinds of things share one loop.

    Args:
        tables: names of the arguments that are read at indices, of any length; tensors of shape (N,) in the others have a
            value for each lane.
    """
    def declare(function: Function) -> Function:
        DECLARED[function] = tables
        return function

    return declare
