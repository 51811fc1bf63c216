"""The scenes of `every_plugin.py` with little noise, for parameters that move nothing: estimates converge soon.

A material is lit by a point, by another one from behind if it transmits light, and where it has ideal lobes by an even sky.
The view is so narrow that all samples see about the same. Several sensors see the same, each by samples of its own, so that
one call renders independent batches.
"""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import torch

import torch_radbp as rb
from tests.scenes import load, rgb
from tests.scenes.every_plugin import SCENES, SUBJECT, build, subjects
from tests.scenes.everything import objects
from tests.scenes.moving import MovingScene
from tests.scenes.pairs import Pair, pairs_of
from tests.scenes.parts import camera
from torch_radbp.check.gradient import RELATIVE_STEP, checked_direction
from torch_radbp.scene.packing.pack import pack

MOVING = ("to_world", "to_uv", "vertex_positions", "vertex_normals", "vertex_texcoords", "position")
FRONT = {"type": "point", "position": [0.9, 1.1, 2.3], "intensity": rgb(9, 8, 7)}
BEHIND = {"type": "point", "position": [-0.5, 0.6, -2.4], "intensity": rgb(6, 7, 8)}
EVEN_SKY = {"type": "constant", "radiance": rgb(0.5, 0.4, 0.6)}
NARROW = 4.0  # degrees
LAST = ("squares", "checkerboard", "attributes", "trilinear", "mirror", "many")  # words in names of scenes with more noise
WIDE = ("spot",)  # scenes whose middle does not show everything, beside those where pixels are to be larger than texels
STEEPEST = 1.5  # the greatest entry of the direction in which a parameter moves
MAX_DEPTH = 2


class Example(NamedTuple):
    """A parameter of a scene of `SCENES`."""

    scene: str
    parameter: str

    def __str__(self) -> str:
        return f"{self.parameter} in {self.scene}"


# What the same parameters do in another way: the pyramid of an image.
MORE = (Example("trilinear", f"{SUBJECT}.diffuse_reflectance.data"),
        Example("trilinear on a mesh", f"{SUBJECT}.bsdf.reflectance.data"),
        Example("trilinear bumps", f"{SUBJECT}.nested_texture.data"))


def is_still(pair: Pair) -> bool:
    """True if a parameter is no pose and none of a shape or a sensor, so that nothing moves whatever the scene."""
    return pair.parameter not in MOVING and not pair.plugin.startswith(("sensor ", "shape "))


@functools.cache
def examples() -> dict[Pair, Example]:
    """For each pair what examines it: if possible in a scene of the plugin itself, and with little noise."""
    found: dict[Pair, tuple[tuple[bool, int, bool], Example]] = {}
    for scene_name in SCENES:
        scene = build(scene_name)
        for name in subjects(scene):
            for pair in pairs_of(scene, name):
                order = any(word in scene_name for word in LAST), name.count("."), "reflectance" not in name
                if pair not in found or order < found[pair][0]:
                    found[pair] = order, Example(scene_name, name)
    return {pair: example for pair, (_, example) in found.items()}


def quiet(name: str, sensors: int) -> rb.Scene:
    """A scene of `SCENES`, its noise taken away where it is one of a material, seen by some sensors."""
    parts: dict[str, Any] = {key: part for key, part in objects(name).items() if key != "sensor"}
    if f"{SUBJECT}_plane" in parts:
        parts = {key: part for key, part in parts.items() if key.startswith(SUBJECT)} | {"front": FRONT}
        kinds = [appearance.kind for appearance in pack(load(torch.float64, sensor=camera(), **parts)).layout.appearances]
        if any(kind.transmits for kind in kinds):
            parts["behind"] = BEHIND
        if any(kind.delta for kind in kinds):
            parts["sky"] = EVEN_SKY
    medium = {key: part for key, part in objects(name)["sensor"].items() if key == "medium"}
    view = medium | (camera(2) if name in WIDE or "trilinear" in name else camera(4, NARROW))
    return load(torch.float64, **{f"sensor_{number}": view for number in range(sensors)}, **parts)


def still_scene(example: Example, sensors: int) -> MovingScene:
    """A quiet scene in which a parameter moves in a direction in which nothing cancels."""
    largest = float(build(example.scene).get_parameter(example.parameter).detach().abs().max())
    if example.parameter.endswith("eta"):  # of an index counts what it is above 1
        largest /= 2
    return MovingScene(lambda: quiet(example.scene, sensors), example.parameter,
                       lambda value: checked_direction(example.parameter, value, "random"),
                       RELATIVE_STEP * (largest or 1.0) / STEEPEST, MAX_DEPTH, ("hybrid",))
