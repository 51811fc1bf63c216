"""Scenes in which edges move that are seen by way of mirrors and glass.

Everything is turned by odd angles, and meets nothing else. Light comes from all around, so that no shadow has a border, but
where shadows are meant.
"""

from __future__ import annotations

from typing import Any

from tests.scenes import diffuse, sensor
from tests.scenes.inner_jumps import CHECKERBOARD
from tests.scenes.moving import TWIST, MovingScene, constant, rigid, scene
from tests.scenes.shadows import FLOOR, FLOOR_MIRROR, LAMPS, PLATE, bend
from torch_radbp.io.values.transform import rotate, scale, translate

SIZE = 16
FINE, MIDDLE = 0.005, 0.01
SKY = LAMPS["constant"]
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


MIRROR_AT, BALL_AT = (0.0, 2.2, 0.9), (0.1, 0.1, 0.6)
METAL = {"type": "conductor"}
GLASS = {"type": "dielectric", "int_ior": 1.5}
# A mirror in which the cube is seen, but the cube itself is not.
MIRROR = {"type": "rectangle", "to_world": translate(MIRROR_AT) @ rotate((1, 0.03, 0.02), 88) @ scale((3, 2.4, 1)),
          "bsdf": METAL}
MIRROR_EYE = (0.5, 0.9, 2.6)
IN_MIRROR = sensor(SIZE, MIRROR_EYE, (0.35, 2.2, 1.6), 40, rfilter="box")
BALL = {"type": "sphere", "to_world": translate(BALL_AT) @ scale((0.8, 0.8, 0.8)), "bsdf": METAL}
BESIDE_BALL = CUBE | {"to_world": translate((0.5, -1.6, 0.9)) @ rotate((1, 0.7, 0.4), 35) @ scale((0.3, 0.25, 0.2))}
BALL_EYE = (-0.5, -3.0, 1.2)
AT_BALL = sensor(SIZE, BALL_EYE, (0.1, 0.1, 0.7), 24, rfilter="box")
LENS_AT = (0.1, -1.6, 0.5)
LENS = {"type": "sphere", "to_world": translate(LENS_AT) @ scale((0.5, 0.5, 0.5)), "bsdf": GLASS}
BLOCK = {"type": "cube", "to_world": translate(LENS_AT) @ rotate((0.3, 0.1, 1), 25) @ scale((0.7, 0.2, 0.6)), "bsdf": GLASS}
GROUP = {"group": {"type": "shapegroup", "solid": CUBE | {"to_world": scale((0.4, 0.3, 0.35))}}, "shown": {
    "type": "instance", "group": {"type": "ref", "id": "group"},
    "to_world": translate((0.1, 0.1, 0.1)) @ rotate((1, 0.7, 0.4), 35)}}
PUSH |= {"mirror": rigid(TWIST, MIRROR_AT), "camera before a mirror": rigid(TWIST, MIRROR_EYE),
         "ball": rigid(TWIST, BALL_AT), "beside": rigid(TWIST, (0.5, -1.6, 0.9)), "lens": rigid(TWIST, LENS_AT),
         "camera before a ball": rigid(TWIST, BALL_EYE)}
in_mirror = seen(sensor=IN_MIRROR, mirror=MIRROR)
in_ball = seen(sensor=AT_BALL, cube=BESIDE_BALL, ball=BALL)
# A floor that is seen in a mirror alone: with the shadow of a plate that itself is not seen, or with squares.
FLOOR_EYE, FLOOR_MIRROR_AT = (0.3, 0.6, 2.2), (0.0, 2.2, 0.9)
AT_FLOOR = sensor(SIZE, FLOOR_EYE, (0.15, 2.2, 0.95), 24, rfilter="box")
shaded = scene(sensor=AT_FLOOR, mirror=FLOOR_MIRROR, floor=FLOOR, plate=PLATE, lamp=LAMPS["point"])
squares = scene(sensor=AT_FLOOR, mirror=FLOOR_MIRROR, sky=SKY, floor=FLOOR | {"bsdf": {
    "type": "diffuse", "reflectance": CHECKERBOARD}})
PUSH |= {"floor": rigid(TWIST, (0, 0, 0)), "plate": rigid(TWIST, (0.1, 0.05, 0.6)),
         "floor's mirror": rigid(TWIST, FLOOR_MIRROR_AT), "camera at a floor": rigid(TWIST, FLOOR_EYE)}

MIRRORED = {
    "cube behind a pane": moved(seen(pane=PANE), "cube.to_world", PUSH["cube"]),
    "vertices behind a pane": moved(seen(pane=PANE), "cube.vertex_positions", bend(0.4)),
    "camera before a pane": moved(seen(pane=PANE), "sensor.to_world", PUSH["camera"], step=FINE),
    "cube in a mirror": moved(in_mirror, "cube.to_world", PUSH["cube"]),
    "vertices in a mirror": moved(in_mirror, "cube.vertex_positions", bend(0.4)),
    "mirror before a cube": moved(in_mirror, "mirror.to_world", PUSH["mirror"], step=FINE),
    "camera before a mirror": moved(in_mirror, "sensor.to_world", PUSH["camera before a mirror"], step=FINE),
    "instance in a mirror": moved(scene(sensor=IN_MIRROR, mirror=MIRROR, sky=SKY, **GROUP), "shown.to_world", PUSH["cube"]),
    "cube in a ball": moved(in_ball, "cube.to_world", PUSH["beside"]),
    "ball before a cube": moved(in_ball, "ball.to_world", PUSH["ball"], step=FINE),
    "camera before a ball": moved(in_ball, "sensor.to_world", PUSH["camera before a ball"], step=FINE),
    "cube through a lens": moved(seen(lens=LENS), "cube.to_world", PUSH["cube"], 5, step=FINE),
    "lens before a cube": moved(seen(lens=LENS), "lens.to_world", PUSH["lens"], 5, step=FINE),
    "index of a lens": moved(seen(lens=LENS), "lens.bsdf.eta", constant(1.0), 5, step=FINE),
    "cube through a block": moved(seen(block=BLOCK), "cube.to_world", PUSH["cube"], 5),
    "block before a cube": moved(seen(block=BLOCK), "block.to_world", PUSH["lens"], 5, step=FINE),
    "camera before a block": moved(seen(block=BLOCK), "sensor.to_world", PUSH["camera"], 5, step=FINE),
    "plate, its shadow in a mirror": moved(shaded, "plate.to_world", PUSH["plate"], 3, FINE),
    "lamp, a shadow in a mirror": moved(shaded, "lamp.position", constant(0.4, 0.3, 0.5), 3, FINE),
    "floor, a shadow in a mirror": moved(shaded, "floor.to_world", PUSH["floor"], 3, FINE),
    "mirror before a shadow": moved(shaded, "mirror.to_world", PUSH["floor's mirror"], 3, FINE),
    "camera, a shadow in a mirror": moved(shaded, "sensor.to_world", PUSH["camera at a floor"], 3, FINE / 2),
    "squares in a mirror": moved(squares, "floor.to_world", PUSH["floor"], 3, FINE),
    "mirror before squares": moved(squares, "mirror.to_world", PUSH["floor's mirror"], 3, FINE / 2),
}
