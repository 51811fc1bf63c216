"""A furnished room: twenty materials with bitmaps of their own, a window and a lamp."""

from __future__ import annotations

import colorsys
from pathlib import Path

import numpy as np

from benchmarks.scenes import pictures
from benchmarks.scenes.description import BenchmarkScene, Setting, camera, rgb, use
from torch_radbp.io.values.transform import rotate, scale, translate

SETTING = Setting(192, 8, 12)
MATERIALS, METALS = 20, 6  # the last six are metals
TEXELS = 128  # a side

Triple = tuple[float, float, float]


def material(folder: Path, number: int) -> dict:
    """The material with this number: diffuse, or a metal with bitmaps for colour and, every other one, for roughness."""
    light = colorsys.hsv_to_rgb(number * 0.382 % 1, 0.35, 0.85)
    tiles = pictures.pattern(TEXELS, number)
    picture = pictures.coloured(tiles, tuple(0.3 * value for value in light), light)
    colour = {"type": "bitmap", "filename": pictures.written(folder, f"colour_{number}", picture)}
    if number < MATERIALS - METALS:
        return {"type": "diffuse", "reflectance": colour}
    alpha = 0.25
    if number % 2:
        rough = pictures.coloured(tiles, (0.15,) * 3, (0.45,) * 3)
        alpha = {"type": "bitmap", "filename": pictures.written(folder, f"rough_{number}", rough), "raw": True}
    return {"type": "roughconductor", "distribution": "ggx" if number % 3 else "beckmann", "material": "Al",
            "alpha": alpha, "specular_reflectance": colour}


def textured_interior(folder: Path, setting: Setting) -> BenchmarkScene:
    """The room with twenty materials; gradients of all bitmaps."""
    materials = {f"material_{number}": material(folder, number) for number in range(MATERIALS)}
    return BenchmarkScene(room(materials, setting.resolution), tuple(parameters(materials)), setting)


def room(materials: dict[str, dict], resolution: int) -> dict:
    """A room of 5 x 2.8 x 5, the floor at y = 0, with a window, a lamp and furniture.

    Args:
        materials: by name; `MATERIALS` of them, or fewer that are used in turn.
    """
    names = list(materials)

    def of(number: int) -> dict:
        return use(names[number % len(names)])

    def box(centre: Triple, size: Triple, number: int, turn: float = 0.0) -> dict:
        pose = translate(centre) @ rotate((0, 1, 0), turn) @ scale([length / 2 for length in size])
        return {"type": "cube", "to_world": pose, "bsdf": of(number)}

    def ball(centre: Triple, radius: float, number: int) -> dict:
        return {"type": "sphere", "to_world": translate(centre) @ scale((radius,) * 3), "bsdf": of(number)}

    def wall(centre: Triple, size: tuple[float, float], turn: np.ndarray, number: int) -> dict:
        pose = translate(centre) @ turn @ scale((size[0] / 2, size[1] / 2, 1))
        return {"type": "rectangle", "to_world": pose, "bsdf": of(number)}

    y, x = (0, 1, 0), (1, 0, 0)
    walls = {
        "floor": wall((0, 0, 0), (5, 5), rotate(x, -90), 0), "ceiling": wall((0, 2.8, 0), (5, 5), rotate(x, 90), 1),
        "left": wall((-2.5, 1.4, 0), (5, 2.8), rotate(y, 90), 2), "right": wall((2.5, 1.4, 0), (5, 2.8), rotate(y, -90), 3),
        "back": wall((0, 1.4, -2.5), (5, 2.8), rotate(y, 0), 4), "front": wall((0, 1.4, 2.5), (5, 2.8), rotate(y, 180), 4),
    }
    furniture = {
        "carpet": box((0, 0.01, -0.6), (2.6, 0.02, 2.2), 5), "sofa": box((-1.7, 0.25, -0.9), (0.9, 0.5, 2.0), 6),
        "sofa_back": box((-2.2, 0.55, -0.9), (0.3, 1.1, 2.0), 6), "cushion": box((-1.75, 0.6, -1.5), (0.5, 0.2, 0.5), 7, 20),
        "table": box((0, 0.45, -0.8), (1.3, 0.06, 0.8), 8), "leg_0": box((-0.55, 0.22, -1.1), (0.08, 0.42, 0.08), 9),
        "leg_1": box((0.55, 0.22, -1.1), (0.08, 0.42, 0.08), 9), "leg_2": box((-0.55, 0.22, -0.5), (0.08, 0.42, 0.08), 9),
        "leg_3": box((0.55, 0.22, -0.5), (0.08, 0.42, 0.08), 9), "shelf": box((0.2, 0.9, -2.3), (1.4, 1.8, 0.35), 10),
        "books": box((0.2, 1.95, -2.3), (0.9, 0.28, 0.22), 11, 4), "chest": box((1.9, 0.4, -1.6), (0.9, 0.8, 0.9), 12),
        "stool": box((1.0, 0.2, 0.4), (0.45, 0.4, 0.45), 13, 30), "bowl": ball((0.25, 0.62, -0.8), 0.14, 14),
        "globe": ball((1.9, 1.08, -1.6), 0.28, 15), "vase": ball((-0.3, 0.66, -0.9), 0.18, 16),
        "frame": box((-1.3, 1.6, -2.47), (1.0, 0.8, 0.05), 17), "column": box((1.15, 1.0, -2.2), (0.22, 2.0, 0.22), 18, 45),
        "shade": box((0, 2.55, -0.6), (0.7, 0.04, 0.7), 19),
    }
    lights = {
        "window": {"type": "rectangle", "to_world": translate((2.49, 1.6, 0)) @ rotate(y, -90) @ scale((0.9, 0.7, 1)),
                   "bsdf": of(3), "emitter": {"type": "area", "radiance": rgb(9.0, 10.0, 12.0)}},
        "lamp": {"type": "rectangle", "to_world": translate((0, 2.52, -0.6)) @ rotate(x, 90) @ scale((0.25, 0.25, 1)),
                 "bsdf": of(19), "emitter": {"type": "area", "radiance": rgb(16.0, 12.0, 7.0)}},
    }
    return {"type": "scene", "sensor": camera((0.4, 1.5, 2.35), (-0.05, 0.85, -1.5), 66.0, resolution),
            **materials, **walls, **furniture, **lights}


def parameters(materials: dict[str, dict]) -> list[str]:
    """The names of the bitmaps' texels."""
    return [f"{name}.{slot}.data" for name, bsdf in materials.items()
            for slot, texture in bsdf.items() if isinstance(texture, dict)]
