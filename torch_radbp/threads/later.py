"""Values computed in the background, as machine code while tracing goes on."""

from __future__ import annotations

import atexit
import os
from collections.abc import Callable
from threading import Condition, Lock, RLock
from typing import Generic, TypeVar

from torch_radbp.threads import team

Made = TypeVar("Made")


MOST_ASSEMBLERS = 8  # threads


class Later(Generic[Made]):
    """A value computed once: when it is needed, or before that by a helper thread.

    Args:
        make: called by one thread at a time, until it has returned.
    """

    ends = False  # True when the process ends: helpers start nothing more
    helping = Lock()  # held by the helper that is inside of LLVM: one at a time, as LLVM does
    side_by_side, waiting = 0, Condition()  # helpers that compute beside each other, and who waits for them

    def __init__(self, make: Callable[[], Made]):
        self.make: Callable[[], Made] | None = make
        self.making = RLock()
        self.failed: Exception | None = None  # of a helper
        self.asked = False  # somebody needs the value, and computes it: helpers need not

    def meanwhile(self) -> Later[Made]:
        """Returns itself, after asking a helper to compute the value."""
        team.COMPILERS.call(team.Task(self.helped), 1)
        return self

    def beside(self) -> Later[Made]:
        """Returns itself, after asking a helper that computes beside others, and enters LLVM with the lock `helping`."""
        team.ASSEMBLERS.call(team.Task(self.helped_beside), 1, min(MOST_ASSEMBLERS, os.cpu_count() or 1))
        return self

    def helped(self, task: team.Task) -> None:
        """Computes the value on a helper thread."""
        with self.helping:
            if not self.ends:
                self.tried()

    def helped_beside(self, task: team.Task) -> None:
        """Computes the value on one of several helper threads."""
        with Later.waiting:
            if Later.ends:
                return
            Later.side_by_side += 1
        try:
            self.tried()
        finally:
            with Later.waiting:
                Later.side_by_side -= 1
                Later.waiting.notify_all()

    def tried(self) -> None:
        """Computes the value; an error waits for who needs it."""
        with self.making:  # until the error is told, so that nobody tries again meanwhile
            if not self.asked:
                try:
                    self.computed()
                except Exception as error:
                    self.failed = error

    def result(self) -> Made:
        """The value, computed now if necessary. If that fails, the error is raised, and a later call tries again."""
        self.asked = True
        return self.computed()

    def computed(self) -> Made:
        """The value, computed now if necessary by this thread, which may be a helper."""
        if self.make is not None:
            with self.making:
                if (failed := self.failed) is not None:
                    self.failed = None
                    raise failed
                if self.make is not None:
                    self.made, self.make = self.make(), None  # in this order, as others look at `make` first
        return self.made


@atexit.register
def wait_for_helpers() -> None:
    """Waits for helpers at exit: a process must not end inside of LLVM, or of a driver."""
    with Later.waiting:
        Later.ends = True
        Later.waiting.wait_for(lambda: not Later.side_by_side)
    with Later.helping:
        pass


if hasattr(os, "register_at_fork"):  # a forked process would find LLVM locked for ever
    os.register_at_fork(before=Later.helping.acquire, after_in_parent=Later.helping.release,
                        after_in_child=Later.helping.release)
