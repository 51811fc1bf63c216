"""checkpoint.pt: the state that `--resume` continues from, read without running code and checked before it is used."""

import io
import math
import warnings
import zipfile
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from torch_radbp.io.atomic import replacing

START_ANEW = "start the run anew with another --out"


class CheckpointError(ValueError):
    """A checkpoint that cannot be continued from; the message names the file."""


def save_checkpoint(path: Path, state: dict[str, Any]) -> None:
    """Writes a state of tensors, numbers, strings, lists and dicts, completely or not at all."""
    data = io.BytesIO()
    torch.save(state, data)
    with replacing(path) as partial:
        partial.write_bytes(data.getbuffer())


def load_checkpoint(path: Path) -> dict[str, Any]:
    """Reads what `save_checkpoint` wrote; objects of any other kind are refused, never constructed.

    Raises:
        CheckpointError: empty, cut short, or something else than a checkpoint.
    """
    if path.stat().st_size == 0:
        raise CheckpointError(f"{path}: the checkpoint is empty; {START_ANEW}")
    if not zipfile.is_zipfile(path):
        raise CheckpointError(f"{path}: the checkpoint is cut short, or is no checkpoint; {START_ANEW}")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about file formats that are refused here anyway
            return torch.load(path, map_location="cpu", weights_only=True)
    # Whatever it is that a damaged or hostile file provokes; torch's own advice is to load it without this protection.
    except Exception:
        raise CheckpointError(f"{path}: the checkpoint is damaged, or holds more than tensors and numbers; "
                              f"it was not loaded; {START_ANEW}") from None


def check_state(path: Path, state: Any, fresh: dict[str, Any], steps: int) -> None:
    """Checks that a loaded state is one of this run.

    Args:
        path: where it was read, for messages.
        state: what was read.
        fresh: the state of the same run before its first step.
        steps: of the recipe.

    Raises:
        CheckpointError: another structure, other names or shapes, or numbers that make no sense; the message names the
            first of them.
    """
    def refuse(problem: str):
        raise CheckpointError(f"{path}: {problem}; the checkpoint is not one of this recipe; {START_ANEW}")

    problem = _difference(_without_moments(state), _without_moments(fresh), "")
    if problem is not None:
        refuse(problem)
    for name in ("step", "skipped", "seconds"):
        if state[name] < 0:
            refuse(f"{name} is {state[name]}")
    if state["step"] > steps:
        raise CheckpointError(f"{path}: the run is at step {state['step']} already, beyond steps = {steps}")
    shapes = [value.shape for value in state["parameters"].values()]
    for index, moments in state["optimizer"]["state"].items():
        if index not in range(len(shapes)) or not isinstance(moments, dict):
            refuse(f"optimizer.state.{index} belongs to no parameter")
        for name, value in moments.items():
            if isinstance(value, Tensor) and (value.dim() and value.shape != shapes[index] or not value.isfinite().all()):
                refuse(f"optimizer.state.{index}.{name} is not finite or not of shape {tuple(shapes[index])}")


def _without_moments(state: Any) -> Any:
    """The state without what the optimiser has gathered for each parameter, which is empty before the first step."""
    if not isinstance(state, dict) or not isinstance(state.get("optimizer"), dict):
        return state
    return state | {"optimizer": {key: {} if key == "state" else value for key, value in state["optimizer"].items()}}


def _difference(found: Any, expected: Any, place: str) -> str | None:
    """Says where a value differs in structure from the one expected, or is not finite; None if nowhere."""
    where = place.removeprefix(".") or "the top level"
    if isinstance(expected, dict):
        if not isinstance(found, dict) or found.keys() != expected.keys():
            names = ", ".join(map(str, found)) if isinstance(found, dict) else type(found).__name__
            return f"{where} holds {names or 'nothing'} instead of {', '.join(map(str, expected)) or 'nothing'}"
        pairs = [(found[key], expected[key], f"{place}.{key}") for key in expected]
    elif isinstance(expected, (list, tuple)):
        if not isinstance(found, (list, tuple)) or len(found) != len(expected):
            return f"{where} is not a list of {len(expected)}"
        pairs = [(one, other, f"{place}.{index}") for index, (one, other) in enumerate(zip(found, expected))]
    elif isinstance(expected, Tensor):
        if not isinstance(found, Tensor) or (found.shape, found.dtype) != (expected.shape, expected.dtype):
            kind = f"{tuple(found.shape)} {found.dtype}" if isinstance(found, Tensor) else type(found).__name__
            return f"{where} is {kind} instead of {tuple(expected.shape)} {expected.dtype}"
        return None if found.isfinite().all() else f"{where} is not finite"
    elif isinstance(expected, int) and not isinstance(expected, bool):
        return None if type(found) is int else f"{where} is no integer"
    elif isinstance(expected, float):
        return None if isinstance(found, (int, float)) and math.isfinite(found) else f"{where} is no finite number"
    else:
        return None if isinstance(found, type(expected)) else f"{where} is a {type(found).__name__}"
    return next((problem for pair in pairs if (problem := _difference(*pair)) is not None), None)
