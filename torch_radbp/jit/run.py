"""`LaneFunction`: a function in plain torch, run as one fused loop over lanes."""

from __future__ import annotations

import inspect
import operator
import threading
from array import array
from collections.abc import Callable
from copy import copy
from typing import Any, NamedTuple

from torch import Tensor

from torch_radbp.jit.arguments import Arguments
from torch_radbp.jit.emit import emit
from torch_radbp.jit.graph import LANES, Program
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
        self.structures: dict[tuple, tuple] = {}  # of known arguments
        self.known: Arguments | None = None

    def knowing(self, *arguments) -> LaneFunction:
        """The same function, which need not take these first arguments apart in every call that gets the very same.

        It keeps them alive. With others it does what this one does; what is compiled serves both.
        """
        other = copy(self)
        other.known = Arguments(self.name, arguments, self.in_tables)
        other.known.leaves = [leaf.contiguous() for leaf in other.known.leaves]
        # The very same objects, which are quickly found to be equal.
        other.known.structures = [self.structures.setdefault(key, key) for key in other.known.structures]
        return other

    def __call__(self, *arguments):
        compiled, given = self.prepared(arguments)
        any_tensor = given.leaves[0]
        outputs = [any_tensor.new_empty(given.lanes, dtype=value.dtype) for value in compiled.program.outputs]
        compute(compiled, given, outputs)
        return compiled.assemble([outputs[k] if k >= 0 else given.leaves[~k] for k in compiled.results])

    def into(self, results, *arguments):
        """Writes what a call would return into `results`, and returns them.

        Args:
            results: tensors in the tuples and lists that a call returns, contiguous: parts of larger tensors may be, so that
                several calls fill one buffer. No two may overlap, nor any with an argument.
            arguments: of the call.

        Raises:
            ValueError: if `results` are not what the call would return, or not contiguous; the rest as for a call.
        """
        compiled, given = self.prepared(arguments)
        tensors = self.checked_results(results, compiled, given.lanes)
        outputs: dict[int, Tensor] = {}
        for k, tensor in zip(compiled.results, tensors):
            outputs.setdefault(k, tensor)
        compute(compiled, given, [outputs[k] for k in range(len(compiled.program.outputs))])
        for k, tensor in zip(compiled.results, tensors):
            source = outputs[k] if k >= 0 else given.leaves[~k]
            if source is not tensor:
                tensor.copy_(source)
        return results

    def prepared(self, arguments: tuple) -> tuple[Compiled, Arguments]:
        """The arguments taken apart, and the function compiled for such."""
        if len(arguments) != len(self.in_tables):
            raise TypeError(f"{self.name} takes {len(self.in_tables)} arguments by position, got {len(arguments)}")
        known, skipped = self.known, 0
        if known is not None and all(map(operator.is_, known.given, arguments)):
            skipped = len(known.given)
        given = Arguments(self.name, arguments[skipped:], self.in_tables[skipped:], known if skipped else None)
        if given.lanes is None:
            raise ValueError(f"{self.name} got no tensor with an entry per lane")
        key = given.key
        compiled = self.compiled.get(key)
        if compiled is None:
            with self.compiling:
                compiled = self.compiled.get(key) or self.compile(given)
                self.compiled[key] = compiled
        if isinstance(compiled, str):
            raise UnknownOperation(compiled)
        return compiled, given

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

    def compile(self, given: Arguments) -> Compiled | str:
        """Traces the function for arguments of this structure, and makes machine code of it; or says why it cannot be."""
        assemble: Callable | None = None
        structure: list = []

        def flat(*tensors: Tensor) -> list[Tensor]:
            nonlocal assemble
            stand_ins = iter(tensors)
            results: list[Tensor] = []
            returned = self.function(*replaced(given.given, lambda: next(stand_ins)))
            flatten(returned, [], structure)
            assemble = assembler(returned, results)
            return results

        try:
            program = trace(flat, [leaf.dtype for leaf in given.leaves], given.kinds, given.firsts)
        except UnknownOperation as error:
            return str(error)
        passed = [value.operation == "input" and value.kind == LANES for value in program.outputs]
        outputs = tuple(dict.fromkeys(value for value, whole in zip(program.outputs, passed) if not whole))
        results = tuple(~value.static if whole else outputs.index(value) for value, whole in zip(program.outputs, passed))
        program = program._replace(outputs=outputs)
        return Compiled(program, MachineCode(emit(program, self.width or host_width())),
                        tuple(value.static for value in program.inputs), results, of_lanes(structure), assemble)


def compute(compiled: Compiled, given: Arguments, outputs: list[Tensor]) -> None:
    """Runs the loop over all lanes, on all of torch's threads; `outputs` are written into."""
    if given.lanes and outputs:
        inputs = [given.leaves[place] for place in compiled.inputs]
        inputs = [tensor if tensor.is_contiguous() else tensor.contiguous() for tensor in inputs]
        pointers = array("q", [tensor.data_ptr() for tensor in inputs])
        pointers.extend([tensor.numel() for tensor in inputs])
        run_lanes(compiled.code.address, given.lanes, pointers, array("q", [tensor.data_ptr() for tensor in outputs]))
