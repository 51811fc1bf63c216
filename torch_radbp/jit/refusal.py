"""The error of a function that does what cannot be done lane by lane."""

from __future__ import annotations

import traceback
from pathlib import Path

HERE = str(Path(__file__).parent)


class UnknownOperation(NotImplementedError):
    """The function does what a function of lanes cannot; the message names the operation and the line that called it."""


def refusal(what: str) -> UnknownOperation:
    """The error that names what cannot be done, and the line that asked for it."""
    frames = [frame for frame in traceback.extract_stack()
              if not frame.filename.startswith(HERE) and "/torch/" not in frame.filename]
    where = f" at {frames[-1].filename}:{frames[-1].lineno}: {frames[-1].line}" if frames else ""
    return UnknownOperation(f"{what} cannot be done lane by lane{where}")
