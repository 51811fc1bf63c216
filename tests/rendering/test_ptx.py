"""Whole renderings by PTX, through CUDA's driver, both of which are stood in for (`tests/jit/interpreter.py`).

Every call of every kernel has the bits of the processor's loop; none touches what it is not given.
"""

from __future__ import annotations

import contextlib
import ctypes
from collections.abc import Sequence

import pytest
import torch
from torch import Tensor

from benchmarks.scenes import QUICK
from benchmarks.scenes import SCENES as BENCHMARKS
from tests.gradients import cotangent, image_and_gradients, relative_error
from tests.jit.interpreter import CheckedGpu, CheckedLoop, interpreted, needs_interpreter
from tests.rendering.on_gpu import render_on
from tests.rendering.recorded import SCENES, build
from tests.scenes import CASES, cornell
from torch_radbp.jit.cpu.cpu import Cpu
from torch_radbp.jit.cpu.kernel_code import CpuLoop
from torch_radbp.jit.lane.graph import Program
from torch_radbp.jit.lane.lowered import without_library
from torch_radbp.path import vertices

pytestmark = [needs_interpreter, pytest.mark.deep, pytest.mark.filterwarnings(
    "error:.*runs eagerly:RuntimeWarning", "ignore::torch_radbp.SilhouetteWarning", "ignore::torch_radbp.JumpWarning")]
ARCHITECTURES = ("sm_80", "sm_90")


@pytest.fixture(autouse=True)
def nothing_kept(monkeypatch):
    """PTX is not kept in the place of machine code."""
    monkeypatch.setenv("RADBP_KERNEL_CACHE", "off")


@pytest.fixture
def at_once(monkeypatch):
    """Loops of the processor do not wait for each other, as kernels do not: what both find is compared one by one."""
    monkeypatch.setattr(vertices, "loops_together", contextlib.nullcontext)


class ComparedLoop:
    """The kernel of a program, and the processor's loop, whose results must have the same bits; see `target.Loop`."""

    def __init__(self, kernel: CheckedLoop, loop: CpuLoop, program: Program):
        self.kernel, self.loop, self.program = kernel, loop, program

    def run(self, lanes: int, inputs: Sequence[int], lengths: Sequence[int], outputs: Sequence[int]) -> None:
        """Runs all lanes of both."""
        expected = [torch.empty(lanes, dtype=value.dtype) for value in self.program.outputs]
        self.loop.run(lanes, inputs, lengths, [tensor.data_ptr() for tensor in expected])
        self.kernel.run(lanes, inputs, lengths, outputs)
        for value, address, wanted in zip(self.program.outputs, outputs, expected):
            found = torch.frombuffer((ctypes.c_char * wanted.nbytes).from_address(address), dtype=wanted.dtype)
            assert torch.equal(bits(found), bits(wanted)), f"{value!r} of {lanes} lanes"


def bits(tensor: Tensor) -> Tensor:
    """The bits of a tensor's entries, those of every NaN the same."""
    if not tensor.is_floating_point():
        return tensor
    return torch.where(tensor.isnan(), torch.nan, tensor).view(torch.int32 if tensor.dtype == torch.float32 else torch.int64)


class Compared(CheckedGpu):
    """A GPU that is compared with the processor; of the C library both have the GPU's formulas."""

    def compile(self, program: Program) -> ComparedLoop:
        program = without_library(program)
        return ComparedLoop(super().compile(program), Cpu(1).compile(program), program)

    def put(self, targets: Sequence[Tensor], place: Tensor, entries: Sequence[Tensor]) -> None:
        expected = [target.index_copy(0, place.long(), entry) for target, entry in zip(targets, entries)]
        super().put(targets, place, entries)
        assert all(torch.equal(bits(target), bits(wanted)) for target, wanted in zip(targets, expected))


# The kernels of the materials take as long to compile as all others; their attached ones run in `test_gpu.py`.
CASES_OF_KERNELS = [*((name, "hybrid", torch.float32, "sm_80") for name in SCENES),
                    *((name, "attached", torch.float64, "sm_90") for name in SCENES if name != "materials")]


@pytest.mark.parametrize("name, sampling, dtype, architecture", CASES_OF_KERNELS,
                         ids=[f"{name}-{sampling}" for name, sampling, *_ in CASES_OF_KERNELS])
def test_every_kernel_has_the_bits_of_the_processor(name, sampling, dtype, architecture, at_once, monkeypatch):
    scene = build(name, dtype)
    names = [name for name, _ in scene.named_parameters()]
    settings = {"spp": 1, "max_depth": 4, "rr_depth": 2, "sampling": sampling}
    device = Compared(interpreted(architecture).launcher)
    expected, gradients = image_and_gradients(scene, names, compile=False, **settings)
    render_on(device, monkeypatch)
    image, found = image_and_gradients(scene, names, compile=True, **settings)
    driver = device.launcher.driver
    assert driver.launches["lanes"] > 10 and driver.launches["put"] and driver.launches["scatter"]
    assert all(f".target {architecture}" in text for text in driver.texts)
    if dtype == torch.float64:
        assert relative_error(image, expected) < 1e-12
        for name, gradient, wanted in zip(names, found, gradients):
            seen = wanted.abs().max() > 1e-9  # below that it is rounding, as of texture coordinates that nothing reads
            assert relative_error(gradient, wanted) < 1e-9 if seen else gradient.abs().max() < 1e-8, name


@pytest.mark.parametrize("name", BENCHMARKS)
def test_every_kernel_of_the_benchmarks_has_the_bits_of_the_processor(name, at_once, monkeypatch, tmp_path):
    device = Compared(interpreted().launcher)
    render_on(device, monkeypatch)
    image = BENCHMARKS[name].make(tmp_path, QUICK).renderer(True)(seed=1)
    image.backward(cotangent(image.detach()))
    assert image.detach().std() > 0 and device.launcher.driver.launches["lanes"] > 10


@pytest.mark.parametrize("architecture", ARCHITECTURES)
def test_kernels_render_what_torch_does(architecture, monkeypatch):
    """As they are launched, products and sums fused."""
    device, names = interpreted(architecture), CASES["cornell"].parameters
    settings = {"spp": 4, "max_depth": 5, "rr_depth": 3}
    expected, gradients = image_and_gradients(cornell(torch.float64, 12), names, compile=False, **settings)
    render_on(device, monkeypatch)
    image, found = image_and_gradients(cornell(torch.float64, 12), names, compile=True, **settings)
    assert relative_error(image, expected) < 1e-12
    for name, gradient, wanted in zip(names, found, gradients):
        assert relative_error(gradient, wanted) < 1e-11, name
    driver = device.launcher.driver
    assert set(driver.launches) == {"lanes", "put", "scatter"} and not driver.contexts
    assert any("fma.rn.f64" in text for text in driver.texts)
