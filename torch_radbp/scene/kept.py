"""What one rendering leaves for the next, so that packing costs what has changed.

A scene is packed anew for every rendering, because its parameters may have changed by an optimiser's step,
`torch.func.functional_call`, `torch.nn.utils.parametrize`, `load_state_dict`, or a write through `.data` or numpy. The last
leaves no trace on a tensor: neither its identity nor its version counter changes. So tensors are compared with copies, bit
by bit, which takes a small part of the time in which tables are made of them. All else follows from identity: what is made
of the same copies, by the same function, is the same object as last time.

Nothing here is ever written into, so that graphs and other threads may hold it.
"""

from __future__ import annotations

import ctypes
import dataclasses
import os
from collections.abc import Callable, Hashable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from types import SimpleNamespace
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn.utils import parametrize

from torch_radbp.plugin import BSDF, Emitter, Plugin, Shape
from torch_radbp.scene.differentiated import differentiated, primal

PLAIN = (int, str, bool, type(None), type, torch.dtype, torch.device)  # values that are equal if and only if they compare so
PART = 16 << 20  # bytes that a thread compares at a time
OF_EVERY_MODULE = set(vars(nn.Module()))  # attributes


class Kept:
    """Copies of tensors and what was made of them: found unchanged since the last rendering, or new.

    One rendering fills one of these, and takes from that of the last rendering what is still right. What it does not ask
    for is forgotten.

    A copied or unpickled one is empty.

    Args:
        last: of the last rendering.
    """

    def __init__(self, last: Kept | None = None):
        self.last_copies, self.last_results = ({}, {}) if last is None else (last.copies, last.results)
        self.copies: dict[Hashable, Tensor] = {}
        self.results: dict[tuple, tuple[tuple, Any]] = {}  # with the arguments, so that their ids are not given away
        self.seen: dict[int, tuple[Tensor, Tensor]] = {}  # tensors of this rendering and their copies
        self.fixed: set[int] = set()  # ids of the objects handed out

    def __reduce__(self):
        return Kept, ()

    def close(self) -> Kept:
        """Lets go of what only the last rendering needed."""
        self.last_copies, self.last_results, self.seen, self.fixed = {}, {}, {}, set()
        return self

    def __call__(self, make: Callable, *arguments):
        """`make(*arguments)`; or what that gave before, if all arguments are plain values or objects from here.

        Args:
            make: a function of a module, whose result depends on nothing but the arguments.
            arguments: plain values, tensors, modules, and tuples of these. Of others the result is made anew.
        """
        tokens = self.tokens(arguments)
        if tokens is None:
            return make(*arguments)
        key = (make, *tokens)
        entry = self.results.get(key) or self.last_results.get(key)
        if entry is None:
            with torch.inference_mode(False), torch.no_grad():
                entry = arguments, make(*arguments)
        self.results[key] = entry
        self.fix(entry[1])
        return entry[1]

    def frozen(self, place: Hashable, tensor: Tensor) -> Tensor:
        """A detached copy of a tensor; the same object as last time if not a bit has changed.

        Args:
            place: tells which tensor of the last rendering to compare with.
            tensor: any.
        """
        if id(tensor) in self.fixed:
            return tensor
        if id(tensor) not in self.seen:
            copy = self.last_copies.get(place)
            if copy is None or not same_bits(copy, tensor):
                with torch.inference_mode(False), torch.no_grad():
                    copy = primal(tensor).clone(memory_format=torch.contiguous_format)
            self.seen[id(tensor)] = tensor, copy
            self.copies[place] = copy
            self.fixed.add(id(copy))
        return self.seen[id(tensor)][1]

    def twin(self, place: Hashable, thing):
        """A copy of a module, or of another object, as it is now; the same one as last time if nothing in it has changed.

        It has frozen tensors where those of the original are not differentiated, and the values of parametrisations instead
        of these. Modules in it are twins, too. That of a shape lacks material and emitter, which say nothing of its
        geometry.

        Args:
            place: tells which object of the last rendering to compare with.
            thing: its functions must depend on nothing but its attributes.
        """
        if not isinstance(thing, nn.Module):
            return self(assembled, type(thing), self.parts(place, vars(thing).items()), (), (), ())
        others = ((name, value) for name, value in vars(thing).items() if name not in OF_EVERY_MODULE)
        parameters = ((name, getattr(thing, name)) for name in (*thing._parameters, *replaced(thing)))
        return self(assembled, parametrize.type_before_parametrizations(thing), self.parts(place, others),
                    self.parts(place, parameters), self.parts(place, thing._buffers.items()),
                    self.parts(place, children_of(thing)))

    def parts(self, place: Hashable, named: Iterable[tuple[str, Any]]) -> tuple[tuple[str, Any], ...]:
        """What the attributes of a twin are, from those of the original."""
        return tuple((name, self.part((place, name), value)) for name, value in named if name != "shared")

    def part(self, place: Hashable, value):
        """What stands in a twin for an attribute."""
        if isinstance(value, Tensor):
            return value if differentiated(value) else self.frozen(place, value)
        if isinstance(value, nn.Module):
            return self.twin(place, value)
        if isinstance(value, tuple) and len(value) == 2 and isinstance(value[0], nn.Module) and isinstance(value[1], str):
            owner, name = value  # stands for this attribute of the owner, and nothing else of it
            return self(holder, name, self.part((place, name), getattr(owner, name))), name
        return value

    def tokens(self, values: Iterable | None) -> tuple | None:
        """What stands for some values in a key, or None if one may change without notice, or there are none."""
        found = []
        if values is None:
            return None
        for value in values:
            if isinstance(value, PLAIN):
                token = type(value), value
            elif id(value) in self.fixed:
                token = id(value)
            elif isinstance(value, float):
                token = float, value.hex()  # 0.0 == -0.0
            else:
                token = self.tokens(parts_of(value))
                if token is None:
                    return None
                token = type(value), token
            found.append(token)
        return tuple(found)

    def fix(self, result) -> None:
        """Notes that a result and its parts will not change."""
        if isinstance(result, tuple):
            for part in result:
                self.fix(part)
        if not isinstance(result, (*PLAIN, float)):
            self.fixed.add(id(result))


def parts_of(value) -> Iterable | None:
    """What makes up a value that is a tuple or a frozen dataclass; None for others."""
    if isinstance(value, tuple):
        return value
    fixed = dataclasses.is_dataclass(value) and not isinstance(value, type) and value.__dataclass_params__.frozen
    return vars(value).values() if fixed else None


def same_bits(a: Tensor, b: Tensor) -> bool:
    """True if two tensors have one shape, dtype and device, and the same bits: NaN equals itself, 0 does not equal -0."""
    if (a.shape, a.dtype, a.device) != (b.shape, b.dtype, b.device):
        return False
    a, b = (primal(each).contiguous() for each in (a, b))
    if a.device.type != "cpu":
        return torch.equal(a.view(-1).view(torch.uint8), b.view(-1).view(torch.uint8))
    return same_memory(a.data_ptr(), b.data_ptr(), a.nbytes)


def same_memory(a: int, b: int, length: int) -> bool:
    """True if the bytes at two addresses are equal; large ones are compared by several threads.

    The C library does so at the speed of memory. `torch.equal` takes half as long again, and on a busy machine many times
    as long, because its threads wait for each other.
    """
    starts = range(0, length, PART)
    if len(starts) < 2 or torch.get_num_threads() == 1:
        return not memory_difference()(a, b, length)

    def difference(start: int) -> int:
        return memory_difference()(a + start, b + start, min(PART, length - start))

    # A list of all: no thread may still read when the caller frees the memory.
    return not any(list(thread_pool(os.getpid()).map(difference, starts)))


@cache
def memory_difference() -> Callable[[int, int, int], int]:
    """`memcmp` of the C library, which runs without the interpreter lock."""
    function = ctypes.CDLL("msvcrt" if os.name == "nt" else None).memcmp
    function.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_size_t]
    return function


@cache
def thread_pool(process: int) -> ThreadPoolExecutor:
    """The threads of a process that compare memory: a forked one does not inherit those of its parent."""
    return ThreadPoolExecutor(torch.get_num_threads(), thread_name_prefix="kept")


def replaced(module: nn.Module) -> tuple[str, ...]:
    """The names of the tensors of a module that parametrisations compute."""
    return tuple(module.parametrizations) if parametrize.is_parametrized(module) else ()


def children_of(module: nn.Module) -> list[tuple[str, nn.Module | None]]:
    """The modules in a module that its tables may depend on."""
    found = {**module._modules, **(module.shared if isinstance(module, Plugin) else {})}
    if parametrize.is_parametrized(module):
        del found["parametrizations"]
    of_no_matter = (BSDF, Emitter) if isinstance(module, Shape) else ()
    return [(name, child) for name, child in found.items() if not isinstance(child, of_no_matter)]


def assembled(cls: type, others: tuple, parameters: tuple, buffers: tuple, children: tuple):
    """An object of a class from (name, value) pairs, without a call of its constructor."""
    made = cls.__new__(cls)
    if issubclass(cls, nn.Module):
        nn.Module.__init__(made)
        made._parameters.update(parameters)
        made._buffers.update(buffers)
        made._modules.update(children)
    vars(made).update(others)
    return made


def holder(name: str, value) -> SimpleNamespace:
    """An object that has one attribute."""
    return SimpleNamespace(**{name: value})
