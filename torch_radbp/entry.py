"""Where users call in, and torch's own modes end.

`torch.autocast` would round matrix products to 8 bits of mantissa, so that poses, and with them images, would be off by a
percent. `torch.compile` would trace a loop over bounces, whose length depends on the paths, through a foreign library: it
calls it instead, as it is, and compiles what is around. Both are modes of a thread, which worker threads do not inherit.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

import torch

from torch_radbp.jit.torch_internals import without_compiler

Function = TypeVar("Function", bound=Callable)


@contextmanager
def without_modes() -> Iterator[None]:
    """Neither autocast nor compilation on this thread."""
    with without_compiler(), torch.autocast("cpu", enabled=False), torch.autocast("cuda", enabled=False):
        yield


def entry(function: Function) -> Function:
    """`function`, which runs without those modes."""
    @functools.wraps(function)
    def called(*arguments, **settings):
        with without_modes():
            return function(*arguments, **settings)

    called._torchdynamo_disable = True
    return called
