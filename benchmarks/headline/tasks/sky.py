"""Two balls under an unknown environment map, one of them of unknown colour, from two views; then under another sky."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import torch

import torch_radbp as rb
from benchmarks.headline.task import PRB, Task, parameters, rms
from benchmarks.headline.unknown.values import Values
from benchmarks.scenes import pictures
from benchmarks.scenes.description import Setting

SCENE = Path(__file__).parents[3] / "assets" / "lit_balls" / "scene.xml"
SKY, COLOUR = "sky.data", "plaster_ball.bsdf.reflectance.value"
SETTING = Setting(64, 16, 3)


def sky(folder: Path) -> Task:
    scene = rb.load(SCENE, resolution=32)
    truth = parameters(scene, [SKY, COLOUR])
    rows = truth[SKY].shape[0]
    solid_angle = np.sin(np.pi * (np.arange(rows) + 0.5) / rows)[:, None, None]
    scale = rms(truth[SKY], 0 * truth[SKY], solid_angle)
    relit = relighting(scene)
    expected = relit(truth[COLOUR])
    brightness = rms(expected, 0 * expected)

    def error(found: dict[str, np.ndarray]) -> float:
        return math.hypot(rms(found[SKY], truth[SKY], solid_angle) / scale, rms(relit(found[COLOUR]), expected) / brightness)

    unknowns = (Values(SKY, start=0.5, rate=0.05, padding=1), Values(COLOUR, start=0.3, rate=0.05, most=1.0))
    return Task("Object under an unknown sky, relit", SCENE, SCENE, unknowns, error,
                "relative RMS of the sky, and of images under another", views=2, setting=SETTING, steps=250, integrators=PRB)


def relighting(scene: rb.Scene):
    """From a colour to the images, (V, 3, H, W), of the balls with it under another sky, by the same samples."""
    scene.sky.data.data = pictures.sky(16, 32).movedim(0, -1).contiguous()
    colour, renderer = scene.get_parameter(COLOUR), rb.Renderer(scene, spp=16, max_depth=SETTING.max_depth)

    def relit(found: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            colour.copy_(torch.from_numpy(found))
            return renderer(seed=0).numpy()

    return relit
