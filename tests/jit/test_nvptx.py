"""Kernels for NVIDIA's GPUs: their text, their PTX, and, without a GPU, what they compute."""

import re

import pytest
import torch

from tests.jit.emulated import Emulated
from tests.jit.programs import PROGRAM, arguments, mixed
from torch_radbp.jit import LaneFunction
from torch_radbp.jit.cpu.cpu import Cpu
from torch_radbp.jit.lane.graph import LANES, NUMBER, TABLE
from torch_radbp.jit.lane.trace import traced_program
from torch_radbp.jit.nvidia.gpu import Gpu
from torch_radbp.jit.nvidia.nvptx import BLOCK, ptx


def test_a_kernel_has_the_instructions_that_the_processor_has_for_single_lanes():
    """What differs is what stands around them: the loop, and how the pointers arrive."""
    kernel = Gpu(Emulated()).text(PROGRAM).split("\nlane:\n")[1].split("  br label %done")[0].splitlines()
    loop = Cpu(1).text(PROGRAM).split("define internal void @lanes(")[1].splitlines()
    assert len(kernel) > 8 and [line for line in loop if line in kernel] == kernel


def test_parameters_are_the_lanes_the_inputs_the_lengths_of_searched_tables_and_the_outputs():
    program = traced_program(lambda table, x: [torch.searchsorted(table, x, right=True), x * 2], [torch.float32] * 2,
                             [TABLE, LANES])
    head = next(line for line in Gpu(Emulated()).text(program).splitlines() if line.startswith("define ptx_kernel"))
    assert head == ("define ptx_kernel void @lanes(i64 %lanes, ptr readonly %first, ptr readonly %last, "
                    "ptr noalias readonly %in0, ptr noalias readonly %in1, i64 %length0, "
                    "ptr noalias writeonly %out0, ptr noalias writeonly %out1) #0 {")


@pytest.mark.parametrize("architecture", ["sm_80", "sm_90", "sm_100"])
def test_ptx_of_a_kernel(architecture):
    text = ptx(Gpu(Emulated()).text(PROGRAM), architecture)
    assert f".target {architecture}" in text and ".visible .entry lanes(" in text
    assert f".maxntid {BLOCK}\n.minnctapersm 1\n" in text
    assert text.count("st.global.b32") == 2 and "ld.global.nc" in text  # read through the cache for what does not change
    assert "call" not in text


@pytest.mark.parametrize("architecture", ["sm_80", "sm_90", "sm_100"])
def test_which_products_and_sums_are_fused_is_settled_by_the_ptx(architecture):
    """Those without `.rn` would be fused by NVIDIA's assembler or not, as it likes. LLVM fuses none by itself either."""
    program = traced_program(lambda x, y: [x * y + 1, x * x - y, y * y, y * y + 2, x.double() * y.double()],
                             [torch.float32] * 2, [LANES] * 2)
    text = ptx(Gpu(Emulated()).text(program), architecture)
    assert text.count("fma.rn.f32") == 2 and "mul.rn.f32" in text and "add.rn.f32" in text and "mul.rn.f64" in text
    assert not re.search(r"\s(add|sub|mul)\.f(32|64)", text)


@pytest.mark.parametrize("dtype, bits", [(torch.float32, 32), (torch.float64, 64), (torch.int32, 32), (torch.int64, 64)])
def test_a_number_of_a_call_is_read_at_once(dtype, bits):
    program = traced_program(lambda x, number: [x + number], [dtype, dtype], [LANES, NUMBER])
    assert re.findall(r"ld\.global\.nc\.[bufs](\d+)", ptx(Gpu(Emulated()).text(program), "sm_90")) == [str(bits)] * 2


@pytest.mark.parametrize("lanes", [1, BLOCK - 1, BLOCK, BLOCK + 1, 1000])
def test_blocks_cover_all_lanes_and_no_more(lanes):
    launcher, given = Emulated(), arguments(lanes)
    function = LaneFunction(mixed, tables=("colours",), target=Gpu(launcher))
    room = torch.full((lanes + 7,), -1.0)
    results = function(*given)[0]._replace(x=room), [room.int(), room > 0, room.int()], room.clone()
    function.into((results[0], results[1], results[2]), 0, *given)
    assert torch.equal(room[lanes:], torch.full((7,), -1.0))
    assert {(launch.blocks, launch.threads, launch.words[0]) for launch in launcher.launches} == {
        (-(-lanes // BLOCK), BLOCK, lanes)}
