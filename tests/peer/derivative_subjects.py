"""What is differentiated by both renderers, and where: every material, texture and light with parameters, by name.

A subject is asked at `COUNT` places, and its derivative is the change of every answer as one parameter moves along its
`tangent`: nothing is integrated, so that nothing is noisy. Answers are columns of an (N, C) array, which `COLUMNS` names by
how a subject is asked. Directions move, too, under the names `WI` and `WO`.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tests.plugin.plugin_table import beyond_mitsuba
from tests.scenes import rgb, texels
from tests.scenes.lights import EMITTERS, LAMP_POSE
from tests.scenes.materials import MATERIALS, as_dict
from tests.scenes.mesh_attributes import PLY
from torch_radbp.io.values.transform import rotate, scale, translate

COUNT = 200
WI, WO = "wi", "wo"
COLUMNS = {  # by how a subject is asked: the names of its answers and how many numbers each has
    "bsdf": {"eval": 3, "pdf": 1, "weight": 3, "direction": 3},  # the last two of delta lobes, at fixed random numbers
    "surround": {"radiance": 3},  # that arrives from directions
    "surface": {"radiance": 3},  # that leaves what rays meet
    "lamp": {"radiance": 3, "direction": 3},  # of light samples: of lights without extent
}


class Subject(NamedTuple):
    """Something with parameters."""

    asked: str
    """How: a key of `COLUMNS`."""
    description: dict[str, Any]
    """A dict in Mitsuba's vocabulary: of a material, or of all objects of a scene. Arrays are images and transforms."""

    def digest(self) -> str:
        """Identifies the description and the places."""
        found = hashlib.sha256(repr(written(self.description)).encode())
        for array in PLACES:
            found.update(array.tobytes())
        return found.hexdigest()


class Places(NamedTuple):
    """Where subjects are asked, float32; (N, 3) but for the coordinates and the random numbers."""

    wi: np.ndarray  # local unit directions
    wo: np.ndarray
    d_wi: np.ndarray  # unit tangents, along which these move
    d_wo: np.ndarray
    uv: np.ndarray  # (N, 2), beyond the unit square
    random: np.ndarray  # (N, 3): the choice of a lobe, and two numbers for its direction
    p: np.ndarray  # positions under the lamps
    towards: np.ndarray  # unit directions from there to about where lamps are


def written(value: Any) -> Any:
    """A description with arrays as lists, in single precision: the last bits of sines differ between machines."""
    if isinstance(value, dict):
        return {key: written(item) for key, item in value.items()}
    return value.astype(np.float32).tolist() if isinstance(value, np.ndarray) else str(value)


def unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors (N, 3) over their lengths."""
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def places() -> Places:
    """A quarter of the pairs of directions each: near ideal reflection, near straight through, grazing, and any."""
    generator = np.random.default_rng(11)
    wi, wo = (unit(generator.normal(size=(COUNT, 3))) for _ in range(2))
    quarter, eighth = COUNT // 4, COUNT // 8
    wo[:quarter] = wi[:quarter] * [-1, -1, 1] + 0.3 * generator.normal(size=(quarter, 3))
    wo[quarter:2 * quarter] = -wi[quarter:2 * quarter] + 0.3 * generator.normal(size=(quarter, 3))
    wi[-quarter:, 2] *= 0.05
    wo[-eighth:, 2] *= 0.05
    wi, wo = unit(wi), unit(wo)
    moves = [unit(np.cross(w, generator.normal(size=(COUNT, 3)))) for w in (wi, wo)]
    uv, random = generator.uniform(-1.5, 2.5, (COUNT, 2)), generator.integers(2**24, size=(COUNT, 3)) / 2**24
    p = generator.uniform(-1, 1, (COUNT, 3)) * [1.2, 0.3, 1.2] + [0, -0.2, 0]
    towards = unit([0.3, 1.1, -0.2] + 0.5 * generator.uniform(-1, 1, (COUNT, 3)) - p)
    return Places(*(array.astype(np.float32) for array in (wi, wo, *moves, uv, random, p, towards)))


PLACES = places()


def tangent(parameter: str, value: np.ndarray) -> np.ndarray:
    """The direction in which a parameter moves: of numbers some of all signs, of poses a turn and a shift.

    Poses must stay rigid, since their scale is taken out in one renderer and not in the other.
    """
    if parameter.endswith("to_world"):
        turn = np.array([[0, -0.3, 0.7], [0.3, 0, -0.5], [-0.7, 0.5, 0]])
        moved = np.zeros((4, 4))
        moved[:3, :3], moved[:3, 3] = turn @ value[:3, :3], (0.4, -0.2, 0.3)
        return moved
    generator = np.random.default_rng(3)
    found = generator.uniform(0.3, 1, value.shape) * generator.choice([-1.0, 1.0], value.shape)
    if parameter.endswith("to_uv"):
        found[2:] = found[:, 2] = 0
    return np.ones(()) if value.ndim == 0 else found


# -- Materials -------------------------------------------------------------------------------------------------------------

TO_UV = translate((0.11, -0.07, 0)) @ rotate((0, 0, 1), 25) @ scale((1.4, 0.7, 1))


def bitmap(height: int = 3, width: int = 4, factor: float = 1.0, seed: int = 1, **attributes: Any) -> dict[str, Any]:
    """An image that lies on the surface at an angle."""
    image = factor * texels(height, width, seed)
    return {"type": "bitmap", "raw": True, "data": image.astype(np.float32), "to_uv": TO_UV} | attributes


def diffuse(texture: dict[str, Any]) -> dict[str, Any]:
    """A material that shows a texture."""
    return {"type": "diffuse", "reflectance": texture}


GOLD = {"type": "roughconductor", "distribution": "ggx", "material": "Au", "alpha": 0.3}
BOARD = {"type": "checkerboard", "color0": bitmap(factor=0.5), "color1": 0.4, "to_uv": TO_UV}
# In Mitsuba only square images keep the direction of their slopes under a `to_uv` that turns, see torch_radbp.bsdf.bumpmap.
HEIGHTS = bitmap(4, 4, seed=2)
TRACE = 1e-3
TEXTURED = {
    **{f"{filter_type} {wrap_mode}": diffuse(bitmap(filter_type=filter_type, wrap_mode=wrap_mode))
       for filter_type in ("bilinear", "nearest") for wrap_mode in ("repeat", "mirror", "clamp")},
    "checkerboard": diffuse(BOARD | {"color1": [0.2, 0.7, 0.5]}),
    "srgb": diffuse({"type": "srgb", "color": [0.2, 0.7, 0.5]}),
    "uniform": diffuse({"type": "uniform", "value": 0.3}),
    "raw constant": diffuse({"type": "rawconstant", "value": 0.3}),
    "bitmap as a number": GOLD | {"alpha": bitmap()},
    "checkerboard as a number": GOLD | {"alpha": BOARD},
    "bitmaps of principled": {"type": "principled", "roughness": bitmap(), "base_color": bitmap(seed=4)},
    "bitmap of a sheet": MATERIALS["sheet with all"] | {"diff_trans": bitmap()},
    "bitmap of a blend": MATERIALS["blend"] | {"weight": bitmap()},
    "bitmap of a mask": MATERIALS["mask"] | {"opacity": bitmap()},
    "two sides": {"type": "twosided", "brdf": [GOLD, MATERIALS["diffuse"]]},
    "bitmap of normals": {"type": "normalmap", "normalmap": bitmap(), "nested_bsdf": GOLD},
    "bumps of a bitmap": {"type": "bumpmap", "arbitrary": HEIGHTS, "nested_bsdf": GOLD, "scale": 0.3},
    "bumps on glass": {"type": "bumpmap", "arbitrary": HEIGHTS, "nested_bsdf": MATERIALS["glass ggx"], "scale": -0.2},
    # A lobe whose parameter is zero does not exist in Mitsuba.
    "principled with a trace of all": MATERIALS["principled"] | {
        name: TRACE for name in ("anisotropic", "metallic", "spec_trans", "spec_tint", "sheen", "sheen_tint", "clearcoat",
                                 "clearcoat_gloss", "flatness")},
    "sheet with a trace of all": MATERIALS["sheet"] | {
        name: TRACE for name in ("anisotropic", "spec_trans", "spec_tint", "sheen", "sheen_tint", "flatness", "diff_trans")},
}
# Bump maps of `MATERIALS` are given a slope in the place of heights.
NOT_ASKED = {"bumpmap", "null"} | beyond_mitsuba()
BSDFS = {name: material for name, material in MATERIALS.items() if material["type"] not in NOT_ASKED} | TEXTURED

# -- Lights ----------------------------------------------------------------------------------------------------------------

ASKED = {"envmap": "surround", "constant": "surround", "sunsky": "surround", "point": "lamp", "spot": "lamp",
         "projector": "lamp", "directional": "lamp"}  # others lie on surfaces


def shining(radiance: dict[str, Any]) -> dict[str, Any]:
    """A rectangle that shines."""
    return {"lamp": {"type": "rectangle", "to_world": LAMP_POSE, "emitter": {"type": "area", "radiance": radiance}}}


LIGHTS = {name: lights for name, lights in EMITTERS.items() if name not in ("all", "directionalarea", "area_sphere")} | {
    "area of d65": shining({"type": "d65", "scale": 4.0}),
    "area of a checkerboard": shining(BOARD | {"color1": {"type": "d65", "scale": 4.0}}),
    **{f"area of {name}": {"lamp": {
        "type": "ply", "filename": Path("mesh.ply"), "to_world": LAMP_POSE,
        "emitter": {"type": "area", "radiance": {"type": "mesh_attribute", "name": name, "scale": 3.0}}}}
       for name in ("vertex_color", "face_tint_color")},
    "sunsky at a knot": {"lamp": EMITTERS["sunsky"]["lamp"] | {"turbidity": 4.0}},
    "sunsky between knots": {"lamp": EMITTERS["sunsky"]["lamp"] | {"turbidity": 4.4, "albedo": rgb(0.1, 0.5, 0.9)}},
}

SUBJECTS = {**{name: Subject("bsdf", as_dict(material)) for name, material in BSDFS.items()},
            **{f"light {name}": Subject(ASKED.get(lights["lamp"]["type"], "surface"), lights)
               for name, lights in LIGHTS.items()}}


def objects(subject: Subject, folder: Path) -> dict[str, Any]:
    """The description with the files that it names, which are written into a folder."""
    (folder / "mesh.ply").write_text(PLY)

    def found(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: found(item) for key, item in value.items()}
        return str(folder / value) if isinstance(value, Path) else value

    return found(subject.description)
