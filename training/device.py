"""The device that a command renders on: `[render] device` of a recipe, `--device` on the command line."""

import os

import torch

from torch_radbp.install_hint import install_with

EXPECTED = "'cpu', 'cuda' or one of several such as 'cuda:1'"


def parse_device(name: str) -> torch.device:
    """The device of a name, whether this machine has it or not.

    Raises:
        ValueError: no such device is rendered on.
    """
    try:
        device = torch.device(name)
    except RuntimeError:
        device = None
    if device is None or device.type not in ("cpu", "cuda") or (device.type == "cpu" and device.index):
        raise ValueError(f"device must be {EXPECTED}, got {name!r}")
    return device


def usable_device(name: str | None) -> torch.device:
    """The device of a name, ready to render on; None: the CPU.

    Under torchrun the processes of a machine take turns with its GPUs where `cuda` names none of them.

    Raises:
        ValueError: no such device is rendered on, or this machine lacks it; the message says what to do.
    """
    device = torch.device("cpu") if name is None else parse_device(name)
    if device.type == "cpu":
        return device
    if not torch.cuda.is_available():
        if torch.version.cuda is None:
            reason = (f"torch {torch.__version__} was built without CUDA; install one built for it "
                      f"(https://pytorch.org/get-started/locally) and {install_with('cuda')}")
        else:
            reason = "no GPU of NVIDIA's or no driver for it was found; nvidia-smi tells whether the system sees one"
        raise ValueError(f"device {name!r} cannot be used: {reason}; or take the device 'cpu'")
    count = torch.cuda.device_count()
    number = int(os.environ.get("LOCAL_RANK", "0")) % count if device.index is None else device.index
    if number >= count:
        raise ValueError(f"device {name!r} cannot be used: this machine has {count} GPU{'s' * (count > 1)}, counted from "
                         f"'cuda:0'; take one of these, or 'cpu'")
    return torch.device("cuda", number)
