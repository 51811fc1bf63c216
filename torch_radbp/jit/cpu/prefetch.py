"""Prefetch instructions, by which the processor fetches memory before it is needed.

A block of lanes reads and writes dozens of arrays, more than a processor follows by itself, and is so long that it never
looks ahead into the next block. So each block asks for what one of the next will touch: its parts of the arrays of lanes,
and of tables that are read at indices from such an array, the entries of some of its lanes, or rows of all.
"""

from __future__ import annotations

from collections.abc import Iterator

import torch

from torch_radbp.jit.lane.graph import LANES, Program, Value
from torch_radbp.jit.lane.instructions import SCALARS, memory

AHEAD = 64  # lanes: some blocks
APART = 8  # lanes of which an entry is asked for: neighbours often share a line of the cache
DECLARATION = "declare void @llvm.prefetch.p0(ptr, i32, i32, i32)"
READ, WRITE = 0, 1


def prefetches(program: Program, tables: dict[Value, str], width: int) -> Iterator[str]:
    """The prefetch instructions for the body of a loop.

    Args:
        program: of the loop; `%in<k>` and `%out<k>` are the pointers to its inputs and outputs.
        tables: the names of the pointers to its tables.
        width: lanes in a block, at least 2.
    """
    yield f"%ahead = add i64 %i, {AHEAD}"
    arrays = [(f"%in{k}", value, READ) for k, value in enumerate(program.inputs) if value.kind == LANES]
    arrays += [(f"%out{k}", value, WRITE) for k, value in enumerate(found for found in program.outputs if found is not None)]
    for pointer, value, purpose in arrays:
        yield from prefetch(f"%ahead{pointer[1:]}", pointer, memory(value.dtype), "i64 %ahead", purpose)
    indices = [(k, value) for k, value in enumerate(program.inputs) if value.kind == LANES and value.dtype == torch.int32]
    for k, index in indices:
        found = [value.arguments[0] for value in program.values
                 if value.operation == "gather" and unclamped(value.arguments[1]) is index]
        # Neighbours rarely share a row, and a row may lie in two lines of the cache.
        of_rows = [ends for rows in in_blocks(program, found) for ends in dict.fromkeys((rows[0], rows[-1]))]
        others = [table for table in found if program.column(table) is None]
        for lane in range(0, width if found else 0, 1 if of_rows else APART):
            name = f"%index{k}.{lane}"
            # A hint may point anywhere, but the index itself is read: no later than of the last lane.
            yield from (f"{name}.lane = add i64 %ahead, {lane}", f"{name}.last = sub i64 %last, 1",
                        f"{name}.over = icmp sgt i64 {name}.lane, {name}.last",
                        f"{name}.inside = select i1 {name}.over, i64 {name}.last, i64 {name}.lane",
                        f"{name}.at = getelementptr {SCALARS[index.dtype]}, ptr %in{k}, i64 {name}.inside",
                        f"{name} = load {SCALARS[index.dtype]}, ptr {name}.at, align 4")
            for number, table in enumerate(of_rows + others if lane % APART == 0 else of_rows):
                column, entry = program.column(table), f"{name}.{number}.entry"
                yield f"{entry} = mul i32 {name}, {1 if column is None else column.width}"
                yield from prefetch(f"{name}.{number}", tables[table], memory(table.dtype), f"i32 {entry}", READ)


def unclamped(index: Value) -> Value:
    """The index before negative values are clamped to 0; the given one if it is not clamped."""
    condition, *_, value = index.arguments if index.operation == "select" else (index, index)
    clamps = condition is not value and condition.operation == "lt" and condition.arguments[0] is value
    return value if clamps else index


def in_blocks(program: Program, tables: list[Value]) -> list[list[Value]]:
    """Groups tables that are columns of the same rows."""
    blocks: dict[int, list[Value]] = {}
    for table in tables:
        if program.column(table) is not None:
            blocks.setdefault(program.column(table).block, []).append(table)
    return list(blocks.values())


def prefetch(name: str, pointer: str, element: str, index: str, purpose: int) -> tuple[str, str]:
    """Instructions that prefetch one entry of an array; `name` becomes that of its address."""
    return (f"{name} = getelementptr {element}, ptr {pointer}, {index}",
            f"call void @llvm.prefetch.p0(ptr {name}, i32 {purpose}, i32 3, i32 1)")
