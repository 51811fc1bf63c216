"""Bodies that pass through each other, are sunk into others or lie close to them, from near and from afar."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import torch
from torch import Tensor

import torch_radbp as rb
from tests.scenes import diffuse, load, look_at, rgb, sensor
from tests.scenes.moving import TWIST, rigid
from torch_radbp.io.values.transform import rotate, scale, translate

SIZE, WIDTH = 32, 1.4  # pixels, and what they show of the middle of the scene, world
TOWARDS = (0.15, -0.5, 0.85)  # from there the camera, not of unit length
MIDDLE = (0.1, 0.05, 0.4)
GREY = {"bsdf": {"type": "twosided", "one": diffuse(0.5, 0.5, 0.5)}}
FLOOR = {"floor": {"type": "rectangle", "to_world": rotate((0, 0, 1), 10) @ scale((3, 3, 1)),
                   "bsdf": diffuse(0.6, 0.7, 0.8)}}
POINT = {"lamp": {"type": "point", "position": [1.5, -1.0, 3.0], "intensity": rgb(8, 8, 8)}}
SUN = {"lamp": {"type": "directional", "direction": [-0.4, 0.3, -1.0], "irradiance": rgb(2, 2, 2)}}
SKY = {"sky": {"type": "constant", "radiance": rgb(1, 0.8, 0.6)}}
CEILING = {"lamp": {"type": "rectangle", "emitter": {"type": "area", "radiance": rgb(9, 8, 7)},
                    "to_world": translate((0.6, -0.4, 2.5)) @ rotate((1, 0, 0), 180) @ scale((0.3, 0.3, 1))}}


def glowing(radiance: float) -> dict[str, Any]:
    return {"bsdf": diffuse(0, 0, 0), "emitter": {"type": "area", "radiance": rgb(radiance, radiance, radiance)}}


def plate_through_cube(plate: dict[str, Any] = GREY, cube: dict[str, Any] = GREY) -> dict[str, Any]:
    """A plate of which the most is outside of a cube; `plate`, `cube`: what they are made of."""
    return {"plate": plate | {"type": "rectangle", "to_world": translate((0.1, 0.05, 0.6)) @ rotate((1, 0.3, 0.2), 25)
                              @ scale((0.35, 0.2, 1))},
            "cube": cube | {"type": "cube", "to_world": translate((0.1, 0.1, 0.5)) @ rotate((1, 0.7, 0.4), 35)
                            @ scale((0.25, 0.2, 0.15))}}


BALL = {"ball": GREY | {"type": "sphere", "center": [0.1, 0.05, 0.15], "radius": 0.4}}
CUP = {"cup": GREY | {"type": "cylinder", "p0": [0.1, 0.05, -0.02], "p1": [0.15, 0.0, 0.6], "radius": 0.3}}


def card(gap: float) -> dict[str, Any]:
    """A card so much above the floor."""
    return {"card": GREY | {"type": "rectangle", "to_world": translate((0.1, 0.05, gap)) @ rotate((0, 0, 1), 20)
                            @ scale((0.5, 0.3, 1))}}


def camera(distance: float, size: int = SIZE) -> dict[str, Any]:
    """A camera so far away; from wherever, the scene is seen as large."""
    length = math.hypot(*TOWARDS)
    origin = [place + distance * part / length for place, part in zip(MIDDLE, TOWARDS)]
    fov = 2 * math.degrees(math.atan(WIDTH / 2 / distance))
    return sensor(size, fov=fov, to_world=look_at(origin, MIDDLE, (0, 0, 1)))


class Crossing(NamedTuple):
    """A scene in which a body moves rigidly."""

    objects: dict[str, Any]
    name: str  # of the body
    distance: float = 4.0  # of the camera
    depth: int = 2
    motion: tuple[tuple[float, ...], tuple[float, ...]] = TWIST

    def load(self, dtype: torch.dtype = torch.float64, size: int = SIZE) -> rb.Scene:
        return load(dtype, sensor=camera(self.distance, size), **self.objects)

    @property
    def parameter(self) -> str:
        return f"{self.name}.to_world"

    @property
    def direction(self) -> Callable[[Tensor], Tensor]:
        return rigid(self.motion, MIDDLE)


def near_and_far(name: str, *arguments: Any, **more: Any) -> dict[str, Crossing]:
    """A scene from a distance of four and of forty."""
    return {f"{name}, from {distance}": Crossing(*arguments, float(distance), **more) for distance in (4, 40)}


LIT = FLOOR | POINT
SEEN: dict[str, Any] = {"depth": 1, "motion": ((0.0, 0.0, 0.0), (-0.6, 0.8, 0.0))}
CROSSING = {
    **near_and_far("glowing plate through a cube", plate_through_cube(glowing(2.0), glowing(1.0)), "plate", **SEEN),
    **near_and_far("plate through a glowing cube", plate_through_cube(glowing(1.0), glowing(3.0)), "plate", **SEEN),
    **near_and_far("plate through a cube over a floor", plate_through_cube() | LIT, "plate"),
    **near_and_far("ball sunk in a floor", BALL | LIT, "ball"),
    **near_and_far("cup on a table", CUP | LIT, "cup"),
    "card above a table, from 4": Crossing(card(0.003) | LIT, "card", 4.0),
    "card above a table, from 40": Crossing(card(0.03) | LIT, "card", 40.0),
}
