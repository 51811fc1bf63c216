"""What a rendering on a GPU waits for, counted on the CPU: tensors that compute here say that they lie on CUDA.

So all that depends on the device takes the way of CUDA. Operations whose result the host has to see, or whose input it has
to send, are counted where they are called. What the host has fetched as a tensor, and what it computes from that, is on the
CPU and says so, until it is sent back.
"""

from __future__ import annotations

import sys
import traceback
from collections import Counter

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_map_only
from torch.utils.weak import WeakIdKeyDictionary

from torch_radbp.tensors.record import leaves_of

CUDA = torch.device("cuda", 0)
CPU, HOST = torch.device("cpu"), torch.device("cpu", 0)  # where tensors truly are; what those say that are the host's
ANSWERS = {Tensor.is_cuda.__get__: lambda tensor: True, Tensor.is_cpu.__get__: lambda tensor: False,
           Tensor.device.__get__: lambda tensor: CUDA}
# By what they are called: on CUDA each of them waits until the device has come to the end of its work.
READS = ("_local_scalar_dense", "nonzero", "masked_select", "unique", "_unique2", "bincount", "equal",
         "repeat_interleave.Tensor", "_linalg_check_errors")
TO_HOST = (Tensor.tolist, Tensor.cpu, Tensor.numpy)
FROM_HOST = (torch.tensor, torch.as_tensor, torch.from_numpy, Tensor.new_tensor)


def place() -> str:
    """The innermost line of the package that is being run."""
    for frame, _ in traceback.walk_stack(sys._getframe()):
        code = frame.f_code
        if "/torch_radbp/" in code.co_filename and "/tests/" not in code.co_filename:
            return f"{code.co_filename.rsplit('/torch_radbp/', 1)[1]}:{code.co_name}"
    return "elsewhere"


class HostMemory:
    """The memory of tensors that are the host's."""

    def __init__(self) -> None:
        self.known = WeakIdKeyDictionary()

    def add(self, results) -> None:
        """Adds that of some tensors."""
        tree_map_only(Tensor, lambda tensor: self.known.setdefault(tensor.untyped_storage(), True), results)

    def has_all(self, arguments) -> bool:
        """True if there are tensors among some arguments, and all are the host's."""
        tensors = [leaf for leaf in leaves_of(arguments) if isinstance(leaf, Tensor)]
        return bool(tensors) and all(tensor.untyped_storage() in self.known for tensor in tensors)


class SaysCuda(TorchFunctionMode):
    """Tensors say that they are on CUDA, but for those that are the host's, and what is to be made there is made here."""

    def __init__(self, counted: Counter, host: HostMemory):
        super().__init__()
        self.counted, self.host = counted, host

    def __torch_function__(self, function, types, args=(), kwargs=None):
        kwargs = kwargs or {}
        of_host = self.host.has_all((args, kwargs))
        if function in ANSWERS:
            found = function(*args) if of_host else ANSWERS[function](*args)
            return HOST if found == CPU else found
        devices = [each for each in (*args, *kwargs.values()) if isinstance(each, torch.device)]
        if (of_host or HOST in devices or (function in FROM_HOST and CPU in devices)) and CUDA not in devices:
            self.host.add(found := function(*args, **kwargs))
            return found
        if function in TO_HOST or function in FROM_HOST:
            self.counted["from the host" if function in FROM_HOST else "to the host", place()] += 1
        here = {"device": "cpu"} if str(kwargs.get("device", "")).startswith("cuda") else {}
        args = ["cpu" if isinstance(each, torch.device) and each.type == "cuda" else each for each in args]
        found = function(*args, **kwargs | here)
        if function is Tensor.cpu:
            self.host.add(found := found.clone())
        return torch.empty_like(found).copy_(found) if of_host else found


class Reads(TorchDispatchMode):
    """Counts the operations that the host waits for."""

    def __init__(self, counted: Counter, host: HostMemory):
        super().__init__()
        self.counted, self.host = counted, host

    def __torch_dispatch__(self, function, types, args=(), kwargs=None):
        if self.host.has_all((args, kwargs)):
            return function(*args, **kwargs or {})
        name = function.name().removeprefix("aten::")
        masked = name.startswith("index.") and any(
            isinstance(index, Tensor) and index.dtype == torch.bool for index in args[1] if index is not None)
        if masked or name in READS or name.split(".")[0] in READS:
            self.counted["to the host", place()] += 1
        return function(*args, **kwargs or {})


def exchanges(run) -> Counter:
    """How often `run()` has sent to the host or from it, by direction and place."""
    counted, host = Counter(), HostMemory()
    with SaysCuda(counted, host), Reads(counted, host):
        run()
    return counted
