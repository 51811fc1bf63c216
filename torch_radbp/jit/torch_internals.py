"""What this package uses of torch that is not public, in one place, with what is done where a version lacks it.

Tried with the versions that README names (`make test-torch VERSION=2.6.0`). Of `pytree`, by which torch takes nested tuples,
lists and dicts apart, and of dispatch modes, which see every basic operation, nothing can take the place.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import torch
from torch import Tensor
from torch.autograd import forward_ad
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_flatten, tree_map, tree_map_only

__all__ = ["TorchDispatchMode", "functions_of_torch_only", "inside_dual_level", "library_of_torch", "outside_transforms",
           "transforms", "tree_flatten", "tree_map", "tree_map_only", "unwrapped", "without_compiler"]

try:
    from torch._C._functorch import get_interpreter_stack, get_unwrapped, is_functorch_wrapped_tensor
    from torch._functorch.pyfunctorch import temporarily_clear_interpreter_stack
except ImportError:  # transforms are then not noticed: torch refuses what it cannot do
    get_interpreter_stack = temporarily_clear_interpreter_stack = None

try:
    from torch._C._dynamo.eval_frame import set_eval_frame
except ImportError:  # `torch.compile` then traces into a rendering, and breaks its graph there
    set_eval_frame = None


@contextmanager
def without_compiler() -> Iterator[None]:
    """Functions that are called inside run as they are, also if `torch.compile` compiles the caller.

    As `torch.compiler.disable` does, without the three seconds in which that imports the compiler.
    """
    if set_eval_frame is None:
        yield
        return
    compiler = set_eval_frame(None)
    try:
        yield
    finally:
        set_eval_frame(compiler)


def functions_of_torch_only():
    """A context in which subclasses of tensors are taken for plain ones."""
    return torch._C.DisableTorchFunctionSubclass()


def inside_dual_level() -> bool:
    """False where no tensor can have a forward-mode tangent; True where that is not known."""
    return getattr(forward_ad, "_current_level", 0) >= 0


def transforms() -> list[str]:
    """Names of the transforms of `torch.func` that are active, outermost first, such as "jvp"."""
    stack = get_interpreter_stack() if get_interpreter_stack is not None else None
    return [interpreter.key().name.lower() for interpreter in stack or ()]


def outside_transforms(function: Callable, *arguments):
    """`function(*arguments)`, computed as if no transform were active."""
    with temporarily_clear_interpreter_stack():
        return function(*arguments)


def unwrapped(tensor: Tensor | None) -> Tensor | None:
    """The plain tensor inside of one that a transform of `torch.func` has wrapped."""
    return get_unwrapped(tensor) if tensor is not None and is_functorch_wrapped_tensor(tensor) else tensor


def library_of_torch() -> ctypes.CDLL | None:
    """torch's shared library, in which symbols of all that it is linked to are found; None: it has none."""
    try:
        return ctypes.CDLL(torch._C.__file__)
    except (OSError, AttributeError):
        return None
