"""The errors of a scene description, and how messages list what is known."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class SceneError(ValueError):
    """A scene description that cannot be used; the message names the place, what is there, and what is supported.

    The place is a file and a line in it (XML, meshes), or the path of keys (dicts, glTF).
    """


class SceneWarning(UserWarning):
    """A scene description that is read in another way than its author may have meant."""


def nearest(name: str, known: Iterable[str], alike: float = 0.5) -> str:
    """A sentence that lists the known names, the most similar first: those that are `alike`, 1 for the same."""
    known = sorted(known)
    close = difflib.get_close_matches(name, known, n=3, cutoff=alike)
    hint = f"did you mean {' or '.join(repr(c) for c in close)}? " if close else ""
    return f"{hint}known: {', '.join(known) or 'none'}"


def with_article(noun: str) -> str:
    """"an emitter", "a bsdf"."""
    return f"{'an' if noun[0] in 'aeiou' else 'a'} {noun}"
