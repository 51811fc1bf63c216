"""Emits a program that is repeated for a lane, turn after turn, as long as one of its outputs says so; for single lanes.

What a turn reads of the tables that are written anew is the output of the turn before, and stays in registers. What is the
same in every turn is computed once. There is at least one turn.
"""

from __future__ import annotations

from collections.abc import Iterator

from torch_radbp.jit.lane.graph import NUMBER, Repetition, Value
from torch_radbp.jit.lane.instructions import SCALARS
from torch_radbp.jit.lane.schedule import few_alive


class RepeatedText:
    """Emits the LLVM IR of a program that is repeated for one lane as long as one of its outputs is true.

    Args:
        emitter: of the program (`emit.ProgramText`), for blocks of one lane; the label before its instructions is `lane`.
        repetition: the program's.
    """

    def __init__(self, emitter, repetition: Repetition):
        assert emitter.width == 1, "lanes of a block do not all go on"
        self.emitter, self.repetition = emitter, repetition
        self.outputs = emitter.program.outputs
        # What is read where the output of the turn before stands from the second turn on.
        self.before: dict[Value, Value] = {}
        for value in emitter.program.values:
            number = self.output_of(value)
            if number is not None and self.outputs[number] is not value:
                self.before[value] = self.outputs[number]

    def output_of(self, value: Value) -> int | None:
        """The number of the output that takes the place of a read table entry in the next repetition; None: none does."""
        if value.operation != "gather":
            return None
        return dict(self.repetition.state).get(value.arguments[0].static)

    def changing(self, values: list[Value]) -> Iterator[Value]:
        """Yields the values that depend on table entries which change from one repetition to the next."""
        found = set(self.before)
        for value in values:
            if value not in found and not found.isdisjoint(value.arguments):
                found.add(value)
                yield value

    def instructions(self):
        """Emits all instructions of the repeated program; returns what `ProgramText.instructions` does."""
        emitter, values = self.emitter, few_alive(self.emitter.program.values)
        turn = list(self.changing(values))
        later = set(turn)
        for value in values:
            if value not in later and value not in emitter.names and value not in emitter.within:
                emitter.here = emitter.entry
                emitter.names[value] = emitter.emit(value)
        first = {value: emitter.names[value] for value in self.before}
        emitter.names |= {value: f"%state{number}" for number, value in enumerate(self.before)}
        emitter.here = emitter.body
        for value in turn:
            assert value.kind != NUMBER
            if value not in emitter.within:
                emitter.names[value] = emitter.emit(value)
        phis = [f"{emitter.names[value]} = phi {emitter.vector(SCALARS[value.dtype])} [ {first[value]}, %lane ], "
                f"[ {emitter.names[after]}, %turn ]" for value, after in self.before.items()]
        running = emitter.names[self.outputs[self.repetition.running]]
        emitter.body[:0] = ["br label %turn", "turn:", *phis]
        emitter.body += [f"br i1 {running}, label %turn, label %ended", "ended:"]
        for number, value in enumerate(self.outputs):
            if value is not None:
                emitter.store(value, [number])
        return emitter.text()
