"""Orders values for GPU threads so that few are alive at a time, to avoid register spills."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from heapq import heapify, heappop, heappush

import torch

from torch_radbp.jit.lane.graph import TABLE, Value

REGISTERS = 255  # of 32 bits, the most that a thread may have


def registers(value: Value) -> float:
    """The number of registers that a value takes; flags have registers of their own."""
    if value.operation == "constant" or value.kind == TABLE:
        return 0
    return 0.25 if value.dtype == torch.bool else value.dtype.itemsize / 4


def most_alive(values: Sequence[Value]) -> float:
    """The greatest number of registers for values that are alive at once."""
    last = {argument: place for place, value in enumerate(values) for argument in value.arguments}
    ending = Counter()
    for value, place in last.items():
        ending[place] += registers(value)
    most = alive = 0.0
    for place, value in enumerate(values):
        alive += registers(value) if value in last else 0
        most = max(most, alive)
        alive -= ending[place]
    return most


def few_alive(values: Sequence[Value]) -> list[Value]:
    """Orders values so that few are alive at once, each after those that it is computed from.

    List scheduling from the last value to the first: of the values whose users are all placed, the next is the one that
    makes fewest others alive, and of equals the last of those given. LLVM and NVIDIA's assembler move instructions by
    little, so that it shows in what kernels spill. An order in which all values find room stays as it is.

    Reference: Gibbons and Muchnick 1986, "Efficient instruction scheduling for a pipelined architecture" (list scheduling);
    Goodman and Hsu 1988, "Code scheduling and register allocation in large basic blocks" (by the number of live values).
    """
    if most_alive(values) <= REGISTERS:
        return list(values)
    needs = {value: set(value.arguments) for value in values}
    place = {value: number for number, value in enumerate(values)}
    users: dict[Value, list[Value]] = {value: [] for value in values}
    for value in values:
        for argument in needs[value]:
            users[argument].append(value)
    waiting = {value: len(users[value]) for value in values}  # users that are not placed
    # Registers that a value adds if it is the next; it is alive itself if it has users.
    added = {value: sum(map(registers, needs[value])) - registers(value) * bool(users[value]) for value in values}

    def entry(value: Value) -> tuple[float, int, Value]:
        return added[value], -place[value], value

    ready = [entry(value) for value in values if not users[value]]
    heapify(ready)
    alive: set[Value] = set()
    placed: dict[Value, None] = {}
    while ready:
        registers_added, _, value = heappop(ready)
        if value in placed or registers_added != added[value]:
            continue  # there is another entry, with fewer registers
        placed[value] = None
        for argument in needs[value]:
            if argument not in alive:
                alive.add(argument)
                for user in users[argument]:
                    added[user] -= registers(argument)
                    if not waiting[user] and user not in placed:
                        heappush(ready, entry(user))
            waiting[argument] -= 1
        for argument in needs[value]:
            if not waiting[argument]:
                heappush(ready, entry(argument))
    return [*placed][::-1]
