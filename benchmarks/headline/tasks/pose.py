"""The pose of a block that is not in view, from the shadows that it casts."""

from __future__ import annotations

import math
from itertools import product
from pathlib import Path

import numpy as np
import torch

import torch_radbp as rb
from benchmarks.headline.task import Task
from benchmarks.headline.unknown.pose import Pose
from benchmarks.scenes.description import Setting
from torch_radbp.training.recovery.rigid import moved

SCENE = Path(__file__).parents[3] / "assets" / "shadow" / "scene.xml"
BLOCK = "block"
ROTATION = tuple(math.radians(angle) for angle in (6.0, -5.0, 18.0))
INTEGRATORS = {"Mitsuba, prb_projective": {"type": "prb_projective"},
               "the same, no guiding": {"type": "prb_projective", "guiding": "none"}}
TRANSLATION = (0.15, -0.12, 0.15)


def pose(folder: Path) -> Task:
    truth = getattr(rb.load(SCENE), BLOCK).to_world.detach()
    corners = torch.tensor([[*corner, 1.0] for corner in product((-1.0, 1.0), repeat=3)])
    places = corners @ truth.T

    def error(found: dict[str, np.ndarray]) -> float:
        rotation, translation = torch.from_numpy(found[BLOCK]).float()
        moved_places = corners @ moved(truth, rotation, translation).T
        return float((moved_places - places).square().sum(1).mean().sqrt())

    unknown = Pose(BLOCK, ROTATION, TRANSLATION, tuple(truth[:3, 3].tolist()), rate=0.025)
    return Task("Pose from shadows", SCENE, SCENE, (unknown,), error, "RMS distance of the corners of a block 0.7 long",
                views=1, setting=Setting(64, 16, 3), steps=150, integrators=INTEGRATORS)
