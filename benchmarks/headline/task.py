"""What a task is: a scene for both renderers, what is unknown in it, and how far off a guess is."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import torch_radbp as rb
from benchmarks.headline.unknown import Unknown
from benchmarks.peers import translated
from benchmarks.scenes.description import NO_ROULETTE, Setting, Source, with_sampler

SAMPLES_OF_A_PASS = 128

PRB = {"Mitsuba, prb": {"type": "prb"}}


class Task(NamedTuple):
    """Something to recover from images, by Adam with the squared error of the images as its loss."""

    title: str
    scene: Source
    """What a run begins with, but for the first guesses of the unknowns."""
    solution: Source
    """What the targets show."""
    unknowns: tuple[Unknown, ...]
    error: Callable[[dict[str, np.ndarray]], float]
    """From what was found, by the names of the unknowns."""
    measure: str
    """What the error is, for the table."""
    views: int
    setting: Setting
    steps: int
    integrators: dict[str, dict[str, Any]]
    """Mitsuba's, without depths, by what the table calls it."""

    def sampled(self, folder: Path, sampler: str | None) -> Task:
        """The same, begun with sensors that have a sampler of this type, or none of the scene's: each renderer's own."""
        return self._replace(scene=with_sampler(self.scene, folder, sampler))

    def load(self) -> rb.Scene:
        """The scene, for this renderer."""
        if isinstance(self.scene, Path):
            return rb.load(self.scene, resolution=self.setting.resolution)
        return rb.load_dict(self.scene)

    def load_in_mitsuba(self, mi, source: Source):
        """The scene or the solution, for Mitsuba."""
        if isinstance(source, Path):
            return mi.load_file(str(source), resolution=self.setting.resolution)
        return mi.load_dict(translated(mi, source))

    def targets(self, mi, samples: int) -> np.ndarray:
        """The images to compare with, (views, H, W, 3) linear RGB, by Mitsuba, with about so many samples a pixel."""
        scene = self.load_in_mitsuba(mi, self.solution)
        integrator = mi.load_dict({"type": "path", "max_depth": self.setting.max_depth, "rr_depth": NO_ROULETTE})
        passes = -(-samples // SAMPLES_OF_A_PASS)
        return np.stack([sum(np.array(mi.render(scene, sensor=view, integrator=integrator, spp=SAMPLES_OF_A_PASS,
                                                seed=10**6 + passes * view + number)) for number in range(passes)) / passes
                         for view in range(self.views)])

    def renderer(self, scene: rb.Scene) -> rb.Renderer:
        """A renderer with no other settings than those that both have; no roulette, which each plays by rules of its own."""
        _, spp, max_depth = self.setting
        return rb.Renderer(scene, spp=spp, max_depth=max_depth, rr_depth=NO_ROULETTE)


def parameters(scene: rb.Scene, names: Iterable[str]) -> dict[str, np.ndarray]:
    """The values of a scene's parameters."""
    return {name: scene.get_parameter(name).detach().numpy().copy() for name in names}


def rms(found: np.ndarray, truth: np.ndarray, weight: np.ndarray | float = 1.0) -> float:
    """The root of the mean squared difference; with weights that are broadcast against both."""
    weights = np.broadcast_to(weight, truth.shape).astype(np.float64)
    return float(np.sqrt((weights * (found - truth) ** 2).sum() / weights.sum()))
