"""Warnings about parts of a file that a reader leaves out or repairs, once for each kind.

What can be left out or repaired is (a face of two corners, a frame whose image is missing), and the rest of the file is
read. What makes the result doubtful stays an error of the reader's.
"""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextvars import ContextVar

from torch_radbp.plugin import SceneError, SceneWarning

NAMED = 3  # places of a kind in a message; the others are counted

# The collector of the block that is open; None outside of one.
_OPEN: ContextVar[Repairs | None] = ContextVar("_OPEN", default=None)


class Repairs:
    """Collects what is left out or repaired in a file; at the end of the block one warning for each kind.

        with Repairs(strict) as repairs:
            repairs.add(f"{path}, frames[7]", "is left out: its image is missing")

    A block within another hands over to that one, so that a scene of a hundred meshes tells each kind once. A block that
    ends in an error tells nothing.

    Args:
        strict: the end of the block raises a SceneError that lists all kinds, instead of warnings. A strict block within
            one that is not stays strict.
        category: of the warnings.
    """

    def __init__(self, strict: bool = False, category: type[Warning] = SceneWarning):
        self.strict, self.category = strict, category
        self.places: dict[str, dict[str, None]] = {}  # of each kind, in the order in which they are met
        self.uncounted: dict[str, int] = {}  # how many there are of each kind beside

    def __enter__(self) -> Repairs:
        outer = _OPEN.get()
        self.shared = outer if outer is not None and (outer.strict or not self.strict) else None
        if self.shared is None:
            self.token = _OPEN.set(self)
        return self.shared or self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if self.shared is None:
            _OPEN.reset(self.token)
            if kind is None:
                self.tell()

    def add(self, place: str, what: str) -> None:
        """Notes a place in the file and its repair, as in "frames[7]", "is left out: ..."; duplicates count once."""
        self.places.setdefault(what, {}).setdefault(place)

    def add_rows(self, rows: Iterable[int], place: Callable[[int], str], what: str) -> None:
        """Notes many rows of an array at once; `place` names one."""
        rows = list(rows)
        for row in rows[:NAMED]:
            self.add(place(row), what)
        if len(rows) > NAMED:
            self.uncounted[what] = self.uncounted.get(what, 0) + len(rows) - NAMED

    def __iter__(self) -> Iterator[str]:
        """Yields a sentence for each kind, such as "a.json, frames[0], frames[1], frames[2] and 14 more: ..."."""
        for what, places in self.places.items():
            names, more = list(places)[:NAMED], len(places) + self.uncounted.get(what, 0) - NAMED
            shared = "".join(os.path.commonprefix(names).rpartition(", ")[:2])  # such as the file, said once
            listed = ", ".join(name[len(shared):] for name in names)
            yield f"{shared}{listed}{f' and {more} more' if more > 0 else ''}: {what}"

    def tell(self) -> None:
        """Warns of each kind, or raises SceneError with all of them."""
        if self.strict and self.places:
            raise SceneError("; ".join(self))
        for sentence in self:
            warnings.warn(sentence, self.category, stacklevel=_level_of_the_caller())


def _level_of_the_caller() -> int:
    """The stack level of the nearest caller outside of this package, as `warnings.warn` counts it."""
    frame, level = sys._getframe(1), 1
    while frame.f_back is not None and frame.f_globals.get("__name__", "").split(".")[0] in ("torch", "torch_radbp"):
        frame, level = frame.f_back, level + 1
    return level
