"""Two balls under an unknown environment map, from two views."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import torch_radbp as rb
from benchmarks.headline.task import PRB, Task, parameters, rms
from benchmarks.headline.unknown.values import Values
from benchmarks.scenes.description import Setting

SCENE = Path(__file__).parents[3] / "assets" / "lit_balls" / "scene.xml"
SKY = "sky.data"


def sky(folder: Path) -> Task:
    truth = parameters(rb.load(SCENE), [SKY])[SKY]
    rows = truth.shape[0]
    solid_angle = np.sin(np.pi * (np.arange(rows) + 0.5) / rows)[:, None, None]
    scale = rms(truth, 0 * truth, solid_angle)

    def error(found: dict[str, np.ndarray]) -> float:
        return rms(found[SKY], truth, solid_angle) / scale

    return Task("Object under an unknown sky", SCENE, SCENE, (Values(SKY, start=0.5, rate=0.05, padding=1),), error,
                "RMS over the sphere, over that of the sky", views=2, setting=Setting(64, 16, 3), steps=250,
                integrators=PRB)
