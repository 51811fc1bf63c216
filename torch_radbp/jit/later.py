"""What is made meanwhile: machine code, while the thread that will need it goes on tracing."""

from __future__ import annotations

import atexit
import os
from collections.abc import Callable
from threading import Lock
from typing import Generic, TypeVar

from torch_radbp.jit import team

Made = TypeVar("Made")


class Later(Generic[Made]):
    """Something that is made once: when it is asked for, or before that by a helper.

    Args:
        make: called by one thread at a time, until it has returned.
    """

    ends = False  # the process: helpers begin nothing more
    helping = Lock()  # what the helper holds that makes something: one at a time, as LLVM does

    def __init__(self, make: Callable[[], Made]):
        self.make: Callable[[], Made] | None = make
        self.making = Lock()

    def meanwhile(self) -> Later[Made]:
        """The same; a helper makes it as soon as it has the time."""
        team.COMPILERS.call(team.Task(self.helped), 1)
        return self

    def helped(self, task: team.Task) -> None:
        """What a helper does."""
        with self.helping:
            if not self.ends:
                self.result()

    def result(self) -> Made:
        """What is made. If that fails, whoever asks is told, and may ask again."""
        if self.make is not None:
            with self.making:
                if self.make is not None:
                    self.made, self.make = self.make(), None  # in this order, as others look at `make` first
        return self.made


@atexit.register
def wait_for_helper() -> None:
    """Lets the helper finish: a process does not end inside of LLVM."""
    Later.ends = True
    with Later.helping:
        pass


if hasattr(os, "register_at_fork"):  # a forked process would find LLVM locked for ever
    os.register_at_fork(before=Later.helping.acquire, after_in_parent=Later.helping.release,
                        after_in_child=Later.helping.release)
