"""`LaneFunction`: runs a function in plain torch as one compiled loop over lanes."""

from __future__ import annotations

import inspect
import operator
import threading
from collections.abc import Callable, Sequence
from copy import copy
from functools import partial

from torch import Tensor

from torch_radbp.jit import compiled as compiled_functions
from torch_radbp.jit.arguments import Arguments, Parameter, PreparedArgument
from torch_radbp.jit.compiled import Compiled, Interface
from torch_radbp.jit.lane.graph import LANES, Program, Repetition
from torch_radbp.jit.lane.refusal import UnknownOperation
from torch_radbp.jit.lane.trace import traced_program
from torch_radbp.jit.recording.recording import recording, unguarded
from torch_radbp.jit.recording.structure import Leaf, flatten, of_lanes, structure_difference, with_other_leaves
from torch_radbp.jit.target import Target, target_of
from torch_radbp.threads.later import Later
from torch_radbp.threads.team import after_loops


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
        target: what to compile for; None: the device that the tensors of a call lie on.
        repeats: the parameter that a kernel may replace by the results and go on, see `tensors.stage.stage`.

    Raises:
        UnknownOperation: when called, if the function comes down to an operation that is not one of lanes.
        TypeError: when called with another number of arguments than the function has parameters; there are no defaults.
        ValueError: when called, if tensors of lanes differ in length, or a tensor has another device or shape.
        RuntimeError: when called with tensors that require grad while gradients are recorded.
    """

    compiling = threading.Lock()

    def __init__(self, function: Callable, tables: tuple[str, ...] = (), target: Target | None = None,
                 repeats: str | None = None):
        self.function, self.tables, self.target, self.repeats = function, tables, target, repeats
        self.name = getattr(function, "__name__", repr(function))
        names = list(inspect.signature(function).parameters)
        unknown = sorted(set(tables) - set(names))
        if unknown:
            raise ValueError(f"{self.name} has no parameters {unknown}; it has {names}")
        self.parameters = [Parameter(self.name, name in tables) for name in names]
        self.named = dict(zip(names, self.parameters))
        self.results = Parameter(self.name, table=True)  # of `into`
        self.compiled: dict[tuple, Compiled | str] = {}  # by structure of the arguments; or why it cannot be
        self.first_arguments: Arguments | None = None

    def knowing(self, *arguments) -> LaneFunction:
        """A copy of this function that prepares its first arguments for calls with the very same objects.

        It keeps them alive, and accepts other objects, too; compiled code serves both functions.
        """
        other = copy(self)
        other.first_arguments = Arguments(self.parameters, arguments)
        return other

    def taken(self, **arguments) -> tuple[PreparedArgument, ...]:
        """Prepares arguments, given by name, once for several calls.

        What is written into their tensors in between counts, unless these are not contiguous or not aligned.
        """
        return tuple([PreparedArgument(self.named[name], argument) for name, argument in arguments.items()])

    def room(self, results) -> PreparedArgument:
        """Prepares the tensors that receive results once for several calls of `into`."""
        return PreparedArgument(self.results, results)

    def __call__(self, *arguments):
        compiled, given = self.prepared(arguments)
        new_empty, lanes = given.leaves[0].new_empty, given.lanes
        outputs = [new_empty(lanes, dtype=dtype) for dtype in compiled.dtypes]
        if (listener := recording()) is not None:
            compiled.recorded(listener, given, outputs)
        else:
            compiled.run(given, [tensor.data_ptr() for tensor in outputs])
        return compiled.assemble([outputs[k] if k >= 0 else given.leaves[~k] for k in compiled.results])

    def into(self, results, first: int, *arguments):
        """Calls the function, and writes the results into `results`.

        Args:
            results: contiguous tensors in the tuples and lists that a call returns, or `room` for them, each at a
                multiple of its element's size. No two may overlap, nor any with an argument.
            first: the entry at which to begin, so that several calls fill one buffer.
            arguments: of the call.

        Raises:
            ValueError: if `results` are not what the call would return, not contiguous or aligned, or too short; the
                rest as for a call.
        """
        compiled, given = self.prepared(arguments)
        room = results if type(results) is PreparedArgument else PreparedArgument(self.results, results)
        self.check_room(room, compiled, given, first + given.lanes)
        tensors, sizes = room.leaves, compiled.sizes
        if (listener := recording()) is not None:
            compiled.recorded(listener, given, [tensors[place] for place in compiled.firsts], first)
        else:
            compiled.run(given, [room.pointers[place] + first * size for place, size in zip(compiled.firsts, sizes)])

        def others() -> None:
            for place in compiled.others:
                k = compiled.results[place]
                source = tensors[compiled.firsts[k]].narrow(0, first, given.lanes) if k >= 0 else given.leaves[~k]
                if listener is not None:
                    listener.copy(tensors[place], source, first)
                else:
                    tensors[place].narrow(0, first, given.lanes).copy_(source)

        after_loops(others)  # which also keeps what was given until then
        return room.argument

    def prepared(self, arguments: tuple) -> tuple[Compiled, Arguments]:
        """Takes arguments apart, and compiles the function for their structure."""
        if len(arguments) != len(self.parameters):
            raise TypeError(f"{self.name} takes {len(self.parameters)} arguments by position, got {len(arguments)}")
        first = self.first_arguments
        if first is not None and all(map(operator.is_, first.given, arguments)):
            skipped = len(first.given)
            given = Arguments(self.parameters[skipped:], arguments[skipped:], first)
        else:
            given = Arguments(self.parameters, arguments)
        if given.lanes is None:
            raise ValueError(f"{self.name} got no tensor with an entry per lane")
        key = given.key
        compiled = self.compiled.get(key)
        if compiled is None:
            with self.compiling, unguarded():
                compiled = self.compiled.get(key) or self.compile(given)
                self.compiled[key] = compiled
        if isinstance(compiled, str):
            raise UnknownOperation(compiled)
        return compiled, given

    def check_room(self, room: PreparedArgument, compiled: Compiled, given: Arguments, entries: int) -> None:
        """Raises ValueError unless `room` can receive the results of a call, as `into` says."""
        structure = room.form.structure
        if structure is not compiled.structure:
            if structure != compiled.structure:
                returned, found = structure_difference(compiled.structure, structure)
                raise ValueError(f"{self.name} returns {returned} where it is to write into {found}")
            compiled.structure = structure  # the very same object, which is quickly compared
        if room.read is not room.leaves or room.device != given.device or (room.sizes and min(room.sizes) < entries):
            leaf = next(leaf for leaf, read in zip(room.leaves, room.read)
                        if leaf.numel() < entries or read is not leaf or not leaf.is_contiguous()
                        or leaf.device != given.device)
            raise ValueError(f"{self.name} writes into aligned, contiguous tensors of at least {entries} entries on "
                             f"{given.device}, got one of {len(leaf)} with stride {leaf.stride(0)} on {leaf.device} "
                             f"at {leaf.data_ptr():#x}")

    def compile(self, given: Arguments) -> Compiled | str:
        """The function for arguments of this structure: read from disk, or traced and compiled; or the reason why not."""
        try:
            if self.target is not None:  # asked for by name, to look at what it does: always compiled
                program, interface = self.traced(given, self.target.repeats)
                return Compiled(interface, Later(partial(self.target.compile, program)) if program.outputs else None)
            target = target_of(given.device)
            name = compiled_functions.code_name(self.function, self.tables, given, target)
            found = None if name is None else compiled_functions.read_compiled(name, target)
            if found is not None:
                return found
            program, interface = self.traced(given, target.repeats)
        except UnknownOperation as error:
            return str(error)
        return compiled_functions.compiled_program(name, interface, program, target)

    def program(self, *arguments) -> Program:
        """Traces the function to a program, for arguments of this structure."""
        return self.traced(Arguments(self.parameters, arguments))[0]

    def traced(self, given: Arguments, repeating: bool = False) -> tuple[Program, Interface]:
        """Traces the function for arguments of this structure.

        Args:
            given: the arguments.
            repeating: whether a kernel repeats what it can.

        Raises:
            UnknownOperation: if it comes down to an operation that is not one of lanes.
        """
        returned, structure, running = None, [], 0

        def flat(*tensors: Tensor) -> list[Tensor]:
            nonlocal returned, running
            stand_ins = iter(tensors)
            results: list[Tensor] = []
            returned = self.function(*with_other_leaves(given.given, lambda: next(stand_ins)))
            flatten(returned, results, structure)
            if self.repeats is not None:
                running = next(number for number, result in enumerate(results) if result is returned.running)
            return results

        program = traced_program(flat, [leaf.dtype for leaf in given.leaves], given.kinds, given.firsts)
        program = program._replace(columns=given.columns)
        passed = [value.operation == "input" and value.kind == LANES for value in program.outputs]
        outputs = tuple(dict.fromkeys(value for value, whole in zip(program.outputs, passed) if not whole))
        results = tuple(~value.static if whole else outputs.index(value) for value, whole in zip(program.outputs, passed))
        program = program._replace(outputs=outputs)
        if repeating and self.repeats is not None:
            program = program._replace(repetition=self.repetition(given, results, running))
        inputs = tuple(value.static for value in program.inputs)
        dtypes = tuple(value.dtype for value in outputs)
        shape = with_other_leaves(returned, Leaf)
        return program, Interface(inputs, program.searched, dtypes, results, shape, of_lanes(structure))

    def repetition(self, given: Arguments, results: Sequence[int], running: int) -> Repetition:
        """How the function is repeated: which outputs replace which entries of tables in the next repetition.

        Args:
            given: the function's arguments.
            results: the index of each result among the program's outputs.
            running: the index of the result that tells whether lanes go on.

        Raises:
            ValueError: unless it returns as many tensors as the repeated argument has, which must all differ.
        """
        number = list(self.named).index(self.repeats)
        first = sum(len(form.kinds) for form in given.forms[:number])
        places = range(first, first + len(given.forms[number].kinds))
        if len(places) != len(results) or not {place for place, _ in given.shared}.isdisjoint(places):
            raise ValueError(f"{self.name} returns {len(results)} tensors in the place of {len(places)} of {self.repeats!r}"
                             ", which must all be different ones")
        return Repetition(results[running], tuple(zip(places, results)))
