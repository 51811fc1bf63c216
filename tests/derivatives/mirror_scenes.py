"""Scenes in which edges move that are seen by way of mirrors and glass.

Everything is turned by odd angles, and meets nothing else. Light comes from all around, so that no shadow has a border, but
where shadows are meant.
"""

from __future__ import annotations

from typing import Any

from tests.derivatives.moving_scenes import TWIST, MovingScene, constant, rigid, scene
from tests.derivatives.shadow_scenes import bend
from tests.scenes import diffuse, rgb, sensor
from torch_radbp.io.transform import rotate, scale, translate

SIZE = 16
FINE, MIDDLE = 0.005, 0.01
SKY = {"type": "constant", "radiance": rgb(0.9, 1.1, 1.4)}
EYE = (0.3, -3.0, 1.2)
VIEWED = sensor(SIZE, EYE, (0.05, 0.1, 0.1), 40, rfilter="box")
CUBE_POSE = translate((0.1, 0.1, 0.1)) @ rotate((1, 0.7, 0.4), 35) @ scale((0.4, 0.3, 0.35))
CUBE = {"type": "cube", "to_world": CUBE_POSE, "bsdf": diffuse(0.5, 0.3, 0.1)}
PANE = {"type": "rectangle", "to_world": translate((0.1, -1.5, 0.6)) @ rotate((1, 0.1, 0.05), 80) @ scale((2, 2, 1)),
        "bsdf": {"type": "thindielectric"}}
PUSH = {"cube": rigid(TWIST, (0.1, 0.1, 0.1)), "pane": rigid(TWIST, (0.1, -1.5, 0.6)), "camera": rigid(TWIST, EYE)}


def seen(**objects: Any):
    """A cube under a sky, and what it is seen by."""
    return scene(**{"sensor": VIEWED, "cube": CUBE, "sky": SKY} | objects)


def moved(build, name: str, direction, max_depth: int = 4, step: float = MIDDLE) -> MovingScene:
    """With the sampling that follows mirrors and glass, and glues points elsewhere."""
    return MovingScene(build, name, direction, step, max_depth, ("hybrid",))


MIRRORED = {
    "cube behind a pane": moved(seen(pane=PANE), "cube.to_world", PUSH["cube"]),
    "vertices behind a pane": moved(seen(pane=PANE), "cube.vertex_positions", bend(0.4)),
    "pane before a cube": moved(seen(pane=PANE), "pane.to_world", PUSH["pane"]),
    "camera before a pane": moved(seen(pane=PANE), "sensor.to_world", PUSH["camera"], step=FINE),
}
