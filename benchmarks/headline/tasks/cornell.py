"""The Cornell box: nine reflectances from one image, as in Mitsuba's first tutorial, which recovers those of one wall."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import torch_radbp as rb
from benchmarks.headline.task import PRB, Task, parameters, rms
from benchmarks.headline.unknown.values import Values
from benchmarks.scenes.cornell_box import SCENE
from benchmarks.scenes.description import Setting

NAMES = tuple(f"{wall}.reflectance.value" for wall in ("white", "green", "red"))


def cornell(folder: Path) -> Task:
    truth = parameters(rb.load(SCENE), NAMES)

    def error(found: dict[str, np.ndarray]) -> float:
        return rms(np.stack([found[name] for name in NAMES]), np.stack([truth[name] for name in NAMES]))

    unknowns = tuple(Values(name, start=0.5, rate=0.05, most=1.0) for name in NAMES)
    return Task("Cornell box: reflectances", SCENE, SCENE, unknowns, error, "RMS of 9 reflectances", views=1,
                setting=Setting(128, 4, 6), steps=80, integrators=PRB)
