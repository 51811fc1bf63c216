"""Traces a function in plain torch to a program, by running it once on tensors without contents.

The tensors are on torch's `meta` device. A dispatch mode sees every basic operation that torch comes down to, those of
`torch.autograd.grad` inside of the function included, and notes it. The result's dtype follows from a rule of
`inference.py`, or torch works it out. Nothing that is not a tensor is looked at: it is a constant of the program.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from torch_radbp.jit.lane.graph import NUMBER, TABLE, Builder, Program, Value, program
from torch_radbp.jit.lane.inference import INFERRED
from torch_radbp.jit.lane.operations import DECOMPOSED, HANDLERS
from torch_radbp.jit.lane.refusal import refusal
from torch_radbp.tensors.torch_internals import TorchDispatchMode, functions_of_torch_only

QUESTIONS = ("is_same_size", "_has_same_storage_numel")  # about shapes; what is answered is no tensor
SIZE = 1_000_003  # of lanes while tracing; what they are is known by their kind, not by their size


def traced_program(function: Callable[..., Sequence[Tensor | None]], dtypes: Sequence[torch.dtype], kinds: Sequence[str],
                   places: Sequence[int] | None = None) -> Program:
    """Traces a function of flat tensors to a program.

    Args:
        function: takes one tensor for each of `dtypes`, and returns tensors of the lanes or numbers, or None.
        dtypes: float32, float64, int32, int64 or bool.
        kinds: of each tensor, LANES, NUMBER or TABLE.
        places: of each tensor, the place of the first that has the same entries; None: all differ.

    Raises:
        UnknownOperation: if the function comes down to an operation that is not one of lanes.
    """
    tracer = Tracer()
    places = range(len(kinds)) if places is None else places
    arguments = [tracer.argument(*argument) for argument in zip(places, dtypes, kinds)]
    with tracer:
        results = function(*arguments)
        outputs = tuple(None if result is None else tracer.lanes_or_number(result, "the result") for result in results)
    return program(outputs)


def stand_in(dtype: torch.dtype, shape: Sequence[int]) -> Tensor:
    """A tensor of shape () or (N,) without contents."""
    return torch.empty_strided(shape, (1,) * len(shape), dtype=dtype, device="meta")


class TableStandIn(Tensor):
    """A table during tracing: it has no length, since later calls may have tables of other lengths."""

    @classmethod
    def __torch_function__(cls, func, types, args=(), kwargs=None):
        if func in (Tensor.shape.__get__, Tensor.size, Tensor.__len__, Tensor.numel, Tensor.nelement):
            raise refusal("the length of a table, which may differ from call to call (hand it over as a number),")
        with functions_of_torch_only():
            return func(*args, **(kwargs or {}))


class Tracer(TorchDispatchMode):
    """A mode of torch that records operations on traced tensors as values of a program."""

    def __init__(self) -> None:
        super().__init__()
        self.builder = Builder()
        self.values: dict[int, Value] = {}
        self.alive: list[Tensor] = []  # so that no other tensor gets the id of one that was seen

    def argument(self, place: int, dtype: torch.dtype, kind: str) -> Tensor:
        """A tensor without contents that stands for the argument with index `place`."""
        tensor = stand_in(dtype, () if kind == NUMBER else (SIZE,))
        tensor = tensor.as_subclass(TableStandIn) if kind == TABLE else tensor
        return self.note(tensor, self.builder.value("input", (), dtype, kind, place))

    def note(self, tensor: Tensor, value: Value) -> Tensor:
        """Registers the value of the program that a traced tensor stands for, and returns the tensor."""
        self.values[id(tensor)] = value
        self.alive.append(tensor)
        return tensor

    def value_of(self, tensor: Tensor, what: str) -> Value:
        """The value of the program for a traced tensor; one number that was not traced becomes a constant."""
        if id(tensor) in self.values:
            return self.values[id(tensor)]
        if tensor.device.type != "meta" and tensor.numel() == 1:
            return self.builder.constant(tensor.item(), tensor.dtype)
        raise refusal(f"{what}: a tensor {tuple(tensor.shape)} of {tensor.device} that is no argument of the function")

    def lanes_or_number(self, tensor: Tensor, what: str) -> Value:
        """The value of the program for a traced tensor, which must not be a table."""
        value = self.value_of(tensor, what)
        if value.kind == TABLE:
            raise refusal(f"{what}: a table, which can only be read at indices")
        return value

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        kwargs = kwargs or {}
        name = func.overloadpacket.__name__
        in_place = name.endswith("_") and not name.endswith("__")  # then the tensor has another value from here on
        name = name.removesuffix("_") if in_place else name
        if name in QUESTIONS:
            return func(*args, **kwargs)
        if name not in HANDLERS:
            with self:  # what is called now is traced too
                answer = DECOMPOSED.get(name, func.decompose)(*args, **kwargs)
            if answer is NotImplemented:
                raise refusal(f"torch.{name} ({func})")
            return self.note(args[0], self.operand(answer, args[0].dtype)) if in_place else answer
        infer = None if in_place else INFERRED.get(name)
        outcome = infer(*args, **kwargs) if infer else None
        result = func(*args, **kwargs) if outcome is None else stand_in(*outcome)
        if result.shape not in ((), (SIZE,)):
            raise refusal(f"torch.{name} makes a tensor of shape {tuple(result.shape)} of lanes")
        return self.note(result, self.operand(HANDLERS[name](self, result, *args, name=name, **kwargs), result.dtype))

    @classmethod
    def _should_skip_dynamo(cls) -> bool:
        """False: torch must not import its compiler for this mode."""
        return False

    # What handlers are written with.

    def operand(self, argument: Value | Tensor | bool | int | float, dtype: torch.dtype) -> Value:
        """Converts an operand to the dtype in which the operation works."""
        if isinstance(argument, Tensor):
            argument = self.lanes_or_number(argument, "an operand")
        return self.builder.cast(argument, dtype) if isinstance(argument, Value) else self.builder.constant(argument, dtype)

    def apply(self, operation: str, dtype: torch.dtype, *arguments) -> Value:
        """Adds an operation to the program, on arguments converted to `dtype`, and with a result of that dtype."""
        return self.builder.value(operation, tuple([self.operand(argument, dtype) for argument in arguments]), dtype)

    def compare(self, operation: str, dtype: torch.dtype, a, b) -> Value:
        """Adds a comparison of arguments converted to `dtype` to the program."""
        return self.builder.value(operation, (self.operand(a, dtype), self.operand(b, dtype)), torch.bool)

    def select(self, condition: Value, a: Value, b: Value) -> Value:
        """Selects `a` where the condition holds, else `b`."""
        return a if a is b else self.builder.value("select", (condition, a, b), a.dtype)
