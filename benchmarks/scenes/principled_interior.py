"""The room of `textured_interior` with twenty principled materials: no two of them have the same parameters."""

from __future__ import annotations

import colorsys
from pathlib import Path

from benchmarks.scenes import pictures
from benchmarks.scenes.description import BenchmarkScene, Setting
from benchmarks.scenes.textured_interior import MATERIALS, TEXELS, room

SETTING = Setting(192, 8, 12)
BITMAP = object()  # a number that varies over the surface

# By number, what each has beside a bitmap for `base_color` and, every other one, a bitmap for `roughness`.
PARAMETERS = (
    {"clearcoat": 0.5, "clearcoat_gloss": 0.8},  # 0: the floor
    {},
    {"sheen": 0.4},
    {"flatness": 0.7},
    {"spec_tint": 0.5},  # 4: the last of the walls
    {"sheen": 0.8, "sheen_tint": 0.6},
    {"sheen": 0.5, "flatness": 0.4},
    {"sheen": 0.7, "sheen_tint": 0.9, "flatness": 0.5},
    {"clearcoat": 0.8},
    {"metallic": 1.0},
    {"clearcoat": 0.6, "clearcoat_gloss": 0.4, "spec_tint": 0.3},
    {"spec_tint": 0.8, "flatness": 0.5},
    {"metallic": BITMAP, "anisotropic": 0.6},
    {"metallic": BITMAP, "clearcoat": 0.7, "clearcoat_gloss": 0.9},
    {"spec_trans": 0.9},  # 14 and 15: balls of glass
    {"spec_trans": 0.8, "anisotropic": 0.5, "spec_tint": 0.4},
    {"metallic": BITMAP, "spec_tint": 0.6},
    {"metallic": 0.8, "anisotropic": 0.7, "clearcoat": 0.5, "clearcoat_gloss": 0.7},
    {"anisotropic": 0.5},
    {"metallic": BITMAP, "anisotropic": 0.3, "spec_tint": 0.4, "sheen": 0.5, "sheen_tint": 0.5, "clearcoat": 0.5,
     "clearcoat_gloss": 0.5, "flatness": 0.3},  # 19: all that is not glass
)
ALIKE = 13  # whose parameters the twenty alike have, each with bitmaps of its own


def material(folder: Path, number: int, parameters: dict[str, object]) -> dict:
    """A principled material with bitmaps of its own."""
    tiles = pictures.pattern(TEXELS, number)

    def bitmap(name: str, dark: tuple, light: tuple) -> dict:
        picture = pictures.written(folder, f"{name}_{number}", pictures.coloured(tiles, dark, light))
        return {"type": "bitmap", "filename": picture, "raw": name != "base_color"}

    light = colorsys.hsv_to_rgb(number * 0.382 % 1, 0.35, 0.85)
    given = {name: bitmap(name, (0.0,) * 3, (1.0,) * 3) if value is BITMAP else value for name, value in parameters.items()}
    rough = bitmap("roughness", (0.3,) * 3, (0.7,) * 3) if number % 2 else 0.5
    return {"type": "principled", "base_color": bitmap("base_color", tuple(0.3 * value for value in light), light),
            "roughness": rough, **given}


def scene(materials: list[dict], setting: Setting) -> BenchmarkScene:
    """The room with these materials; gradients of all their textures, bitmaps and numbers."""
    named = {f"material_{number}": each for number, each in enumerate(materials)}
    wanted = [f"{name}.{slot}.{'data' if isinstance(value, dict) else 'value'}" for name, bsdf in named.items()
              for slot, value in bsdf.items() if slot != "type"]
    return BenchmarkScene(room(named, setting.resolution), tuple(wanted), setting)


def principled_interior(folder: Path, setting: Setting) -> BenchmarkScene:
    """Twenty materials with twenty sets of parameters."""
    return scene([material(folder, number, parameters) for number, parameters in enumerate(PARAMETERS)], setting)


def alike_interior(folder: Path, setting: Setting) -> BenchmarkScene:
    """Twenty materials with one set of parameters, the bitmaps of each its own."""
    alike = [material(folder, number, PARAMETERS[ALIKE]) for number in range(1, 2 * MATERIALS, 2)]
    return scene(alike, setting)


def one_material_interior(folder: Path, setting: Setting, number: int) -> BenchmarkScene:
    """Everything of one of the twenty materials."""
    return scene([material(folder, number, PARAMETERS[number])], setting)
