"""The error about an operation that is not one of lanes."""

from __future__ import annotations

import traceback
from pathlib import Path

HERE = str(Path(__file__).parents[1])  # jit


class UnknownOperation(NotImplementedError):
    """Error: the function does what a function of lanes cannot; the message names the operation and the line."""


def refusal(what: str) -> UnknownOperation:
    """The error about `what`, an operation that is not one of lanes, with the line that called the operation."""
    frames = [frame for frame in traceback.extract_stack()
              if not frame.filename.startswith(HERE) and "/torch/" not in frame.filename]
    where = f" at {frames[-1].filename}:{frames[-1].lineno}: {frames[-1].line}" if frames else ""
    return UnknownOperation(f"{what} cannot be done lane by lane{where}")
