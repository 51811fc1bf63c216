"""`LaneFunction`: a function in plain torch, run as one fused loop over lanes."""

from __future__ import annotations

import ctypes
import inspect
import threading
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torch_radbp.jit.emit import emit
from torch_radbp.jit.graph import LANES, NUMBER, TABLE, Program
from torch_radbp.jit.machine import MachineCode, host_width
from torch_radbp.jit.refusal import UnknownOperation
from torch_radbp.jit.structure import assembler, difference, flatten, of_lanes, replaced
from torch_radbp.jit.team import run_lanes
from torch_radbp.jit.trace import trace


class Compiled(NamedTuple):
    """A function for arguments of one structure."""

    program: Program
    code: MachineCode
    inputs: tuple[int, ...]  # which tensors of the arguments the loop reads
    results: tuple[int, ...]  # of each tensor that is returned: the output number k, or ~k: the argument number k as it is
    structure: tuple  # of what is returned, as `flatten` tells it
    assemble: Callable[[list[Tensor]], Any]  # the results in their tuples


class LaneFunction:
    """A function of lanes, traced and compiled once for each structure of its arguments.

    Tensors may stand anywhere in nested tuples. A tensor of shape () is a number, the same for all lanes. One of shape (N,)
    has an entry per lane, or, in the arguments named in `tables`, is read at int32 or int64 indices only and may have any
    length. Whatever is not a tensor is compiled in, and must be hashable. Results are tensors of the lanes, in nested tuples
    and lists.

    The function may differentiate inside, with `torch.autograd.grad`; its results carry no derivative. Calls from several
    Python threads run side by side. `into` writes the results into tensors that are given, such as parts of larger ones.

    Args:
        function: in plain torch.
        tables: names of its parameters that hold tables.
        width: lanes in a vector; None: what the processor has.

    Raises:
        UnknownOperation: when called, if the function comes down to an operation that is not one of lanes.
        TypeError: when called with another number of arguments than the function has parameters; there are no defaults.
        ValueError: when called, if tensors of lanes differ in length, or a tensor has another device or shape.
        RuntimeError: when called with tensors that require grad while gradients are recorded.
    """

    compiling = threading.Lock()

    def __init__(self, function: Callable, tables: tuple[str, ...] = (), width: int | None = None):
        self.function, self.width = function, width
        self.name = getattr(function, "__name__", repr(function))
        names = list(inspect.signature(function).parameters)
        unknown = sorted(set(tables) - set(names))
        if unknown:
            raise ValueError(f"{self.name} has no parameters {unknown}; it has {names}")
        self.in_tables = [name in tables for name in names]
        self.compiled: dict[tuple, Compiled | str] = {}  # by structure of the arguments; or why it cannot be

    def __call__(self, *arguments):
        compiled, leaves, lanes = self.prepared(arguments)
        outputs = [torch.empty(lanes, dtype=value.dtype, device="cpu") for value in compiled.program.outputs]
        compute(compiled, leaves, outputs, lanes)
        return compiled.assemble([outputs[k] if k >= 0 else leaves[~k] for k in compiled.results])

    def into(self, results, *arguments):
        """Writes what a call would return into `results`, and returns them.

        Args:
            results: tensors in the tuples and lists that a call returns, contiguous: parts of larger tensors may be, so that
                several calls fill one buffer. No two may overlap, nor any with an argument.
            arguments: of the call.

        Raises:
            ValueError: if `results` are not what the call would return, or not contiguous; the rest as for a call.
        """
        compiled, leaves, lanes = self.prepared(arguments)
        given = self.checked_results(results, compiled, lanes)
        outputs: dict[int, Tensor] = {}
        for k, tensor in zip(compiled.results, given):
            outputs.setdefault(k, tensor)
        compute(compiled, leaves, [outputs[k] for k in range(len(compiled.program.outputs))], lanes)
        for k, tensor in zip(compiled.results, given):
            source = outputs[k] if k >= 0 else leaves[~k]
            if source is not tensor:
                tensor.copy_(source)
        return results

    def prepared(self, arguments: tuple) -> tuple[Compiled, list[Tensor], int]:
        """The compiled function for these arguments, their tensors, and the number of lanes."""
        if len(arguments) != len(self.in_tables):
            raise TypeError(f"{self.name} takes {len(self.in_tables)} arguments by position, got {len(arguments)}")
        leaves: list[Tensor] = []
        key: list = []
        kinds: list[str] = []
        for argument, in_tables in zip(arguments, self.in_tables):
            first = len(leaves)
            flatten(argument, leaves, key)
            kinds += [NUMBER if leaf.dim() == 0 else TABLE if in_tables else LANES for leaf in leaves[first:]]
        lanes = self.checked_lanes(leaves, kinds)
        # A tensor that is given twice is read once.
        places: dict[int, int] = {}
        key += (firsts := [places.setdefault(id(leaf), place) for place, leaf in enumerate(leaves)])
        compiled = self.compiled.get(tuple(key))
        if compiled is None:
            with self.compiling:
                compiled = self.compiled.get(tuple(key)) or self.compile(arguments, leaves, kinds, firsts)
                self.compiled[tuple(key)] = compiled
        if isinstance(compiled, str):
            raise UnknownOperation(compiled)
        return compiled, leaves, lanes

    def checked_results(self, results, compiled: Compiled, lanes: int) -> list[Tensor]:
        """The tensors of `results`; errors as `into` says."""
        leaves: list[Tensor] = []
        key: list = []
        flatten(results, leaves, key)
        if tuple(key) != compiled.structure:
            returned, found = difference(compiled.structure, key)
            raise ValueError(f"{self.name} returns {returned} where it is to write into {found}")
        for leaf in leaves:
            if len(leaf) != lanes or not leaf.is_contiguous() or leaf.device.type != "cpu":
                raise ValueError(f"{self.name} writes into contiguous tensors of {lanes} lanes on the CPU, got one of "
                                 f"{len(leaf)} with stride {leaf.stride(0)} on {leaf.device}")
        return leaves

    def checked_lanes(self, leaves: list[Tensor], kinds: list[str]) -> int:
        """The number of lanes; errors as the class says."""
        lanes, recording = None, torch.is_grad_enabled()
        for leaf, kind in zip(leaves, kinds):
            if recording and leaf.requires_grad:
                raise RuntimeError(f"{self.name} is compiled and records no derivative: call it under torch.no_grad(), or "
                                   "with detached tensors")
            if leaf.dim() > 1:
                raise ValueError(f"{self.name} takes tensors of shape () and (N,), got {tuple(leaf.shape)}")
            if leaf.device.type != "cpu":
                raise ValueError(f"{self.name} is compiled for the CPU, got a tensor on {leaf.device}")
            if kind == LANES:
                lanes = len(leaf) if lanes is None else lanes
                if len(leaf) != lanes:
                    raise ValueError(f"{self.name} got tensors of {lanes} and of {len(leaf)} lanes")
        if lanes is None:
            raise ValueError(f"{self.name} got no tensor with an entry per lane")
        return lanes

    def compile(self, arguments: tuple, leaves: list[Tensor], kinds: list[str], firsts: list[int]) -> Compiled | str:
        """Traces the function for arguments of this structure, and makes machine code of it; or says why it cannot be."""
        assemble: Callable | None = None
        structure: list = []

        def flat(*tensors: Tensor) -> list[Tensor]:
            nonlocal assemble
            stand_ins = iter([tensors[first] for first in firsts])
            results: list[Tensor] = []
            returned = self.function(*replaced(arguments, lambda: next(stand_ins)))
            flatten(returned, [], structure)
            assemble = assembler(returned, results)
            return results

        try:
            program = trace(flat, [leaf.dtype for leaf in leaves], kinds)
        except UnknownOperation as error:
            return str(error)
        passed = [value.operation == "input" and value.kind == LANES for value in program.outputs]
        outputs = tuple(dict.fromkeys(value for value, whole in zip(program.outputs, passed) if not whole))
        results = tuple(~value.static if whole else outputs.index(value) for value, whole in zip(program.outputs, passed))
        program = program._replace(outputs=outputs)
        return Compiled(program, MachineCode(emit(program, self.width or host_width())),
                        tuple(value.static for value in program.inputs), results, of_lanes(structure), assemble)


def compute(compiled: Compiled, leaves: list[Tensor], outputs: list[Tensor], lanes: int) -> None:
    """Runs the loop over all lanes, on all of torch's threads; `outputs` are written into."""
    inputs = [leaves[place].contiguous() for place in compiled.inputs]
    if lanes and outputs:
        lengths = [len(tensor) if tensor.dim() else 1 for tensor in inputs]
        run_lanes(compiled.code.address, lanes, addresses(inputs, lengths), addresses(outputs))


def addresses(tensors: list[Tensor], numbers: Sequence[int] = ()) -> ctypes.Array:
    """The addresses of tensors, and numbers after them, as a C array."""
    return (ctypes.c_int64 * max(1, len(tensors) + len(numbers)))(*[tensor.data_ptr() for tensor in tensors], *numbers)
