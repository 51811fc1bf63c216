"""Values computed in the background, as machine code while tracing goes on."""

from __future__ import annotations

import atexit
import os
from collections.abc import Callable
from threading import Lock
from typing import Generic, TypeVar

from torch_radbp.threads import team

Made = TypeVar("Made")


class Later(Generic[Made]):
    """A value computed once: when it is needed, or before that by a helper thread.

    Args:
        make: called by one thread at a time, until it has returned.
    """

    ends = False  # True when the process ends: helpers start nothing more
    helping = Lock()  # held by the helper that computes: one at a time, as LLVM does

    def __init__(self, make: Callable[[], Made]):
        self.make: Callable[[], Made] | None = make
        self.making = Lock()

    def meanwhile(self) -> Later[Made]:
        """Returns itself, after asking a helper to compute the value."""
        team.COMPILERS.call(team.Task(self.helped), 1)
        return self

    def helped(self, task: team.Task) -> None:
        """Computes the value on a helper thread."""
        with self.helping:
            if not self.ends:
                self.result()

    def result(self) -> Made:
        """The value, computed now if necessary. If that fails, the error is raised, and a later call tries again."""
        if self.make is not None:
            with self.making:
                if self.make is not None:
                    self.made, self.make = self.make(), None  # in this order, as others look at `make` first
        return self.made


@atexit.register
def wait_for_helper() -> None:
    """Waits for the helper at exit: a process must not end inside of LLVM."""
    Later.ends = True
    with Later.helping:
        pass


if hasattr(os, "register_at_fork"):  # a forked process would find LLVM locked for ever
    os.register_at_fork(before=Later.helping.acquire, after_in_parent=Later.helping.release,
                        after_in_child=Later.helping.release)
