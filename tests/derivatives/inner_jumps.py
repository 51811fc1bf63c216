"""Scenes in which an image jumps inside of surfaces: along lines of textures, and where surfaces pass through each other.

Everything is turned by odd angles, and meets nothing else.
"""

from __future__ import annotations

from typing import Any

import torch

from tests.derivatives.moving_scenes import TWIST, MovingScene, constant, rigid, scene, wave
from tests.derivatives.shadow_scenes import ABOVE, FINE, SIZE
from tests.scenes import diffuse, rgb, sensor
from torch_radbp.io.transform import rotate, scale, translate

VIEWED = sensor(SIZE, (0.3, -2.0, 2.6), (0.05, 0.1, 0.1), 40, rfilter="box")
SKY = {"type": "constant", "radiance": rgb(0.9, 1.1, 1.4)}
POINT = {"type": "point", "position": list(ABOVE), "intensity": rgb(8, 7, 9)}
PUSH = rigid(TWIST, (0.1, 0.05, 0.1))


def noise(height: int, width: int, channels: int = 3) -> torch.Tensor:
    """(H, W, C) independent numbers in [0, 1)."""
    return torch.rand(height, width, channels, generator=torch.Generator().manual_seed(height * width))


CHECKERBOARD = {"type": "checkerboard", "color0": rgb(0.2, 0.4, 0.9), "color1": rgb(0.8, 0.3, 0.1),
                "to_uv": rotate((0, 0, 1), 20) @ scale((6.3, 5.7, 1))}


def nearest(wrap_mode: str) -> dict[str, Any]:
    """A bitmap of 5 x 7 texels, each of one colour."""
    return {"type": "bitmap", "bitmap": noise(5, 7), "filter_type": "nearest", "raw": True, "wrap_mode": wrap_mode,
            "to_uv": translate((-0.8, -1.1, 0)) @ rotate((0, 0, 1), 20) @ scale((2.3, 2.7, 1))}


def floor(bsdf: dict[str, Any]) -> dict[str, Any]:
    """A rectangle that goes on beyond the view."""
    return {"type": "rectangle", "to_world": rotate((0.2, 1, 0.1), 4) @ scale((6, 6, 1)), "bsdf": bsdf}


def patterned(texture: dict[str, Any]) -> dict[str, Any]:
    """A diffuse floor."""
    return {"floor": floor({"type": "diffuse", "reflectance": texture})}


LEAF = {"type": "mask", "opacity": {"type": "bitmap", "bitmap": (noise(4, 6, 1) > 0.5).float(), "filter_type": "nearest",
                                    "raw": True}, "nested_bsdf": {"type": "twosided", "one": diffuse(0.3, 0.7, 0.2)}}
CUT_OUT = {"type": "rectangle", "bsdf": LEAF,
           "to_world": translate((0, 0, 0.6)) @ rotate((1, 0.3, 0.2), 15) @ scale((4, 4, 1))}
GLOWING = {"type": "rectangle", "to_world": rotate((0.2, 1, 0.1), 4) @ scale((6, 6, 1)),
           "emitter": {"type": "area", "radiance": CHECKERBOARD}}

SHEET = {"type": "mesh", "faces": torch.tensor([[0, 1, 2], [0, 2, 3]]), "vertex_texcoords": torch.tensor(
    [[0, 0], [1, 0], [1, 1], [0, 1]]).double(), "vertex_positions": torch.tensor(
        [[-6, -6, 0.1], [6, -6, -0.2], [6, 6, 0.2], [-6, 6, 0.0]]).double()}

SUNK = {"floor": floor(diffuse(0.8, 0.4, 0.2)), "ball": {
    "type": "sphere", "to_world": translate((0.1, 0.1, 0.15)) @ scale((0.5, 0.5, 0.5)), "bsdf": diffuse(0.3, 0.6, 0.9)}}
CROSSING = {"one": floor({"type": "twosided", "one": diffuse(0.8, 0.4, 0.2)}), "other": {
    "type": "rectangle", "to_world": rotate((0.3, 1, 0.1), 37) @ scale((6, 6, 1)),
    "bsdf": {"type": "twosided", "one": diffuse(0.2, 0.5, 0.9)}}}
SHOWN = {"group": {"type": "shapegroup", "solid": {"type": "cube", "bsdf": diffuse(0.3, 0.6, 0.9)}}, "shown": {
    "type": "instance", "group": {"type": "ref", "id": "group"},
    "to_world": translate((0.1, 0.1, 0.1)) @ rotate((1, 0.7, 0.4), 35) @ scale((0.4, 0.3, 0.35))}}

INNER_JUMPS = {
    "checkerboard": MovingScene(scene(sensor=VIEWED, **patterned(CHECKERBOARD), sky=SKY), "floor.to_world", PUSH, FINE),
    "checkerboard, camera": MovingScene(scene(sensor=VIEWED, **patterned(CHECKERBOARD), lamp=POINT), "sensor.to_world",
                                        rigid(TWIST, (0.3, -2.0, 2.6)), FINE / 4),
    "checkerboard, field of view": MovingScene(scene(sensor=VIEWED, **patterned(CHECKERBOARD), lamp=POINT), "sensor.x_fov",
                                               constant(1), 0.05),
    **{f"texels, {mode}": MovingScene(scene(sensor=VIEWED, **patterned(nearest(mode)), lamp=POINT), "floor.to_world", PUSH,
                                      FINE / 2) for mode in ("repeat", "mirror", "clamp")},
    "roughness in squares": MovingScene(
        scene(sensor=VIEWED, sky=SKY, lamp=POINT, floor=floor({
            "type": "roughconductor", "alpha": {"type": "checkerboard", "color0": 0.3, "color1": 0.7,
                                                "to_uv": scale((6.3, 5.7, 1))}})), "floor.to_world", PUSH, FINE),
    "cut out": MovingScene(scene(sensor=VIEWED, leaf=CUT_OUT, sky=SKY), "leaf.to_world", PUSH, FINE),
    **{f"{name} slide": MovingScene(scene(sensor=VIEWED, floor=SHEET | {"bsdf": bsdf}, light=light),
                                    "floor.vertex_texcoords", wave(size=0.3), FINE / 4) for name, bsdf, light in (
        ("squares", {"type": "diffuse", "reflectance": CHECKERBOARD}, SKY), ("holes", LEAF, SKY),
        ("texels", {"type": "diffuse", "reflectance": nearest("mirror")}, POINT))},
    "a lamp in squares": MovingScene(scene(sensor=VIEWED, floor=GLOWING), "floor.to_world", PUSH, FINE),
    "ball in a floor": MovingScene(scene(sensor=VIEWED, **SUNK, sky=SKY), "ball.to_world", PUSH, FINE, 2, ("hybrid",)),
    "ball in a floor, floor": MovingScene(scene(sensor=VIEWED, **SUNK, lamp=POINT), "floor.to_world", PUSH, FINE),
    "ball in a floor, camera": MovingScene(scene(sensor=VIEWED, **SUNK, lamp=POINT), "sensor.to_world",
                                           rigid(TWIST, (0.3, -2.0, 2.6)), FINE / 4),
    "walls that cross": MovingScene(scene(sensor=VIEWED, **CROSSING, lamp=POINT), "one.to_world", PUSH, FINE),
    "instance in a floor": MovingScene(scene(sensor=VIEWED, floor=floor(diffuse(0.8, 0.4, 0.2)), **SHOWN, lamp=POINT),
                                       "shown.to_world", PUSH, FINE),
}
