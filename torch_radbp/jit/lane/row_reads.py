"""Look-ups of several interleaved tables (columns of the same rows) at one index.

Of rows, four entries at a time are loaded for each lane, and turned into vectors of lanes: for four columns a load a lane
where gathers take four, all in one line of the cache. What lies beyond a row is not touched: the last may end the memory.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch

from torch_radbp.jit.lane.graph import LANES, Program, Value
from torch_radbp.jit.lane.instructions import SCALARS
from torch_radbp.tensors.interleaved import AT_ONCE  # also the lanes of which a square of entries is turned

# Of loads that none of these parts LLVM compares each with every other. It is no instruction of the processor's.
FENCE = 'fence syncscope("singlethread") seq_cst'


def in_rows(program: Program, width: int) -> dict[tuple[Value, int], list[Value]]:
    """Groups the gathers at one index from columns of the same rows, two or more of them; for blocks of `width` lanes."""
    found: dict[tuple[Value, int], list[Value]] = {}
    for value in program.values if program.columns and width % AT_ONCE == 0 else ():
        column = program.column(value.arguments[0]) if value.operation == "gather" else None
        if column is not None and value.arguments[1].kind == LANES and value.dtype in (torch.float32, torch.int32):
            found.setdefault((value.arguments[1], column.block), []).append(value)
    return {key: gathers for key, gathers in found.items() if len(gathers) > 1}


class RowReading:
    """Emits the look-ups in one set of rows at one index.

    Args:
        emitter: of the program.
        index: name of the block of indices.
        scalar: LLVM's name of their type.
    """

    def __init__(self, emitter, index: str, scalar: str):
        self.emitter, self.index, self.scalar, self.line = emitter, index, scalar, emitter.line

    def emit(self, gathers: Sequence[Value]) -> list[str]:
        """Emits the instructions of gathers from these rows, and returns the names of their results."""
        tables = {self.emitter.program.column(value.arguments[0]).place: value for value in gathers}
        first, table = min(tables.items())
        width = self.emitter.program.column(table.arguments[0]).width
        start = self.line(f"getelementptr i32, ptr {self.emitter.names[table.arguments[0]]}, i64 {-first}",
                          self.emitter.entry)
        rows = [self.row(start, lane, width) for lane in range(self.emitter.width)]
        self.emitter.here.append(FENCE)
        columns = {}
        for place in sorted({place // AT_ONCE * AT_ONCE for place in tables}):
            columns |= zip(range(place, place + AT_ONCE), self.turned([self.entries(row, place, width - place)
                                                                       for row in rows]))
        return [self.of_type(columns[self.emitter.program.column(value.arguments[0]).place], SCALARS[value.dtype])
                for value in gathers]

    def row(self, start: str, lane: int, width: int) -> str:
        """Emits the address of a lane's row."""
        number = self.line(f"extractelement {self.emitter.vector(self.scalar)} {self.index}, i32 {lane}")
        wide = number if self.scalar == "i64" else self.line(f"sext i32 {number} to i64")
        entry = self.line(f"mul nsw i64 {wide}, {width}")
        return self.line(f"getelementptr i32, ptr {start}, i64 {entry}")

    def entries(self, row: str, place: int, left: int) -> str:
        """Emits the load of four entries of a row, of which `left` exist."""
        at, kind = self.line(f"getelementptr i32, ptr {row}, i64 {place}") if place else row, f"<{AT_ONCE} x i32>"
        if left >= AT_ONCE:
            return self.line(f"load {kind}, ptr {at}, align 4")
        function, flags = f"llvm.masked.load.v{AT_ONCE}i32.p0", f"<{AT_ONCE} x i1>"
        self.emitter.declared[function] = f"declare {kind} @{function}(ptr, i32, {flags}, {kind})"
        inside = ", ".join(f"i1 {'true' if number < left else 'false'}" for number in range(AT_ONCE))
        return self.line(f"call {kind} @{function}(ptr {at}, i32 4, {flags} <{inside}>, {kind} poison)")

    def turned(self, entries: Sequence[str]) -> list[str]:
        """Transposes four entries of each lane to four columns of all lanes.

        Every fourth lane stands in one vector, so that squares of four lanes by four columns are turned where they are.
        """
        lanes = len(entries)
        a, b, c, d = (self.joined(entries[first::AT_ONCE]) for first in range(AT_ONCE))
        squares = range(0, lanes, AT_ONCE)

        def mixed(x: str, y: str, order: Sequence[int]) -> str:
            """Shuffles, in each square, entries of the first (0 to 3) and of the second (4 to 7) vector."""
            places = [at + one if one < AT_ONCE else lanes + at + one - AT_ONCE for at in squares for one in order]
            kind = f"<{lanes} x i32>"
            return self.line(f"shufflevector {kind} {x}, {kind} {y}, {kind} <{', '.join(f'i32 {at}' for at in places)}>")

        low, high = (0, 4, 1, 5), (2, 6, 3, 7)
        ab_low, ab_high, cd_low, cd_high = mixed(a, b, low), mixed(a, b, high), mixed(c, d, low), mixed(c, d, high)
        return [mixed(x, y, order) for x, y in ((ab_low, cd_low), (ab_high, cd_high))
                for order in ((0, 1, 4, 5), (2, 3, 6, 7))]

    def joined(self, parts: Sequence[str]) -> str:
        """Emits the concatenation of vectors of four lanes."""
        size, parts = AT_ONCE, list(parts)
        while len(parts) > 1:
            order = ", ".join(f"i32 {place}" for place in range(2 * size))
            parts = [self.line(f"shufflevector <{size} x i32> {x}, <{size} x i32> {y}, <{2 * size} x i32> <{order}>")
                     for x, y in zip(parts[::2], parts[1::2])]
            size *= 2
        return parts[0]

    def of_type(self, name: str, scalar: str) -> str:
        """Converts a column to the type of its entries."""
        whole = self.emitter.vector("i32")
        return name if scalar == "i32" else self.line(f"bitcast {whole} {name} to {self.emitter.vector(scalar)}")
