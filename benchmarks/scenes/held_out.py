"""Scenes of ``assets/`` that nothing is tuned on: a metal plate between lamps, a carved plate under three lamps."""

from __future__ import annotations

from pathlib import Path

from benchmarks.scenes.description import BenchmarkScene, Setting

ASSETS = Path(__file__).parents[2] / "assets"
SETTING = Setting(256, 16, 4)


def metal_plate(setting: Setting = SETTING) -> BenchmarkScene:
    """Gradients of the roughness and of what shines on it."""
    return BenchmarkScene(ASSETS / "metal_plate" / "scene.xml", (
        "metal.alpha.value", "large_lamp.emitter.radiance.value", "sky.radiance.value"), setting)


def relief(setting: Setting = SETTING) -> BenchmarkScene:
    """Gradients of the normal map, of the colour below the gloss, and of a lamp."""
    return BenchmarkScene(ASSETS / "relief" / "scene.xml", (
        "carved.normalmap.data", "glossy.diffuse_reflectance.value", "warm_lamp.intensity.value"), setting)
