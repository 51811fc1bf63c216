"""The Cornell box of ``assets/``: gradients of its three reflectances and its lamp."""

from __future__ import annotations

from pathlib import Path

from benchmarks.scenes.description import BenchmarkScene, Setting

SCENE = Path(__file__).parents[2] / "assets" / "cornell_box" / "scene.xml"
PARAMETERS = ("white.reflectance.value", "green.reflectance.value", "red.reflectance.value", "light.emitter.radiance.value")
SETTING = Setting(256, 16, 8)


def cornell_box(setting: Setting = SETTING) -> BenchmarkScene:
    return BenchmarkScene(SCENE, PARAMETERS, setting)
