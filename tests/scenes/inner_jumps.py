"""Scenes in which an image jumps inside of surfaces: along lines of textures, and where surfaces pass through each other.

Everything is turned by odd angles, and meets nothing else.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import accumulate
from typing import Any

import torch

from tests.scenes import diffuse, look_at, rgb, sensor
from tests.scenes.moving import TWIST, MovingScene, constant, rigid, scene, wave
from tests.scenes.shadows import ABOVE, FINE, FLOOR, FLOOR_MIRROR, LAMPS, SIZE, WALL
from torch_radbp.io.values.transform import rotate, scale, translate

VIEWED = sensor(SIZE, (0.3, -2.0, 2.6), (0.05, 0.1, 0.1), 40, rfilter="box")
SKY, POINT = LAMPS["constant"], LAMPS["point"]
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
    return FLOOR | {"bsdf": bsdf}


def patterned(texture: dict[str, Any]) -> dict[str, Any]:
    """A diffuse floor."""
    return {"floor": floor({"type": "diffuse", "reflectance": texture})}


LEAF = {"type": "mask", "opacity": {"type": "bitmap", "bitmap": (noise(4, 6, 1) > 0.5).float(), "filter_type": "nearest",
                                    "raw": True}, "nested_bsdf": {"type": "twosided", "one": diffuse(0.3, 0.7, 0.2)}}
CUT_OUT = {"type": "rectangle", "bsdf": LEAF,
           "to_world": translate((0, 0, 0.6)) @ rotate((1, 0.3, 0.2), 15) @ scale((4, 4, 1))}
GLOWING = {"type": "rectangle", "to_world": FLOOR["to_world"],
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



def joined(*parts: tuple[torch.Tensor, torch.Tensor]) -> dict[str, Any]:
    """One mesh of several, by their vertices and faces, each of a colour of its own."""
    firsts = [0, *accumulate(len(vertices) for vertices, _ in parts)]
    texel = [torch.tensor([(number + 0.5) / len(parts), 0.5]).expand(len(vertices), 2)
             for number, (vertices, _) in enumerate(parts)]
    return {"type": "mesh", "vertex_positions": torch.cat([vertices for vertices, _ in parts]),
            "faces": torch.cat([faces + first for first, (_, faces) in zip(firsts, parts)]),
            "vertex_texcoords": torch.cat(texel).double(), "bsdf": coloured(len(parts))}


def placed(vertices: torch.Tensor, *poses: Any) -> torch.Tensor:
    """Points (V, 3), each pose applied to what the next one gives."""
    for pose in reversed(poses):
        matrix = torch.as_tensor(pose).double()
        vertices = vertices @ matrix[:3, :3].T + matrix[:3, 3]
    return vertices


def ribbon(steps: int = 12) -> dict[str, Any]:
    """A sheet that is curled up so that it passes through itself once; from above a valley, with a tube below it."""
    t = torch.linspace(-1.55, 1.65, steps + 1, dtype=torch.float64)
    side = [torch.stack([1.2 * (t**3 - t), torch.full_like(t, y), 0.9 * (t * t - 1.0)], 1) for y in (-6.0, 6.0)]
    first = torch.arange(steps)
    faces = torch.cat([torch.stack([first, first + 1, first + steps + 2], 1),
                       torch.stack([first, first + steps + 2, first + steps + 1], 1)])
    half = torch.stack([0.25 + 0.5 * (t > 0), torch.full_like(t, 0.5)], 1)
    return {"type": "mesh", "faces": faces, "vertex_positions": placed(torch.cat(side), rotate((0.2, 0.1, 1), 25)),
            "vertex_texcoords": half.repeat(2, 1), "bsdf": coloured(2)}


def coloured(count: int) -> dict[str, Any]:
    """A material of so many colours, side by side."""
    return {"type": "twosided", "one": {"type": "diffuse", "reflectance": {
        "type": "bitmap", "bitmap": noise(1, count), "raw": True, "filter_type": "nearest"}}}


SQUARE = torch.tensor([[-6, -6, 0], [6, -6, 0], [6, 6, 0], [-6, 6, 0]]).double(), torch.tensor([[0, 1, 2], [0, 2, 3]])
CORNERS = torch.cartesian_prod(*[torch.tensor([-1.0, 1.0], dtype=torch.float64)] * 3)
CUBE = CORNERS, torch.tensor([[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6],
                              [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]])
SHEETS = joined((placed(SQUARE[0], rotate((0.2, 1, 0.1), 4)), SQUARE[1]),
                (placed(SQUARE[0], translate((0.13, 0.2, 0.07)), rotate((0.3, 1, 0.1), 37)), SQUARE[1]))
CUBES = joined(*((placed(CUBE[0], translate((0.1, 0.5, 0.4)), rotate(axis, 50), scale((0.4, 0.25, 0.3))), CUBE[1])
                 for axis in ((1, 0.7, 0.4), (0.3, -0.6, 1))))

# The planes of their sides do not meet the part of the wall that is in view: where one does, sides are seen askance, and
# the variance of the derivative there is infinite, be it only like a logarithm.
TO_THE_WALL = (-0.1, 1.1, 0.8)
CORNERS_FIRST = joined(*((placed(
    CUBE[0], translate((0.1, 0.5, 0.4)), rotate(TO_THE_WALL, spin), rotate((-1, -3, 4), 40.4), scale(size)), CUBE[1])
    for spin, size in ((10, (0.3, 0.25, 0.28)), (55, (0.26, 0.3, 0.24)))))


def second(motion: Callable[[torch.Tensor], torch.Tensor]) -> Callable[[torch.Tensor], torch.Tensor]:
    """Tangents of vertex positions (V, 3): the last half moves as such a pose does, the others stay."""
    def tangent(value: torch.Tensor) -> torch.Tensor:
        step = motion(torch.eye(4, dtype=value.dtype))
        moved = value @ step[:3, :3].T + step[:3, 3]
        return torch.where(torch.arange(len(value))[:, None] < len(value) // 2, 0.0, moved)

    return tangent


# A wall alone is in view, which sees what passes through something below it.
WALL_VIEWED = sensor(SIZE, (0.1, -1.0, 1.4), (0.0, 1.6, 1.2), 30, rfilter="box")
BELOW = {"sensor": WALL_VIEWED, "wall": WALL, "lamp": {
    "type": "spot", "to_world": look_at((0.3, 0.3, 2.4), (0.1, 0.5, 0), (0, 1, 0)), "cutoff_angle": 35,
    "intensity": rgb(60, 50, 55)}}
DIPPED = {"floor": floor(diffuse(0.1, 0.2, 0.3)), "ball": {
    "type": "sphere", "to_world": translate((0.1, 0.5, -0.3)) @ scale((0.5, 0.5, 0.5)), "bsdf": diffuse(0.9, 0.8, 0.7)}}
CEILING = {"type": "rectangle", "to_world": translate((0.3, 0.1, 2.05)) @ rotate((1, 0.3, 0.1), 8) @ scale((0.7, 0.7, 1)),
           "bsdf": {"type": "twosided", "one": diffuse(0.0)}}
# Of flat sides: light samples just behind a ceiling pass for free, so that of a small ball it hides measurably less.
SUNK_LAMP = {"floor": floor(diffuse(0.8, 0.4, 0.2)), "ceiling": CEILING, "lamp": LAMPS["ball"] | {
    "type": "cube", "to_world": translate(ABOVE) @ rotate((1, 0.7, 0.4), 15) @ scale((0.2, 0.15, 0.3))}}


def seen_by_a_wall(name: str, direction, step: float = FINE, **objects: Any) -> MovingScene:
    """A scene in which light comes to the view by way of the wall alone."""
    return MovingScene(scene(**BELOW, **objects), name, direction, step, 3, ("hybrid",))


IN_A_MIRROR = {"sensor": sensor(SIZE, (0.3, 0.6, 2.2), (0.2, 2.2, 1.33), 18, rfilter="box"),
               "mirror": FLOOR_MIRROR}

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
    "sheets of a mesh": MovingScene(scene(sensor=VIEWED, sheets=SHEETS, lamp=POINT), "sheets.vertex_positions",
                                    wave(size=0.3), FINE),
    "sheets of a mesh, camera": MovingScene(scene(sensor=VIEWED, sheets=SHEETS, lamp=POINT), "sensor.to_world",
                                            rigid(TWIST, (0.3, -2.0, 2.6)), FINE / 4),
    "ribbon through itself": MovingScene(scene(sensor=VIEWED, ribbon=ribbon(), lamp=POINT), "ribbon.vertex_positions",
                                         wave(size=0.3), FINE),
    "ball in a floor, floor, seen by a wall": seen_by_a_wall("floor.to_world", PUSH, **DIPPED),
    "ball in a floor, the wall that sees it": seen_by_a_wall("wall.to_world", rigid(TWIST, (0.5, 3.6, 1.2)), **DIPPED),
    "cubes of a mesh, seen by a wall": seen_by_a_wall("cubes.vertex_positions", second(rigid(TWIST, (1.1, 0.5, -0.4))),
                                                      6 * FINE, cubes=CORNERS_FIRST),
    "cubes of a mesh, in a mirror": MovingScene(
        scene(**IN_A_MIRROR, cubes=CUBES, lamp=POINT, floor=floor(diffuse(0.2))), "cubes.vertex_positions",
        second(rigid(TWIST, (0.1, 0.5, 0.4))), FINE, 3, ("hybrid",)),
    **{f"lamp in a ceiling, {name}": MovingScene(scene(sensor=VIEWED, **SUNK_LAMP), f"{name}.to_world",
                                                 rigid(TWIST, ABOVE), FINE, 2, ("hybrid",)) for name in ("lamp", "ceiling")},
    "lamp in a ceiling, by way of a wall": MovingScene(scene(sensor=VIEWED, wall=WALL, **SUNK_LAMP), "ceiling.to_world",
                                                       rigid(TWIST, ABOVE), FINE, 3, ("hybrid",)),
}
