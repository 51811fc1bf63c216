"""What is asked of CUDA's driver: modules, launches, streams and errors, by one that only notes it; no GPU is needed."""

import ctypes
import re
import sys
from array import array
from contextlib import contextmanager
from types import SimpleNamespace

import pytest
import torch

from tests.jit.programs import arguments, mixed
from torch_radbp.install_hint import install_with
from torch_radbp.jit import LaneFunction
from torch_radbp.jit.nvidia.driver import Driver, NoDriver, driver_of
from torch_radbp.jit.nvidia.gpu import Gpu
from torch_radbp.jit.nvidia.nvptx import BLOCK

GOOD, BAD = "success", "bad"
DEVICE = torch.device("cuda", 1)


class NotingDriver:
    """Stands for `cuda.bindings.driver`: every function notes its name and arguments, and succeeds but for `failing`."""

    CUresult = SimpleNamespace(CUDA_SUCCESS=GOOD)
    CUjitInputType = SimpleNamespace(CU_JIT_INPUT_PTX="ptx")
    CUjit_option = SimpleNamespace(CU_JIT_ERROR_LOG_BUFFER="log", CU_JIT_ERROR_LOG_BUFFER_SIZE_BYTES="size")
    CUstreamCaptureMode = SimpleNamespace(CU_STREAM_CAPTURE_MODE_RELAXED="relaxed")
    answers = {"cuStreamIsCapturing": (0,), "cuStreamCreate": (5,), "cuStreamEndCapture": ("noted",),
               "cuGraphInstantiate": ("graph",), "cuDeviceGet": ("device",),
               "cuDevicePrimaryCtxRetain": ("context",), "cuModuleLoadData": ("module",),
               "cuModuleGetFunction": ("kernel",), "cuLinkCreate": ("link",), "cuCtxPopCurrent": ("context",)}

    def __init__(self, failing: str = ""):
        self.failing, self.calls, self.words = failing, [], []
        self.cubin = ctypes.create_string_buffer(b"machine code", 12)

    def __getattr__(self, name: str):
        def function(*given):
            self.calls.append((name, *given))
            if name == "cuLinkCreate":
                self.log = given[-1][0]
            if name == self.failing:
                if name == "cuLinkAddData":
                    ctypes.memmove(self.log, b"line 7: nonsense", 17)
                return (BAD, *self.answers.get(name, ()))
            if name == "cuLinkComplete":
                return GOOD, ctypes.addressof(self.cubin), 12
            if name == "cuLaunchKernel":  # the driver reads the parameters now
                words = (ctypes.c_void_p * 5).from_address(given[-1])
                assert (words[0], words[2], words[4]) == (1, 2, None)
                size = ctypes.c_size_t.from_address(words[3]).value
                self.words.append(array("q", ctypes.string_at(words[1], size)).tolist())
            return (GOOD, *self.answers.get(name, ()))

        function.__name__ = name
        return function

    def cuGetErrorName(self, error):
        return GOOD, b"CUDA_ERROR_OUT_OF_MEMORY"

    def cuGetErrorString(self, error):
        return GOOD, b"out of memory"

    def of(self, name: str) -> list[tuple]:
        """The arguments of the calls of a function."""
        return [call[1:] for call in self.calls if call[0] == name]


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("RADBP_KERNEL_CACHE", str(tmp_path))
    return tmp_path


def driver(failing: str = "") -> Driver:
    streams = [77]

    @contextmanager
    def on(stream: int):
        streams.append(stream)
        try:
            yield
        finally:
            streams.pop()

    return Driver(NotingDriver(failing), "sm_90", DEVICE, lambda: streams[-1], on)


def test_the_device_is_the_one_of_the_tensors():
    noting = driver().driver
    assert noting.of("cuDeviceGet") == [(1,)] and noting.of("cuDevicePrimaryCtxRetain") == [("device",)]


def test_a_function_of_lanes_is_launched_on_the_current_stream_with_the_addresses_of_its_tensors():
    launcher = driver()
    function, given = LaneFunction(mixed, tables=("colours",), target=Gpu(launcher)), arguments(1000)
    found = function(*given)
    function(*given)
    assert len(launcher.driver.of("cuModuleLoadData")) == 1  # once for both
    for launch in launcher.driver.of("cuLaunchKernel"):
        assert launch[:9] == ("kernel", -(-1000 // BLOCK), 1, 1, BLOCK, 1, 1, 0, 77) and launch[9] == 0
    lanes, first, last, *words = launcher.driver.words[0]
    point, (colours,), index, scale, _ = given
    assert (lanes, first, last) == (1000, 0, 0)
    assert words[:4] == [tensor.data_ptr() for tensor in (point.x, colours, index, scale)]
    assert words[4] == found[0].x.data_ptr() and len(words) == 4 + 4


def test_the_device_of_before_is_current_again_after_each_call():
    launcher = driver()
    LaneFunction(mixed, tables=("colours",), target=Gpu(launcher))(*arguments(10))
    names = [call[0] for call in launcher.driver.calls if call[0].startswith("cuCtx")]
    assert names == ["cuCtxPushCurrent", "cuCtxPopCurrent"] * 2
    failing = driver("cuLaunchKernel")
    with pytest.raises(RuntimeError):
        failing.launch("kernel", 1, 1, array("q", [1]))
    assert [call[0] for call in failing.driver.calls][-1] == "cuCtxPopCurrent"


def test_ptx_is_assembled_once_and_machine_code_loaded_ever_after(folder):
    first, second = driver(), driver()
    for launcher in (first, second):
        LaneFunction(mixed, tables=("colours",), target=Gpu(launcher))(*arguments(10))
    (_, kind, text, size, *_), = first.driver.of("cuLinkAddData")
    assert kind == "ptx" and text.endswith(b"\0") and size == len(text) and b".target sm_90" in text
    assert first.driver.of("cuLinkDestroy") == [("link",)] and not second.driver.of("cuLinkAddData")
    assert first.driver.of("cuModuleLoadData") == second.driver.of("cuModuleLoadData") == [(b"machine code",)]
    assert len(list(folder.rglob("*.code"))) == 1


def two_kernels(launch) -> None:
    for kernel in ("first", "second"):
        launch(kernel, 2, 128, array("q", [1, 2]).buffer_info()[0], 0)


def test_a_graph_is_captured_aside_and_started_by_one_call_on_the_current_stream():
    launcher = driver()
    graphs = [launcher.captured(two_kernels) for _ in range(2)]
    calls = launcher.driver.calls
    assert launcher.driver.of("cuStreamCreate") == [(1,)]  # one that blocks no other, for all graphs
    first = next(number for number, call in enumerate(calls) if call[0] == "cuStreamBeginCapture")
    assert [call[:2] for call in calls[first:] if call[0] not in ("cuCtxPushCurrent", "cuCtxPopCurrent")][:6] == [
        ("cuStreamBeginCapture", 5), ("cuLaunchKernel", "first"), ("cuLaunchKernel", "second"), ("cuStreamEndCapture", 5),
        ("cuGraphInstantiate", "noted"), ("cuGraphDestroy", "noted")]
    assert {launch[8] for launch in launcher.driver.of("cuLaunchKernel")} == {5}
    before = len(calls)
    launcher.play(graphs[0])
    assert calls[before:] == [
        ("cuCtxPushCurrent", "context"), ("cuGraphLaunch", "graph", 77), ("cuCtxPopCurrent",)]
    del graphs
    assert launcher.driver.of("cuGraphExecDestroy") == [("graph",)] * 2


@pytest.mark.parametrize("failing", ["cuStreamCreate", "cuStreamBeginCapture", "cuLaunchKernel", "cuStreamEndCapture",
                                     "cuGraphInstantiate"])
def test_where_the_driver_makes_no_graph_there_is_none_and_no_capture_is_left(failing):
    launcher = driver(failing)
    assert launcher.captured(two_kernels) is None and launcher.stream() == 77
    assert len(launcher.driver.of("cuStreamEndCapture")) == (failing not in ("cuStreamCreate", "cuStreamBeginCapture"))
    assert len(launcher.driver.of("cuGraphDestroy")) == (failing == "cuGraphInstantiate")
    assert launcher.driver.calls[-1][0] == "cuCtxPopCurrent"


def test_what_the_caller_captures_is_known(monkeypatch):
    assert not driver().is_captured()
    monkeypatch.setattr(NotingDriver, "answers", NotingDriver.answers | {"cuStreamIsCapturing": (1,)})
    assert driver().is_captured()


def test_an_error_of_the_driver_names_the_function_the_device_and_what_went_wrong():
    with pytest.raises(RuntimeError, match="cuModuleLoadData on cuda:1: CUDA_ERROR_OUT_OF_MEMORY, out of memory"):
        LaneFunction(mixed, tables=("colours",), target=Gpu(driver("cuModuleLoadData")))(*arguments(10))


def test_ptx_that_is_refused_is_kept_with_what_the_assembler_said(monkeypatch, tmp_path):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with pytest.raises(RuntimeError, match=r"cuLinkAddData on cuda:1.*The assembler said: line 7: nonsense. Its input is "):
        LaneFunction(mixed, tables=("colours",), target=Gpu(driver("cuLinkAddData")))(*arguments(10))
    left, = tmp_path.glob("*.ptx")
    assert ".visible .entry lanes(" in left.read_text()


def test_without_the_bindings_the_message_says_how_to_get_them(monkeypatch):
    monkeypatch.setitem(sys.modules, "cuda.bindings", None)
    monkeypatch.setitem(sys.modules, "cuda", None)
    with pytest.raises(NoDriver, match=re.escape(f"{install_with('cuda')}, or render with compile=False")):
        driver_of(DEVICE)


def bindings(monkeypatch, initialise) -> None:
    """Bindings whose cuInit is `initialise`."""
    found = SimpleNamespace(cuInit=initialise, CUresult=NotingDriver.CUresult)
    monkeypatch.setitem(sys.modules, "cuda", SimpleNamespace(bindings=SimpleNamespace(driver=found)))
    monkeypatch.setitem(sys.modules, "cuda.bindings", SimpleNamespace(driver=found))


def test_without_a_driver_the_message_says_so(monkeypatch):
    def missing(flags):
        raise RuntimeError("libcuda.so is not there")

    bindings(monkeypatch, missing)
    with pytest.raises(NoDriver, match="display driver, which was not found: libcuda.so is not there"):
        driver_of(DEVICE)
    bindings(monkeypatch, lambda flags: (SimpleNamespace(name="CUDA_ERROR_NO_DEVICE"),))
    with pytest.raises(NoDriver, match="could not be started: CUDA_ERROR_NO_DEVICE. Look at what nvidia-smi says"):
        driver_of(DEVICE)
