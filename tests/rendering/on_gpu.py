"""Rendering by the kernels of a GPU that is one in name."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec

import pytest

from tests.rendering.taped import singly
from torch_radbp.jit.nvidia.gpu import Gpu
from torch_radbp.jit.run import LaneFunction
from torch_radbp.jit.stages import CompiledStages
from torch_radbp.raycast import expanded


def render_on(device: Gpu, monkeypatch: pytest.MonkeyPatch, taped: bool = False) -> None:
    """Compiled renderings run on `device` during the test; it begins with nothing compiled but what is kept on disk.

    Args:
        taped: bounces are recorded, and run in sequences of launches.
    """
    if not taped:
        singly(monkeypatch)
    fused = CompiledStages()
    monkeypatch.setattr(import_module("torch_radbp.rendering.renderer"), "compiled", lambda: fused)
    for module in ("order", "scatter", "tape", "run", "stages"):
        monkeypatch.setattr(import_module(f"torch_radbp.jit.{module}"), "target_of", lambda of: device)
    if find_spec("warp"):
        cast_on(getattr(device.launcher, "driver", device.launcher), monkeypatch)
    monkeypatch.setattr(expanded, "AS_SHOWN", LaneFunction(expanded.as_shown, ("triangle", "instance"), device))


def cast_on(stand_in, monkeypatch: pytest.MonkeyPatch) -> None:
    """Warp starts its kernels on a stand-in for a driver, which may capture them."""
    warp = import_module("torch_radbp.raycast.warp").Warp
    start = warp._start
    monkeypatch.setattr(warp, "_start", lambda *given: stand_in.started(lambda: start(*given)))
