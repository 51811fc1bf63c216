"""What PTX computes, by an interpreter of it, if one is given: a wrong instruction or a stray access would be found."""

import re

import pytest
import torch

from tests.jit.edge_values import DTYPES, assert_same, pairs
from tests.jit.interpreter import CheckedGpu, interpreted, needs_interpreter
from tests.jit.programs import addition
from torch_radbp.jit import LaneFunction
from torch_radbp.jit.nvidia import driver
from torch_radbp.jit.nvidia.nvptx import ptx

pytestmark = needs_interpreter
INT32, FLOAT32, FLOAT64 = torch.int32, torch.float32, torch.float64

# Of each instruction a function that has it, of what, and what a wrong one would be.
INSTRUCTIONS = {
    "not below, or NaN": (lambda x, y: ~(x < y), FLOAT32, r"setp\.geu(\.f32)", r"setp.ge\1"),
    "not below, or NaN, float64": (lambda x, y: ~(x < y), FLOAT64, r"setp\.geu(\.f64)", r"setp.ge\1"),
    "unequal, or NaN": (lambda x, y: x != y, FLOAT32, r"setp\.neu(\.f32)", r"setp.ne\1"),
    "NaN in the second": (lambda x, y: x.isnan() | y.isnan(), FLOAT32,
                          r"(setp\.nan\.f32\s+%p\d+, (%\w+)), %\w+", r"\1, \2"),
    "NaN in the first": (lambda x, y: x.isnan() | y.isnan(), FLOAT32,
                         r"(setp\.nan\.f32\s+%p\d+), %\w+, (%\w+)", r"\1, \2, \2"),
    "below": (lambda x, y: x < y, FLOAT32, r"setp\.lt(\.f32)", r"setp.le\1"),
    "sign": (lambda x, y: torch.copysign(x, y), FLOAT32, r"(copysign\.f32\s+%\w+), (%\w+), (%\w+)", r"\1, \3, \2"),
    "rounded to even": (lambda x, y: torch.round(x), FLOAT32, r"cvt\.rni(\.f32\.f32)", r"cvt.rmi\1"),
    "rounded down": (lambda x, y: torch.floor(x), FLOAT32, r"cvt\.rmi(\.f32\.f32)", r"cvt.rzi\1"),
    "the smaller": (lambda x, y: torch.minimum(x, y), INT32, r"min\.s32", "min.u32"),
    "choice": (lambda x, y: torch.where(x < 0, x, 2 * y), INT32,
               r"(selp\.\w+\s+%\w+), (%\w+), (%\w+)", r"\1, \3, \2"),
    "shift with the sign": (lambda x, y: x >> 5, INT32, r"shr\.s32", "shr.u32"),
    "wide product": (lambda x, y: x.long() * 12, INT32, r"mul\.wide\.s32", "mul.wide.u32"),
    "quotient": (lambda x, y: x / y, FLOAT32, r"div\.rn\.f32(\s+%\w+), (%\w+), (%\w+)", r"mul.rn.f32\1, \2, \3"),
}


@pytest.mark.parametrize("function, dtype, right, wrong", INSTRUCTIONS.values(), ids=INSTRUCTIONS)
def test_a_wrong_instruction_is_found_by_its_results(function, dtype, right, wrong, monkeypatch):
    x, y = pairs(dtype)
    expected = function(x, y)
    assert_same(LaneFunction(function, target=interpreted())(x, y), expected)

    def mistaken(text: str, architecture: str) -> str:
        text, replaced = re.subn(right, wrong, ptx(text, architecture))
        assert replaced
        return text

    monkeypatch.setattr(driver, "ptx", mistaken)
    with pytest.raises(AssertionError):
        assert_same(LaneFunction(function, target=interpreted())(x, y), expected)


@pytest.mark.parametrize("shift", [1, 2, 3])
def test_tensors_that_lie_at_any_byte_are_copied(shift):
    def misaligned(tensor: torch.Tensor) -> torch.Tensor:
        memory = bytearray(shift) + tensor.numpy().tobytes()
        return torch.frombuffer(memory, dtype=tensor.dtype, offset=shift).view(tensor.shape)

    table, x, scale = torch.arange(9.0), torch.rand(9), torch.tensor(0.7)
    function = LaneFunction(lambda table, x, scale: table.index_select(0, (x * 9).int()) * scale + x, tables=("table",),
                            target=interpreted())
    expected = function(table, x, scale)
    given = [misaligned(tensor) for tensor in (table, x, scale)]
    assert all(tensor.data_ptr() % 4 for tensor in given)
    assert torch.equal(function(*given), expected)


class OneLaneTooMany(CheckedGpu):
    """A GPU whose kernels run beyond the last lane."""

    def compile(self, program):
        checked = super().compile(program)
        launch, loop = checked.loop.run, checked.loop
        loop.run = lambda lanes, *rest: launch(lanes + 1, *rest)
        return checked


def test_an_access_outside_of_what_a_kernel_is_given_is_found():
    function = LaneFunction(lambda x: x + 1, target=OneLaneTooMany(interpreted().launcher))
    with pytest.raises(RuntimeError, match="out of bounds"):
        function(torch.rand(30))


def test_entries_are_put_and_numbers_added():
    gpu, place = interpreted("sm_80"), torch.tensor([4, 0, 3], dtype=torch.int32)
    targets, entries = [torch.zeros(5, dtype=dtype) for dtype in DTYPES], [torch.ones(3, dtype=dtype) for dtype in DTYPES]
    gpu.put(targets, place, entries)
    assert all(target.tolist() == [1, 0, 0, 1, 1] for target in targets)
    for dtype in (FLOAT32, FLOAT64):
        case = addition(1000, 7, 2, 64, dtype)
        gpu.scatter_add([case], 1000)
        for numbers, totals in zip(case.numbers, case.sums.totals):
            expected = torch.zeros(7, dtype=FLOAT64).index_add_(0, case.index, numbers.double())
            torch.testing.assert_close(totals.sum(1), expected, rtol=1e-13, atol=1e-13)
