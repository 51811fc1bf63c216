"""All that this package uses of torch's internals, with a substitute where a version of torch lacks it.

Tried with the versions of docs/versions.md (`make test-torch`). Of `pytree`, by which torch takes nested tuples,
lists and dicts apart, and of dispatch modes, which see every basic operation, nothing can take the place.
"""

from __future__ import annotations

import ctypes
import functools
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from threading import Event, Thread

import torch
from torch import Tensor
from torch.autograd import forward_ad
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_flatten, tree_map

__all__ = ["TorchDispatchMode", "at_end_of_backward", "backward_pass", "batched", "dual_of", "functions_of_torch_only",
           "holders", "inside_dual_level", "operations_on_this_thread", "outside_transforms", "same_versions", "transforms",
           "tree_flatten", "tree_map", "unpacked_dual", "unwrapped", "without_compiler"]

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
    """Runs what is called inside uncompiled, even if `torch.compile` compiles the caller.

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


def batched(tensor: Tensor) -> bool:
    """True if a tensor stands for a batch of gradients (`is_grads_batched`); False if torch cannot tell."""
    try:
        return "Batched" in torch._C._dispatch_key_set(tensor)
    except AttributeError:
        return False


def backward_pass() -> int | None:
    """The id of the backward pass that this thread is in; None if there is none, or torch cannot tell."""
    try:
        number = torch._C._current_graph_task_id()
    except AttributeError:
        return None
    return None if number < 0 else number


def at_end_of_backward(function: Callable[[], None]) -> None:
    """Calls a function when this thread's current backward pass has ended."""
    torch.autograd.Variable._execution_engine.queue_callback(function)


def functions_of_torch_only():
    """A context in which subclasses of tensors are treated as plain tensors."""
    return torch._C.DisableTorchFunctionSubclass()


def inside_dual_level() -> bool:
    """True if forward-mode derivatives may be active, or torch cannot tell; False if no tensor can have a tangent."""
    return getattr(forward_ad, "_current_level", 0) >= 0


def unpacked_dual(tensor: Tensor) -> tuple[Tensor, Tensor | None]:
    """The value and the tangent of a tensor inside of a dual level, the latter None if it has none.

    As `forward_ad.unpack_dual`, in a third of the time: a rendering asks a thousand tensors.
    """
    unpack = getattr(torch, "_unpack_dual", None)
    return tuple(forward_ad.unpack_dual(tensor)) if unpack is None else unpack(tensor, 0)


def dual_of(value: Tensor, tangent: Tensor) -> Tensor:
    """A value with a tangent, inside of a dual level; as `forward_ad.make_dual`, in a third of the time."""
    make = getattr(torch, "_make_dual", None)
    return forward_ad.make_dual(value, tangent) if make is None else make(value, tangent, level=0)


@contextmanager
def same_versions(tensors: Sequence[Tensor]) -> Iterator[None]:
    """A context in which autograd does not count writes into tensors, which hold the old values again at its end.

    Where torch lacks this they count, and graphs that have saved these tensors cannot be run backwards any more.
    """
    keep = getattr(torch.autograd, "_unsafe_preserve_version_counter", None)
    with nullcontext() if keep is None else keep(tuple(tensors)):
        yield


def holders(storage: torch.UntypedStorage) -> int:
    """How many hold a tensor's memory: 1 where that is `storage` alone; 0 if torch cannot tell."""
    count = getattr(torch._C, "_storage_Use_Count", None)
    return 0 if count is None else count(storage._cdata)


def transforms() -> list[str]:
    """The names of the active `torch.func` transforms, outermost first, such as "jvp"."""
    stack = get_interpreter_stack() if get_interpreter_stack is not None else None
    return [interpreter.key().name.lower() for interpreter in stack or ()]


def outside_transforms(function: Callable, *arguments):
    """Calls `function(*arguments)` as if no `torch.func` transform were active."""
    with temporarily_clear_interpreter_stack():
        return function(*arguments)


def unwrapped(tensor: Tensor | None) -> Tensor | None:
    """The plain tensor inside of one that `torch.func` transforms have wrapped."""
    return get_unwrapped(tensor) if tensor is not None and is_functorch_wrapped_tensor(tensor) else tensor


@contextmanager
def operations_on_this_thread() -> Iterator[int]:
    """Keeps torch's operations in this thread single-threaded; yields the number of threads that they would have had.

    `torch.set_num_threads` would also set the number with which other threads, such as the user's, begin; so OpenMP and MKL
    are told that of this thread alone, where their functions are found.
    """
    number = torch.get_num_threads()  # the first time, a thread takes over the default: not later, instead of what is set
    if number == 1:
        yield 1
        return
    keep_waits_short()
    set_openmp, set_mkl = setters_of_threads()
    set_openmp(1)
    of_mkl = set_mkl(1)
    try:
        yield number
    finally:
        set_openmp(number)
        set_mkl(of_mkl)


@functools.cache
def setters_of_threads() -> tuple[Callable[[int], None], Callable[[int], int]]:
    """Functions that set the calling thread's number of threads in OpenMP, and in MKL (which returns the old one)."""
    # A symbol is looked up in a library and in all it depends on, hence in the runtime that torch loaded.
    library = library_of_torch()
    set_openmp = getattr(library, "omp_set_num_threads", None)
    if set_openmp is None or not is_obeyed(set_openmp):
        return torch.set_num_threads, lambda number: 0
    return set_openmp, getattr(library, "MKL_Set_Num_Threads_Local", lambda number: 0)


def is_obeyed(set_openmp: Callable[[int], None]) -> bool:
    """True if the function sets the number of threads of the OpenMP runtime that torch uses."""
    number = torch.get_num_threads()
    set_openmp(number + 1)
    obeyed = torch.get_num_threads() == number + 1
    set_openmp(number)
    return obeyed


@functools.cache
def keep_waits_short() -> None:
    """Makes OpenMP's idle threads sleep soon, so that they do not spin while our own threads work.

    GNU's runtime lets them spin 300,000 times, but 100 times while it manages more threads than there are processors (its
    manual, GOMP_SPINCOUNT). So one team more is made, which sleeps for good. What the environment says is not changed.
    """
    if not hasattr(os, "sched_getaffinity") or {"GOMP_SPINCOUNT", "OMP_WAIT_POLICY"} & set(os.environ):
        return
    library = library_of_torch()
    parallel, nothing = (getattr(library, name, None) for name in ("GOMP_parallel", "omp_get_max_threads"))
    if parallel is None:
        return
    team = max(2, len(os.sched_getaffinity(0)) - torch.get_num_threads() + 2)
    body = ctypes.cast(nothing, ctypes.c_void_p)  # a function without effect

    def sleep_for_good() -> None:
        parallel(body, None, ctypes.c_uint(team), ctypes.c_uint(0))
        Event().wait()  # with its first thread the team would end

    Thread(target=sleep_for_good, name="torch_radbp_sleeper", daemon=True).start()


def library_of_torch() -> ctypes.CDLL | None:
    """torch's shared library, through which symbols of all libraries linked to it are found; None: it has none."""
    try:
        return ctypes.CDLL(torch._C.__file__)
    except (OSError, AttributeError):
        return None
