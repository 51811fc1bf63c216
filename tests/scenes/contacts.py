"""Bodies that touch others, and their motions."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import torch
from torch import Tensor

import torch_radbp as rb
from tests.scenes import diffuse, load, look_at, rgb, sensor
from torch_radbp.io.values.transform import rotate, scale, translate

SUBJECT = "subject"
SIZE = 32
GREY, PALE, DARK = diffuse(0.5, 0.5, 0.5), diffuse(0.8, 0.7, 0.6), diffuse(0.2, 0.3, 0.25)

LAMPS: dict[str, dict[str, Any]] = {
    "point": {"type": "point", "position": [2, 3, 1], "intensity": rgb(20, 18, 16)},
    "point behind": {"type": "point", "position": [-1.2, 2.5, -2], "intensity": rgb(20, 18, 16)},
    "low point": {"type": "point", "position": [1.5, 0.6, 2.5], "intensity": rgb(12, 13, 14)},
    "directional": {"type": "directional", "direction": [-0.5, -1, -0.2], "irradiance": rgb(2, 2, 1.8)},
    "spot": {"type": "spot", "to_world": look_at((1.4, 3, 0.7), (0, 0, 0), (0, 1, 0)), "intensity": rgb(25, 22, 20),
             "cutoff_angle": 50, "beam_width": 40},
    "area": {"type": "rectangle", "to_world": look_at((2, 3, 1), (0, 0, 0), (0, 1, 0)) @ scale((0.4, 0.4, 1)),
             "bsdf": diffuse(0, 0, 0), "emitter": {"type": "area", "radiance": rgb(30, 28, 26)}},
    "sky": {"type": "constant", "radiance": rgb(1, 0.9, 0.8)}}


def floor(**attributes: Any) -> dict[str, Any]:
    """A rectangle of 8 x 8 at height 0."""
    return {"type": "rectangle", "to_world": rotate((1, 0, 0), -90) @ scale((4, 4, 1)), "bsdf": GREY} | attributes


def box(at: tuple, half: tuple | float = 0.4, turn: float = 0.0, **attributes: Any) -> dict[str, Any]:
    """A box around a point, turned about the vertical by some degrees."""
    half = half if isinstance(half, tuple) else (half,) * 3
    return {"type": "cube", "to_world": translate(at) @ rotate((0, 1, 0), turn) @ scale(half), "bsdf": PALE} | attributes


def mesh(points: list, faces: list, **attributes: Any) -> dict[str, Any]:
    return {"type": "mesh", "vertex_positions": torch.tensor(points, dtype=torch.float32),
            "faces": torch.tensor(faces), "bsdf": PALE} | attributes


def grid(count: int, corner: tuple, one: tuple, two: tuple, **attributes: Any) -> dict[str, Any]:
    """A parallelogram of count x count squares of two triangles."""
    share = torch.linspace(0, 1, count + 1, dtype=torch.float64)
    corner, one, two = (torch.tensor(part, dtype=torch.float64) for part in (corner, one, two))
    points = (corner + share[:, None, None] * one + share[None, :, None] * two).reshape(-1, 3)
    first = (torch.arange(count)[:, None] * (count + 1) + torch.arange(count)).flatten()
    faces = torch.cat([torch.stack([first, first + count + 1, first + count + 2], 1),
                       torch.stack([first, first + count + 2, first + 1], 1)])
    return {"type": "mesh", "vertex_positions": points.float(), "faces": faces, "bsdf": GREY} | attributes


def fine_box(low: tuple, high: tuple, count: int) -> dict[str, Any]:
    """A box whose sides are grids."""
    (x, y, z), (w, h, d) = low, tuple(b - a for a, b in zip(low, high))
    sides = [grid(count, *side) for side in (
        ((x, y, z), (w, 0, 0), (0, 0, d)), ((x, y + h, z), (0, 0, d), (w, 0, 0)), ((x, y, z), (0, h, 0), (w, 0, 0)),
        ((x, y, z + d), (w, 0, 0), (0, h, 0)), ((x, y, z), (0, 0, d), (0, h, 0)), ((x + w, y, z), (0, h, 0), (0, 0, d)))]
    starts = [0, *torch.tensor([len(side["vertex_positions"]) for side in sides]).cumsum(0).tolist()]
    return {"type": "mesh", "vertex_positions": torch.cat([side["vertex_positions"] for side in sides]), "bsdf": PALE,
            "faces": torch.cat([side["faces"] + start for side, start in zip(sides, starts)])}


WEDGE = mesh([[-0.5, 0, 0.1], [0.4, 0, 0], [-0.5, 0.5, 0.4], [0.4, 0.5, 0.3], [-0.5, 0.5, -0.3], [0.4, 0.5, -0.4]],
             [[0, 1, 3], [0, 3, 2], [0, 4, 5], [0, 5, 1], [2, 3, 5], [2, 5, 4], [0, 2, 4], [1, 5, 3]])
PYRAMID = mesh([[-0.6, 0, -0.5], [0.5, 0, -0.5], [0.5, 0, 0.5], [-0.6, 0, 0.5], [0, 0.6, 0]],
               [[0, 1, 2], [0, 2, 3], [0, 4, 1], [1, 4, 2], [2, 4, 3], [3, 4, 0]])
OBLIQUE = rotate((0.3, 1, -0.2), 33) @ translate((0.1, -0.2, 0.05))
BODIES: dict[str, dict[str, Any]] = {
    "cube on a floor": {"floor": floor(), SUBJECT: box((-0.23, 0.4, 0))},
    "cube turned on a floor": {"floor": floor(), SUBJECT: box((-0.1, 0.4, 0), turn=37)},
    "cube on a cube": {"floor": floor(), "base": box((0, 0.3, 0), (0.7, 0.3, 0.6), 10, bsdf=DARK),
                       SUBJECT: box((-0.1, 0.85, 0.05), 0.25, 25)},
    "cube against a wall": {"floor": floor(), "wall": {"type": "rectangle", "to_world": translate((0, 0, -0.5)) @ scale(
        (4, 4, 1)), "bsdf": DARK}, SUBJECT: box((-0.1, 0.6, -0.2), (0.4, 0.3, 0.3))},
    "wall on a floor": {"floor": floor(), SUBJECT: {
        "type": "rectangle", "to_world": translate((0, 0.4, 0)) @ rotate((0, 1, 0), 25) @ scale((0.5, 0.4, 1)),
        "bsdf": {"type": "twosided", "one": PALE}}},
    "wedge on its edge": {"floor": floor(), SUBJECT: WEDGE},
    "pyramid on a floor": {"floor": floor(), SUBJECT: PYRAMID},
    "mesh on a mesh": {"floor": grid(16, (-4, 0, -4), (0, 0, 8), (8, 0, 0)),
                       SUBJECT: fine_box((-0.5, 0, -0.5), (0.3, 0.7, 0.5), 4)},
    "mesh halfway through a floor": {"floor": floor(), SUBJECT: fine_box((-0.5, -0.35, -0.5), (0.3, 0.35, 0.5), 4)},
    "beam on two posts": {"floor": floor(), "left": box((-0.5, 0.25, 0), (0.2, 0.25, 0.2), bsdf=DARK),
                          "right": box((0.5, 0.25, 0.1), (0.2, 0.25, 0.2), bsdf=DARK),
                          SUBJECT: box((0, 0.6, 0.1), (0.9, 0.1, 0.15))},
    "cubes side by side": {"floor": floor(), "other": box((-0.4, 0.4, 0), bsdf=DARK), SUBJECT: box((0.4, 0.4, 0))},
    "cube under a floor that moves": {"cube": box((-0.23, 0.4, 0)), SUBJECT: floor()},
    "all oblique": {"floor": floor(to_world=OBLIQUE @ rotate((1, 0, 0), -90) @ scale((4, 4, 1))),
                    SUBJECT: box((0, 0, 0)) | {"to_world": OBLIQUE @ translate((-0.23, 0.4, 0)) @ scale((0.4,) * 3)}}}

Motion = Callable[[Tensor], Tensor]  # (V, 3) positions to (V, 3) velocities
UP = (0.0, 1.0, 0.0)


def along(*velocity: float) -> Motion:
    return lambda p: torch.tensor(velocity).expand_as(p).contiguous()


def turning(*spin: float) -> Motion:
    """Rotation about an axis through the origin."""
    return lambda p: torch.linalg.cross(torch.tensor(spin).expand_as(p), p)


MOTIONS: dict[str, Motion] = {"up": along(*UP), "aside": along(1.0, 0.0, 0.0), "to the camera": along(0.0, 0.0, 1.0),
                              "up and aside": along(-0.6, 0.8, 0.3), "turning": turning(*UP),
                              "tilting": turning(0.0, 0.0, 1.0)}


class Arrangement(NamedTuple):
    """What touches what, in which light, and how it moves."""

    body: str
    lamp: str
    motion: str

    def __str__(self) -> str:
        return f"{self.body}, {self.lamp}, {self.motion}"

    @property
    def max_depth(self) -> int:
        return 3 if self.lamp in ("area", "sky") else 2

    def tangent(self, value: Tensor) -> Tensor:
        """The velocity of the moved parameter, (V, 3) positions or a (4, 4) matrix."""
        motion = MOTIONS[self.motion]
        if value.shape != (4, 4):
            return motion(value)
        origin = motion(value[:3, 3][None])
        columns = [motion((value[:3, column] + value[:3, 3])[None]) - origin for column in range(3)]
        return torch.cat([torch.cat([*columns, origin]).T, torch.zeros(1, 4)])

    def build(self, size: int = SIZE) -> rb.Scene:
        return load(torch.float32, sensor=sensor(size, (0.1, 3, 3)), lamp=LAMPS[self.lamp], **BODIES[self.body])
