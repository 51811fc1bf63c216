"""The errors and warnings about scene descriptions."""

from __future__ import annotations

import difflib
import sys
from collections.abc import Iterable


class SceneError(ValueError):
    """A scene description that cannot be used; the message names the place, what is there, and what is supported.

    The place is a file and a line in it (XML, meshes), or the path of keys (dicts, glTF).
    """


class SceneWarning(UserWarning):
    """A scene description that is read in another way than its author may have meant."""


def nearest(name: str, names: Iterable[str], alike: float = 0.5) -> str:
    """A sentence that lists known names, the most similar first: those whose similarity (1: equal) is at least `alike`."""
    names = sorted(names)
    close = difflib.get_close_matches(name, names, n=3, cutoff=alike)
    hint = f"did you mean {' or '.join(repr(c) for c in close)}? " if close else ""
    return f"{hint}known: {', '.join(names) or 'none'}"


def with_article(noun: str) -> str:
    """The noun with its indefinite article: "an emitter", "a bsdf"."""
    return f"{'an' if noun[0] in 'aeiou' else 'a'} {noun}"


def level_of_the_caller() -> int:
    """The stack level of the nearest caller outside torch and this package, as `warnings.warn` counts it."""
    frame, level = sys._getframe(1), 1
    while frame.f_back is not None and frame.f_globals.get("__name__", "").split(".")[0] in ("torch", "torch_radbp"):
        frame, level = frame.f_back, level + 1
    return level
