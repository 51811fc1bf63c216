"""Where users call in, and torch's own modes end.

`torch.autocast` would round matrix products to 8 bits of mantissa, so that poses, and with them images, would be off by a
percent. `torch.compile` would trace a loop over bounces, whose length depends on the paths, through a foreign library: it
calls it instead, as it is, and compiles what is around. Both are modes of a thread, which worker threads do not inherit.
Nor do torch's own threads take part in its operations, see `jit/team.py`.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import TypeVar

import torch

from torch_radbp.jit.team import alone_in_torch
from torch_radbp.plugin import nearest
from torch_radbp.tensors.torch_internals import without_compiler

Function = TypeVar("Function", bound=Callable)


@contextmanager
def without_modes() -> Iterator[None]:
    """Neither autocast nor compilation nor operations on several threads, on this thread."""
    with without_compiler(), without_autocast("cpu"), without_autocast("cuda"), alone_in_torch():
        yield


def without_autocast(device_type: str) -> AbstractContextManager:
    """Operations on a kind of device keep the precision of what they are given."""
    return torch.autocast(device_type, enabled=False) if torch.is_autocast_enabled(device_type) else nullcontext()


def public_call(function: Function) -> Function:
    """`function`, which runs without those modes, and names an argument that is unknown, and the nearest."""
    known = arguments_of(function)
    takes_any = any(each.kind is each.VAR_KEYWORD for each in inspect.signature(function).parameters.values())

    @functools.wraps(function)
    def called(*arguments, **settings):
        if not takes_any:
            check_arguments(function, settings, known)
        with without_modes():
            return function(*arguments, **settings)

    called._torchdynamo_disable = True
    return called


def arguments_of(*functions: Callable) -> set[str]:
    """The names of the arguments that functions take."""
    return {name for function in functions for name, each in inspect.signature(function).parameters.items()
            if name != "self" and each.kind is not each.VAR_KEYWORD}


def check_arguments(function: Callable, given: Iterable[str], known: set[str]) -> None:
    """Raises TypeError naming the first argument given to a function that is not among the known ones."""
    for name in given:
        if name not in known:
            raise TypeError(f"{function.__qualname__}() has no argument {name!r}; {nearest(name, known)}")
