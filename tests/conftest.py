"""What tests of every part use: fixtures, the options of this suite, and what is said at the end of a run."""

import gc
from importlib import import_module
from pathlib import Path

import pytest
import torch

from tests.slowest import Durations
from torch_radbp.jit.stages import CompiledStages

pytest_plugins = ["pytester"]

GPU = "gpu: needs a CUDA GPU"
LEFT_OUT = {  # by what the reason of a skipped test holds
    "'mitsuba'": "comparisons with Mitsuba skipped: install the extra `peer`, or run `make test-peer`",
    "'warp'": "tests of the ray caster of GPUs skipped: install the extra `cuda`",
    "no interpreter of PTX": "tests of what PTX computes skipped: RADBP_PTX_INTERPRETER names the folder of an interpreter",
    GPU: "tests on a GPU skipped, for there is none: run `make gpu-check` where there is",
}


@pytest.fixture
def mi():
    """Mitsuba in its variant `scalar_rgb`; without it the test is skipped."""
    mitsuba = pytest.importorskip("mitsuba")
    mitsuba.set_variant("scalar_rgb")
    return mitsuba


@pytest.fixture(params=[1, 2], ids=["1 thread", "2 threads"])
def threads(request):
    """torch's number of threads during the test, by which chunks are traced side by side; for `pytest.mark.usefixtures`."""
    before = torch.get_num_threads()
    torch.set_num_threads(request.param)
    yield request.param
    torch.set_num_threads(before)


@pytest.fixture(params=[False, True], ids=["eager", "compiled"])
def compiled(request) -> bool:
    """`compile` of the renderers of a test that holds for both."""
    return request.param


@pytest.fixture
def fresh_stages(monkeypatch):
    """The stages that compiled renderings run during the test; nothing is compiled before."""
    stages = CompiledStages()
    monkeypatch.setattr(import_module("torch_radbp.rendering.renderer"), "compiled", lambda: stages)
    return stages


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--deep", action="store_true", help="run the deep tests, and no others")
    parser.addoption("--keep-durations", type=Path, metavar="FILE", help="write the seconds of every test into a JSON file")


def pytest_configure(config: pytest.Config) -> None:
    file = config.getoption("--keep-durations")
    if file and not hasattr(config, "workerinput"):
        config.pluginmanager.register(Durations(file))


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leaves out what is deep, or what is not, and what needs a GPU where there is none."""
    deep = config.getoption("--deep")
    chosen = [item for item in items if (item.get_closest_marker("deep") is not None) == deep]
    config.hook.pytest_deselected(items=[item for item in items if (item.get_closest_marker("deep") is not None) != deep])
    items[:] = chosen
    if not torch.cuda.is_available():
        for item in items:
            if item.get_closest_marker("gpu"):
                item.add_marker(pytest.mark.skip(reason=GPU))


def pytest_collection_finish() -> None:
    """What has been imported stays: collections of garbage need not look at it."""
    gc.collect()
    gc.freeze()


@pytest.hookimpl(trylast=True)
def pytest_terminal_summary(terminalreporter, config: pytest.Config) -> None:
    """Says above pytest's closing line what was left out, and how to run it."""
    reasons = [str(report.longrepr) for report in terminalreporter.stats.get("skipped", [])]
    for what, words in LEFT_OUT.items():
        if count := sum(what in reason for reason in reasons):
            terminalreporter.write_line(f"{count} {words}")
    if not config.getoption("--deep"):
        terminalreporter.write_line("deep tests are left out: run `make test-deep`")
