"""Where users call in, and torch's own modes end.

`torch.autocast` would round matrix products to 8 bits of mantissa, so that poses, and with them images, would be off by a
percent. `torch.compile` would trace a loop over bounces, whose length depends on the paths, through a foreign library: it
calls it instead, as it is, and compiles what is around. Both are modes of a thread, which worker threads do not inherit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TypeVar

import torch
from torch._C._dynamo.eval_frame import set_eval_frame
from torch.utils._contextlib import context_decorator

Function = TypeVar("Function", bound=Callable)


@contextmanager
def without_modes() -> Iterator[None]:
    """Neither autocast nor compilation on this thread."""
    compiler = set_eval_frame(None)
    try:
        with torch.autocast("cpu", enabled=False), torch.autocast("cuda", enabled=False):
            yield
    finally:
        set_eval_frame(compiler)


def entry(function: Function) -> Function:
    """`function`, which runs without those modes.

    It does what `torch.compiler.disable` does, without the three seconds in which that imports the compiler.
    """
    called = context_decorator(without_modes, function)
    called._torchdynamo_disable = True
    return called
