"""Scenes that together have every plugin, so that one rendering differentiates all parameters at once."""

from __future__ import annotations

from typing import Any

import torch

import torch_radbp as rb
from tests.scenes import diffuse, load, rgb
from tests.scenes.every_plugin import GROUP, SCENES, SUBJECT
from tests.scenes.parts import (
    FIELD_OF_VIEW,
    FISHEYE,
    THIN_PRISM,
    beam,
    bitmap,
    blurred,
    calibrated,
    camera,
    floor,
    lamp,
    lamps,
    parallel,
    sky,
    turned,
)
from torch_radbp.io.values.transform import translate

MATERIALS = ("diffuse", "conductor", "pane", "rough metal beckmann", "brushed metal ggx", "dielectric", "rough glass ggx",
             "brushed glass beckmann", "plastic", "rough plastic ggx", "principled", "principled glass", "principled sheet",
             "blend", "mask", "normal map", "bump map")
SHAPES = ("rectangle", "disk", "sphere", "cylinder", "cube", "mesh", "obj", "ply", "serialized", "distances")
LIGHTS = ("directional", "point", "projector", "spot")
TEXTURES = ("spectra", "metal by spectra", "named constants", "raw constant", "checkerboard", "rough checkerboard",
            "trilinear", "trilinear bumps", "volume of roughness")


def objects(name: str) -> dict[str, Any]:
    scene = SCENES[name]
    return scene() if callable(scene) else scene


def place(number: int) -> tuple[float, float, float]:
    """On a grid of 3 columns in front of the camera."""
    return 0.9 * (number % 3 - 1), 0.8 * (number // 3 - 1), -0.23 * number


def place_of_box(number: int) -> tuple[float, float, float]:
    """On a grid of 4 columns in front of the camera."""
    return 0.7 * (number % 4 - 1.5), 0.6 * (number // 4 - 1.5), -0.1 * number


def materials() -> dict[str, Any]:
    """Cubes of every material, under a sky and a lamp with an image."""
    found = {}
    for number, name in enumerate(MATERIALS):
        material = f"{SUBJECT}_{name.replace(' ', '_')}"
        found[material] = objects(name)[SUBJECT]
        found[f"box_{number}"] = turned(place_of_box(number), 20 + 7 * number, 30 - 5 * number, 10, size=0.4, type="cube",
                                        bsdf={"type": "ref", "id": material})
    both = {"type": "ref", "id": f"{SUBJECT}_twosided"}
    return {f"{SUBJECT}_sensor": camera(16, 40), f"{SUBJECT}_sky": sky(), "floor": floor(), **found,
            f"{SUBJECT}_lamp": lamp(emitter={"type": "area", "radiance": bitmap(factor=9.0)}),
            f"{SUBJECT}_twosided": objects("twosided")[SUBJECT],
            "sheet": turned((0.45, 0.4, 0.2), 20, 30, 10, size=0.2, type="rectangle", bsdf=both),
            "reversed": turned((-0.45, 0.4, 0.2), 15, 200, 10, size=0.2, type="rectangle", bsdf=both)}


def shapes() -> dict[str, Any]:
    """Every shape, under all other lights."""
    found = {}
    for number, name in enumerate(SHAPES):
        size = 0.2 if name in ("mesh", "obj", "ply", "serialized") else 0.42
        found[f"{SUBJECT}_{name}"] = objects(name)[SUBJECT] | turned(
            place(number), 20 + 7 * number, 30 - 5 * number, 10, size=size)
    found[SUBJECT] = objects("instances")[SUBJECT]
    found[f"{SUBJECT}_instance"] = turned((0.6, -0.6, 0.3), 14, -23, 31, size=0.15, type="instance", group=GROUP)
    return {f"{SUBJECT}_sensor": camera(16, 50), f"{SUBJECT}_parallel": parallel(1.2, 16),
            f"{SUBJECT}_blurred": blurred(16, 50), f"{SUBJECT}_calibrated": calibrated(16, 0.7),
            f"{SUBJECT}_fisheye": calibrated(16, 0.7, **FISHEYE), f"{SUBJECT}_prism": calibrated(16, 0.7, **THIN_PRISM),
            f"{SUBJECT}_arc": calibrated(16, 0.7, **FIELD_OF_VIEW), "floor": floor(), **found,
            f"{SUBJECT}_beam": beam(bsdf=diffuse(0.3, 0.2, 0.4)),
            **{f"{SUBJECT}_{name}": objects(name)[SUBJECT] for name in LIGHTS},
            f"{SUBJECT}_surround": {"type": "constant", "radiance": rgb(0.3, 0.2, 0.4)}}


def textures() -> dict[str, Any]:
    """Cubes with every spectrum and every pattern, and a mesh with attributes, in the light of a glowing body."""
    found = {}
    for number, name in enumerate(TEXTURES):
        material = f"{SUBJECT}_{name.replace(' ', '_')}"
        found[material] = objects(name)[SUBJECT]
        found[f"box_{number}"] = turned(place(number), 20 + 7 * number, 30 - 5 * number, 10, size=0.4, type="cube",
                                        bsdf={"type": "ref", "id": material})
    found[f"{SUBJECT}_mesh"] = objects("attributes")[SUBJECT] | turned(place(len(TEXTURES)), 15, -20, 10, size=0.25)
    return {f"{SUBJECT}_sensor": camera(16, 50), "floor": floor(), **found, f"{SUBJECT}_sky": sky(0.3),
            f"{SUBJECT}_glow": objects("glowing body")[SUBJECT]}


def many_lamps() -> dict[str, Any]:
    """More lamps than are picked without regard to where they are, and daylight."""
    found = {f"{SUBJECT}_{name}": lamp for name, lamp in lamps().items()}
    return {f"{SUBJECT}_sensor": camera(16, 50), "floor": floor(), "dark": diffuse(0.1, 0.2, 0.1), **found,
            f"{SUBJECT}_plane": objects("rectangle")[SUBJECT], f"{SUBJECT}_beam": beam(bsdf={"type": "ref", "id": "dark"}),
            f"{SUBJECT}_sunsky": objects("sunsky")[SUBJECT]}


def fog() -> dict[str, Any]:
    """A medium around a camera, between a floor and a lamp, with every phase function."""
    first, second, third = (objects(f"fog {name}")[SUBJECT]["phase"] for name in ("by a table", "of flakes", "of two kinds"))
    both = {"type": "blendphase", "weight": 0.4, "phase_0": third | {"phase_1": first}, "phase_1": second}
    return {f"{SUBJECT}_sensor": camera(16, 50, medium={"type": "ref", "id": f"{SUBJECT}_fog"}), "floor": floor(),
            f"{SUBJECT}_fog": objects("homogeneous")[SUBJECT] | {"phase": both}, "lamp": lamp()}


def smoke() -> dict[str, Any]:
    """A medium that varies, and one in glass, in which there is a stone."""
    glass = {"type": "dielectric", "int_ior": 1.3}
    inside, around = ({"type": "ref", "id": f"{SUBJECT}_{name}"} for name in ("glow", "smoke"))
    return {f"{SUBJECT}_sensor": camera(16, 50), "floor": floor(), "lamp": lamp(), "sky": sky(0.3),
            f"{SUBJECT}_glow": objects("glowing fog")[SUBJECT], f"{SUBJECT}_smoke": objects("flame")[SUBJECT],
            "box": objects("heterogeneous")["box"] | {"interior": around},
            "ball": {"type": "sphere", "center": [0.2, 0.1, 0.9], "radius": 0.4, "bsdf": glass,
                     "interior": inside, "exterior": around},
            "stone": {"type": "sphere", "center": [0.2, 0.1, 0.9], "radius": 0.15},
            "pane": {"type": "rectangle", "to_world": translate((0, 0, 2)), "bsdf": {
                "type": "mask", "opacity": 0.6, "nested_bsdf": {"type": "thindielectric"}}}}


EVERYTHING = {"materials": materials, "shapes": shapes, "textures": textures, "lamps": many_lamps, "fog": fog,
              "smoke": smoke}


def build_everything(name: str, dtype: torch.dtype = torch.float64) -> rb.Scene:
    return load(dtype, **EVERYTHING[name]())
