"""Entry points of the public interface, in which torch's own modes are switched off.

`torch.autocast` would round matrix products to 8 bits of mantissa, so that poses, and with them images, would be off by a
percent. `torch.compile` would trace a loop over bounces, whose length depends on the paths, through a foreign library: it
calls it instead, as it is, and compiles what is around. Both are modes of a thread, which worker threads do not inherit.
Nor do torch's own threads take part in its operations, see `threads/team.py`.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Any, TypeVar, cast

import torch

from torch_radbp.plugin import nearest
from torch_radbp.tensors.torch_internals import without_compiler
from torch_radbp.threads.team import alone_in_torch

Function = TypeVar("Function", bound=Callable)


@contextmanager
def without_modes() -> Iterator[None]:
    """A context in which autocast, compilation and torch's threading are off, on this thread."""
    with without_compiler(), without_autocast("cpu"), without_autocast("cuda"), alone_in_torch():
        yield


def without_autocast(device_type: str) -> AbstractContextManager:
    """A context without autocast on a kind of device."""
    return torch.autocast(device_type, enabled=False) if torch.is_autocast_enabled(device_type) else nullcontext()


def public_call(function: Function) -> Function:
    """Decorates a public function: runs it without torch's modes, and names unknown arguments with the nearest."""
    parameters = inspect.signature(function).parameters.values()
    known = {each.name for each in parameters if each.name != "self"}
    takes_any = any(each.kind is each.VAR_KEYWORD for each in parameters)

    @functools.wraps(function)
    def called(*arguments, **settings):
        for name in settings if not takes_any else ():
            if name not in known:
                raise TypeError(f"{function.__qualname__}() has no argument {name!r}; {nearest(name, known)}")
        with without_modes():
            return function(*arguments, **settings)

    vars(called)["_torchdynamo_disable"] = True
    return cast(Function, called)


def passing_on(names: Iterable[str], source: Callable, **defaults: Any) -> Callable[[Function], Function]:
    """Shows the keywords that a function passes on as `**settings` in its signature, for completion and `help`.

    Args:
        names: of the keywords: the `TypedDict` that the function's `**settings` unpacks, for type checkers to read.
        source: what they are passed to, which has their types and defaults.
        **defaults: of the function that differ from those.
    """
    passed = inspect.signature(source).parameters

    def shown(function: Function) -> Function:
        *given, settings = inspect.signature(function).parameters.values()
        assert settings.kind is settings.VAR_KEYWORD
        named = [passed[name].replace(kind=settings.KEYWORD_ONLY, default=defaults.get(name, passed[name].default))
                 for name in names]
        setattr(function, "__signature__", inspect.signature(function).replace(parameters=[*given, *named]))  # noqa: B010
        return function

    return shown
