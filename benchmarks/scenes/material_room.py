"""A closed room with things of eight kinds of material."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.scenes.description import BenchmarkScene, Setting, camera, rgb, use
from torch_radbp.io.values.transform import rotate, scale, translate

SETTING = Setting(192, 8, 8)
PARAMETERS = ("wall.reflectance.value",)

WALL = {"type": "diffuse", "reflectance": rgb(0.7, 0.62, 0.5)}
KINDS = {
    "diffuse": {"type": "diffuse", "reflectance": rgb(0.25, 0.4, 0.65)},
    "conductor": {"type": "conductor", "material": "Al"},
    "ggx metal": {"type": "roughconductor", "distribution": "ggx", "material": "Au", "alpha": 0.25},
    "brushed metal": {"type": "roughconductor", "distribution": "beckmann", "material": "Cu",
                      "alpha_u": 0.1, "alpha_v": 0.4},
    "glass": {"type": "dielectric", "int_ior": 1.5},
    "ggx glass": {"type": "roughdielectric", "distribution": "ggx", "int_ior": 1.5, "alpha": 0.15},
    "beckmann glass": {"type": "roughdielectric", "distribution": "beckmann", "int_ior": 1.6, "alpha": 0.3},
    "two sides": {"type": "twosided", "first": {"type": "diffuse", "reflectance": rgb(0.7, 0.15, 0.1)},
                  "second": {"type": "roughconductor", "distribution": "beckmann", "material": "Ag", "alpha": 0.3}},
}
OPAQUE = {  # those that can be walls
    name: {**KINDS[name], **({} if name == "diffuse" else {"specular_reflectance": rgb(0.9, 0.9, 0.9)})}
    for name in ("diffuse", "conductor", "ggx metal", "brushed metal")
}


def room(wall: dict, things: list[dict], resolution: int) -> dict:
    """A closed room around the camera, with walls of one material, a lamp, and seven things of the materials given."""
    half = np.pi / 2
    upright = {"floor": ((1, 0, 0), -half, (0, -1, 0)), "ceiling": ((1, 0, 0), half, (0, 1, 0)),
               "left": ((0, 1, 0), half, (-1, 0, 0)), "right": ((0, 1, 0), -half, (1, 0, 0)),
               "back": ((0, 1, 0), 0.0, (0, 0, -1)), "front": ((0, 1, 0), 2 * half, (0, 0, 1))}
    size = scale((2.0, 1.3, 2.0))
    walls = {name: {"type": "rectangle", "to_world": size @ translate(place) @ rotate(axis, np.degrees(angle)),
                    "bsdf": use("wall")} for name, (axis, angle, place) in upright.items()}
    places = {
        "ball_0": ("sphere", translate((-1.25, -0.85, -1.0)) @ scale((0.45,) * 3)),
        "box_1": ("cube", translate((-0.4, -0.75, -1.3)) @ rotate((0, 1, 0), 25) @ scale((0.28, 0.55, 0.28))),
        "ball_2": ("sphere", translate((0.45, -0.85, -1.1)) @ scale((0.45,) * 3)),
        "ball_3": ("sphere", translate((1.35, -0.85, -1.0)) @ scale((0.45,) * 3)),
        "ball_4": ("sphere", translate((-0.75, -0.95, -0.1)) @ scale((0.35,) * 3)),
        "ball_5": ("sphere", translate((0.1, -0.95, 0.0)) @ scale((0.35,) * 3)),
        "ball_6": ("sphere", translate((0.95, -0.95, -0.1)) @ scale((0.35,) * 3)),
        "sheet_7": ("rectangle", translate((0.7, 0.35, -1.4)) @ rotate((0, 1, 0), -30) @ scale((0.5, 0.35, 1))),
        "sheet_8": ("rectangle", translate((-0.8, 0.35, -1.4)) @ rotate((0, 1, 0), 150) @ scale((0.5, 0.35, 1))),
    }
    placed = {name: {"type": kind, "to_world": pose, "bsdf": things[number % len(things)]}
              for number, (name, (kind, pose)) in enumerate(places.items())}
    lamp = {"type": "rectangle", "to_world": translate((0, 1.29, -0.3)) @ rotate((1, 0, 0), 90) @ scale((0.6, 0.6, 1)),
            "bsdf": use("wall"), "emitter": {"type": "area", "radiance": rgb(9.0, 8.0, 6.5)}}
    return {"type": "scene", "sensor": camera((0.0, -0.1, 1.9), (0.0, -0.35, -1.0), 68.0, resolution),
            "wall": wall, **walls, **placed, "lamp": lamp}


def material_room(folder: Path, setting: Setting) -> BenchmarkScene:
    """The room with things of all eight kinds, both sheets of the kind with two sides, one from each."""
    del folder  # no files
    things = list(KINDS.values())
    return BenchmarkScene(room(WALL, [*things, things[-1]], setting.resolution), PARAMETERS, setting)


def one_kind_room(kind: str, setting: Setting) -> BenchmarkScene:
    """The same room with everything of one kind of material, one of `OPAQUE`; gradients of one colour."""
    bsdf = OPAQUE[kind]
    slot = "reflectance" if "reflectance" in bsdf else "specular_reflectance"
    return BenchmarkScene(room(bsdf, [bsdf], setting.resolution), (f"wall.{slot}.value",), setting)
