"""The program and LLVM's text as values that can be read."""

import subprocess
import sys

import pytest
import torch

from tests.jit.programs import PROGRAM
from torch_radbp.jit import LaneFunction
from torch_radbp.jit.cpu.cpu import Cpu
from torch_radbp.jit.cpu.machine import host_width
from torch_radbp.jit.lane.graph import LANES, NUMBER, TABLE
from torch_radbp.jit.lane.trace import traced_program


def test_a_program_lists_its_values():
    assert str(PROGRAM).splitlines() == [
        "v0 = input 0(): table float32", "v1 = input 1(): lanes int32", "v2 = input 2(): lanes float32",
        "v3 = input 3(): number float32", "v4 = gather(v0, v1): lanes float32", "v5 = mul(v4, v2): lanes float32",
        "v6 = mul(v5, v3): lanes float32", "v7 = constant 1.0(): number float32", "v8 = add(v6, v7): lanes float32",
        "v9 = mul(v2, v3): lanes float32", "return v8, v9"]


def test_what_no_result_needs_is_left_out_and_equal_values_are_one():
    program = traced_program(lambda x, y: [(x + 1) * (x + 1), (torch.sin(y), x)[1]], [torch.float32] * 2, [LANES] * 2)
    assert [value.operation for value in program.values] == ["input", "constant", "add", "mul"]
    assert len(program.inputs) == 1


def test_a_gather_is_one_instruction_of_base_and_32_bit_indices():
    text = Cpu(8).text(PROGRAM)
    assert "getelementptr float, ptr %in0, <8 x i32>" in text
    assert text.count("call <8 x float> @llvm.masked.gather.v8f32.v8p0") == 1


def test_fusing_is_the_only_liberty_and_is_taken_by_name():
    text = Cpu(8).text(PROGRAM)
    assert text.count("call <8 x float> @llvm.fma.v8f32") == 1 and text.count("fmul <8 x float>") == 2
    assert not any(word in text for word in ("contract", "reassoc", "nnan", "ninf", "nsz", "fast"))


def test_single_lanes_have_no_vectors():
    text = Cpu(1).text(PROGRAM)
    assert "<" not in text.replace("icmp slt", "") and "load float" in text


def test_the_width_is_that_of_the_processor():
    assert host_width() in (4, 8, 16)


@pytest.mark.parametrize("searches, vectors", [(False, 1), (True, 2)])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
def test_two_vectors_are_computed_at_once_where_they_search(dtype, searches, vectors):
    program = traced_program(lambda table, x: [torch.searchsorted(table, x, right=True).to(dtype) if searches else x + 1],
                             [dtype, dtype], [TABLE, LANES])
    lanes = host_width() * torch.float32.itemsize // dtype.itemsize  # of a vector
    assert f"add i64 %at, {vectors * lanes}" in Cpu().text(program)


def test_the_compiler_imports_nothing_of_rendering_and_no_other_compiler():
    """Neither does it when it traces."""
    code = ("import sys, torch; from torch_radbp.jit import LaneFunction; "
            "LaneFunction(lambda x, k: (x.exp() * 2).clamp(0, 1) + torch.div(k, 3, rounding_mode='floor'))("
            "torch.rand(9), torch.arange(9)); print('torch._dynamo' in sys.modules, "
            "{name.split('.')[1] for name in sys.modules if name.startswith('torch_radbp.')} "
            "- {'jit', 'tensors', 'threads', 'install_hint'})")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False set()"


def test_what_is_the_same_for_all_lanes_is_computed_once():
    program = traced_program(lambda x, scale: [x * (scale * scale)], [torch.float32] * 2, [LANES, NUMBER])
    before, loop = Cpu(8).text(program).split("define internal void @lanes(")[1].split("\nloop:\n")
    assert before.count("fmul") == 1 and loop.count("fmul") == 1


@pytest.mark.parametrize("width", [1, 4, 8, 16])
def test_blocks_of_lanes_ask_for_memory_ahead(width):
    """Of two arrays and two results, and of a table at every eighth index; single lanes do not."""
    hints = Cpu(width).text(PROGRAM).count("call void @llvm.prefetch")
    assert hints == (0 if width == 1 else 2 + 2 + max(1, width // 8))


@pytest.mark.parametrize("least", [None, 0])
def test_blocks_of_lanes_ask_for_the_rows_of_all_their_lanes(least):
    """Of columns of the same rows, both ends; also at an index of which what is negative becomes 0."""
    def read(columns, index):
        index = index if least is None else index.clamp_min(least)
        return [columns[k][index] for k in (0, 1, 3)]

    program = LaneFunction(read, ("columns",)).program(torch.rand(300, 4).unbind(1), torch.arange(40, dtype=torch.int32))
    assert Cpu(16).text(program).count("call void @llvm.prefetch") == 1 + 3 + 2 * 16
