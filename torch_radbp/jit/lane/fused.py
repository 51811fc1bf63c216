"""Products that are fused with the sum that they enter: rounded once, by one instruction.

Which are is said here, and not left to LLVM, which would fuse others at each of its levels and on each processor: so code
that is made quickly, code that is made well, and a GPU's compute the same bits.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import NamedTuple

from torch_radbp.jit.lane.graph import Program, Value
from torch_radbp.jit.lane.instructions import INTEGERS


class FusedSum(NamedTuple):
    """A sum of a product and a term, each of which may be negated."""

    product: Value
    term: Value
    negative_product: bool
    negative_term: bool


def fuses(features: Mapping[str, bool]) -> bool:
    """True if a processor with these instruction sets fuses in one instruction: all do, but x86 before AVX2."""
    return bool(features.get("fma", True))


def fused_sums(program: Program) -> tuple[dict[Value, FusedSum], set[Value]]:
    """The sums of a program that a product is fused with, and the values that need not be computed by themselves then.

    A product is fused if nothing else uses it; of two in one sum, the first.
    """
    uses = Counter(argument for value in program.values for argument in value.arguments)
    uses.update(value for value in program.outputs if value is not None)
    sums: dict[Value, FusedSum] = {}
    within: set[Value] = set()
    for value in program.values:
        if value.operation not in ("add", "sub") or value.dtype in INTEGERS:
            continue
        for number, product in enumerate(value.arguments):
            on_the_way = [product]
            if product.operation == "neg":
                on_the_way.append(product.arguments[0])
            negated, product = len(on_the_way) == 2, on_the_way[-1]
            if product.operation == "mul" and all(uses[one] == 1 and one.kind == value.kind for one in on_the_way):
                second = value.operation == "sub" and number == 1
                sums[value] = FusedSum(product, value.arguments[1 - number], negated != second,
                                       value.operation == "sub" and number == 0)
                within.update(on_the_way)
                break
    return sums, within
