"""The scene of the benchmarks: the Cornell box of ``assets/``, gradients of its three reflectances and its lamp."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import torch_radbp as rb

SCENE = Path(__file__).parents[1] / "assets" / "cornell_box" / "scene.xml"
PARAMETERS = ("white.reflectance.value", "green.reflectance.value", "red.reflectance.value", "light.emitter.radiance.value")
NO_ROULETTE = 10_000  # an rr_depth that no path reaches


def load(resolution: int, depth: int) -> rb.Scene:
    """The scene for this renderer, with the parameters of the benchmark requiring gradients."""
    scene = rb.load(SCENE, resolution=resolution, max_depth=depth, rr_depth=NO_ROULETTE)
    for name in PARAMETERS:
        scene.get_parameter(name).requires_grad_()
    return scene


def gradients(scene: rb.Scene) -> dict[str, list[float]]:
    return {name: scene.get_parameter(name).grad.tolist() for name in PARAMETERS}


def cotangent(resolution: int) -> np.ndarray:
    """(H, W, 3) derivative of the loss by the image: uneven, so that errors do not cancel, and the same for both peers."""
    y, x = np.mgrid[:resolution, :resolution] / resolution
    pattern = np.stack([1 + np.sin(9 * x + 4 * y), 1.5 + np.cos(7 * y), 0.5 + x * y + np.sin(5 * x)], axis=-1)
    return (pattern / resolution**2).astype(np.float32)
