"""A cache decorator that is safe to use on several threads."""

from __future__ import annotations

import functools
from collections.abc import Callable
from threading import Lock
from typing import TypeVar

Made = TypeVar("Made")


def made_once(make: Callable[..., Made]) -> Callable[..., Made]:
    """A thread-safe cache decorator: each result is computed once, also if several threads need it at the same time.

    `functools.cache` would let each make one, and free what one of them is running.
    """
    made: dict[tuple, Made] = {}
    making = Lock()

    @functools.wraps(make, updated=())
    def remembered(*arguments) -> Made:
        if arguments not in made:
            with making:
                if arguments not in made:
                    made[arguments] = make(*arguments)
        return made[arguments]

    return remembered
