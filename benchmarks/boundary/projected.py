"""Gradients of a moving mesh with either renderer, in the directions in which it moves."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch

from benchmarks.boundary.scenes import VERTICES, MovingMesh
from benchmarks.peers import Mitsuba, Ours
from benchmarks.scenes.description import without_samplers

OURS, DEFAULT, MANY = "ours", "Mitsuba, defaults", "Mitsuba, guided, many"
TERMS = ("interior", "primary", "shadow")
GUIDED = {"type": "prb_projective"}
UNGUIDED = GUIDED | {"guiding": "none"}
SEEDS = 1 << 20  # the first seed of a run of its own: no two runs share samples


class Sampled(NamedTuple):
    """What came out of a pass."""

    seconds: float  # forward and backward
    gradient: np.ndarray  # (K,) along the directions


Pass = Callable[[int], Sampled]


def splits(spp: int) -> dict[str, dict]:
    """Mitsuba's integrator with three ways to split samples between interior, primary and shadow, for images of `spp`.

    What guiding costs pays only where many samples follow.
    """
    parts = {"Mitsuba, equal": (UNGUIDED, (1, 1, 1)), "Mitsuba, many on shadows": (UNGUIDED, (1, 1, 4)),
             MANY: (GUIDED, (16, 4, 32))}
    return {name: integrator | {part: spp * share for part, share in zip(("sppc", "sppp", "sppi"), shares)}
            for name, (integrator, shares) in parts.items()}


def ours(moving: MovingMesh, folder: Path) -> Pass:
    """This renderer with all terms, and with its own samplers."""
    return projected(Ours(without_samplers(moving.scene, folder), compiled=True, terms=TERMS), moving)


def mitsubas(peer: Mitsuba, moving: MovingMesh, integrator: dict) -> Pass:
    """Mitsuba with an integrator and the samples of `moving`; `peer`: has the scene, which all of its integrators share."""
    return projected(peer.using(integrator, moving.scene.setting.spp), moving)


def projected(peer: Ours | Mitsuba, moving: MovingMesh) -> Pass:
    def run(seed: int) -> Sampled:
        seconds = peer.run(seed).both
        gradient = peer.gradients_found()[VERTICES].reshape(-1, 3).astype(np.float64)
        return Sampled(seconds, np.einsum("kvc,vc->k", moving.directions, gradient))

    return run


def differences(moving: MovingMesh, folder: Path, spp: int) -> Callable[[int], np.ndarray]:
    """The same gradient, (K,), by central differences of images with the same samples, which seeds change."""
    peer = Ours(without_samplers(moving.scene, folder), compiled=True)
    vertices = peer.parameters[VERTICES]
    home = vertices.detach().clone()
    velocities = torch.from_numpy(moving.directions).to(home)

    def loss(seed: int) -> float:
        return float((peer.image(spp, seed).double() * peer.cotangent[0].double()).sum())

    def run(seed: int) -> np.ndarray:
        found = []
        for velocity in velocities:
            sides = []
            for side in (1, -1):
                vertices.data = home + side * moving.step * velocity
                sides.append(loss(seed))
            found.append((sides[0] - sides[1]) / (2 * moving.step))
        vertices.data = home
        return np.array(found)

    return run
