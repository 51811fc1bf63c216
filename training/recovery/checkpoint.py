"""`checkpoint.safetensors`: the state that `--resume` continues from. It holds numbers and text, and no code.

Tensors lie in the file as they are, uncompressed, so that none takes more memory than the file. What is no tensor is JSON,
in the file's header. `continuation` checks whether a state is one of a run.
"""

import json
from pathlib import Path
from typing import Any

import safetensors
import safetensors.torch
from torch import Tensor

from torch_radbp.formats.atomic import replacing

FILE_NAME = "checkpoint.safetensors"
HEADER, VALUES, MOMENTS = "state", "parameters/", "moments/"
# Beyond the tensors: names, shapes, the recipe, digests of files.
MOST_HEADER_BYTES = 16 * 2**20
START_ANEW = "start the run anew with another --out"

State = dict[str, Any]


class CheckpointError(ValueError):
    """A checkpoint that cannot be continued from; the message names the file."""


def save_checkpoint(path: Path, state: State) -> None:
    """Writes a state, completely or not at all.

    Args:
        path: of the file.
        state: "parameters", tensors by name; "moments", tensors by parameter and name; the rest can be said in JSON.
    """
    tensors = {VALUES + name: value for name, value in state["parameters"].items()}
    for name, moments in state["moments"].items():
        tensors |= {f"{MOMENTS}{name}/{moment}": value for moment, value in moments.items()}
    rest = {key: value for key, value in state.items() if key not in ("parameters", "moments")}
    # As bytes, because safetensors' own writer makes a file that only its owner may read.
    data = safetensors.torch.save({name: value.cpu().contiguous() for name, value in tensors.items()},
                                  {HEADER: json.dumps(rest, allow_nan=False)})
    with replacing(path) as partial:
        partial.write_bytes(data)


def load_checkpoint(path: Path, tensor_bytes: int) -> State:
    """Reads what `save_checkpoint` wrote.

    Args:
        path: of the file.
        tensor_bytes: what the tensors of a state take at most; a larger file is not read.

    Raises:
        CheckpointError: empty, too large, cut short, or something else than a checkpoint.
    """
    size = path.stat().st_size
    if size == 0:
        raise CheckpointError(f"{path}: the checkpoint is empty; {START_ANEW}")
    if size > tensor_bytes + MOST_HEADER_BYTES:
        raise CheckpointError(f"{path}: the checkpoint has {size} bytes, and one of this recipe at most "
                              f"{tensor_bytes + MOST_HEADER_BYTES}; it was not read; {START_ANEW}")
    try:
        with safetensors.safe_open(path, "pt") as file:
            header = (file.metadata() or {}).get(HEADER)
            tensors = {name: file.get_tensor(name) for name in file.keys()}
    except (safetensors.SafetensorError, OSError, ValueError, TypeError, RuntimeError):
        raise CheckpointError(f"{path}: the checkpoint is cut short or damaged, or is no checkpoint; {START_ANEW}") from None
    return _numbers(path, header) | _by_name(path, tensors)


def _numbers(path: Path, header: str | None) -> State:
    """What is no tensor."""
    try:
        rest = json.loads(header)
    except (TypeError, ValueError, RecursionError):
        rest = None
    if not isinstance(rest, dict):
        raise CheckpointError(f"{path}: the checkpoint holds tensors, but no state of a run; {START_ANEW}")
    return rest


def _by_name(path: Path, tensors: dict[str, Tensor]) -> State:
    values: dict[str, Tensor] = {}
    moments: dict[str, dict[str, Tensor]] = {}
    for key, tensor in tensors.items():
        if key.startswith(VALUES):
            values[key.removeprefix(VALUES)] = tensor
        elif key.startswith(MOMENTS) and "/" in key.removeprefix(MOMENTS):
            name, _, moment = key.removeprefix(MOMENTS).rpartition("/")
            moments.setdefault(name, {})[moment] = tensor
        else:
            raise CheckpointError(f"{path}: the tensor {key[:80]!r} belongs to no checkpoint; {START_ANEW}")
    return {"parameters": values, "moments": moments}
