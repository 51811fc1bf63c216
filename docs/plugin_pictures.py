"""Small pictures of plugins: a ball of each material, a floor under each lamp, and so on.

    python -m docs.plugin_pictures bsdf diffuse out.png      # one of them
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import torch

import torch_radbp as rb

SIZE, SAMPLES = 128, 128
ASSETS = Path(__file__).parents[1] / "assets"
CHECKED = {"type": "checkerboard", "color0": 0.25, "color1": 0.6, "to_uv": torch.diag(torch.tensor([8.0, 8.0, 1.0, 1.0]))}
PATCHES = {"type": "bitmap", "filename": str(ASSETS / "patches.png")}
RED, GREY = {"type": "rgb", "value": [0.55, 0.12, 0.08]}, {"type": "rgb", "value": [0.5, 0.5, 0.5]}
FLOOR = {"type": "rectangle", "to_world": torch.diag(torch.tensor([4.0, 4.0, 1.0, 1.0])),
         "bsdf": {"type": "diffuse", "reflectance": CHECKED}}
LAMP = {"type": "rectangle", "to_world": rb.look_at([-2.5, -2.0, 4.0], [0.0, 0.0, 0.8], [0.0, 0.0, 1.0]),
        "emitter": {"type": "area", "radiance": 6.0}}
SKY = {"type": "constant", "radiance": 0.35}
BALL = {"type": "sphere", "center": [0.0, 0.0, 1.0]}
ASIDE = rb.look_at([-1.6, -3.2, 3.0], [0.0, 0.0, 0.6], [0.0, 0.0, 1.0])

# What is drawn of each plugin: its own keys, as a scene has them.
BSDFS = {
    "blendbsdf": {"weight": CHECKED, "first": {"type": "diffuse", "reflectance": RED},
                  "second": {"type": "roughconductor", "material": "Au", "alpha": 0.15}},
    "bumpmap": {"arbitrary": PATCHES | {"raw": True}, "bsdf": {"type": "plastic", "diffuse_reflectance": RED}, "scale": 0.3},
    "conductor": {"material": "Au"},
    "dielectric": {"int_ior": 1.5},
    "diffuse": {"reflectance": RED},
    "mask": {"opacity": CHECKED | {"color0": 0.0, "color1": 1.0}, "bsdf": {"type": "diffuse", "reflectance": RED}},
    "normalmap": {"normalmap": {"type": "bitmap", "filename": str(ASSETS / "relief" / "normals.exr"), "raw": True},
                  "bsdf": {"type": "plastic", "diffuse_reflectance": RED}},
    "null": {},
    "plastic": {"diffuse_reflectance": RED, "int_ior": 1.5},
    "principled": {"base_color": RED, "roughness": 0.4, "metallic": 0.2, "clearcoat": 1.0, "clearcoat_gloss": 0.9},
    "principledthin": {"base_color": RED, "roughness": 0.4, "diff_trans": 1.0},
    "roughconductor": {"material": "Au", "alpha": 0.2},
    "roughdielectric": {"int_ior": 1.5, "alpha": 0.15},
    "roughplastic": {"diffuse_reflectance": RED, "alpha": 0.15},
    "thindielectric": {"int_ior": 1.5},
    "twosided": {"bsdf": {"type": "diffuse", "reflectance": RED}},
}
TEXTURES = {
    "bitmap": PATCHES,
    "checkerboard": {"color0": RED, "color1": GREY, "to_uv": torch.diag(torch.tensor([6.0, 6.0, 1.0, 1.0]))},
    "d65": {"scale": 0.6},
    "irregular": {"wavelengths": "400, 500, 600, 700", "values": "0.1, 0.2, 0.7, 0.6"},
    "rawconstant": {"value": [0.2, 0.5, 0.6]},
    "regular": {"wavelength_min": 400.0, "wavelength_max": 700.0, "values": "0.6, 0.2, 0.1"},
    "rgb": {"value": [0.55, 0.12, 0.08]},
    "srgb": {"color": [0.55, 0.12, 0.08]},
    "uniform": {"value": 0.5},
}
EMITTERS = {
    "area": {"radiance": 8.0},
    "constant": {"radiance": 0.7},
    "directional": {"direction": [0.6, 0.5, -1.0], "irradiance": 2.0},
    "directionalarea": {"radiance": 2.0},
    "envmap": {"filename": str(ASSETS / "lit_balls" / "sky.exr"),
               "to_world": torch.tensor([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])},
    "point": {"position": [-1.5, -1.5, 2.5], "intensity": 14.0},
    "projector": {"irradiance": PATCHES, "scale": 30.0, "fov": 40.0, "to_world": ASIDE},
    "spot": {"to_world": ASIDE, "intensity": 40.0, "cutoff_angle": 20.0},
    "sunsky": {"sun_direction": [-0.5, -0.4, 0.6], "sky_scale": 0.6, "sun_scale": 0.6},
}
CORNERS = torch.tensor([[1.0, 0, 0.2], [-0.5, 0.87, 0.2], [-0.5, -0.87, 0.2], [0, 0, 1.6]])
FACES = torch.tensor([[0, 1, 3], [1, 2, 3], [2, 0, 3], [1, 0, 2]])


def grid_of_two_balls() -> torch.Tensor:
    """(24, 24, 24, 1) signed distances in the unit cube of two balls that touch."""
    z, y, x = torch.meshgrid(*[torch.linspace(0, 1, 24)] * 3, indexing="ij")
    lower = ((x - 0.5) ** 2 + (y - 0.5) ** 2 + (z - 0.33) ** 2).sqrt() - 0.28
    upper = ((x - 0.5) ** 2 + (y - 0.5) ** 2 + (z - 0.7) ** 2).sqrt() - 0.2
    return torch.minimum(lower, upper)[..., None]


def lifted(scale: float, height: float) -> torch.Tensor:
    """The transform that scales by a factor and moves up."""
    matrix = torch.diag(torch.tensor([scale, scale, scale, 1.0]))
    matrix[2, 3] = height
    return matrix


UPRIGHT = rb.look_at([0.0, 0.0, 1.0], [-0.3, -1.0, 1.2], [0.0, 0.0, 1.0])  # faces the camera
SHAPES = {
    "cube": {"to_world": lifted(0.7, 0.7)},
    "cylinder": {"p0": [0.0, 0.0, 0.0], "p1": [0.0, 0.0, 1.5], "radius": 0.6},
    "disk": {"to_world": UPRIGHT},
    "instance": {"group": {"type": "ref", "id": "group"}, "to_world": lifted(0.5, 0.5)},
    "mesh": {"vertex_positions": CORNERS, "faces": FACES},
    "rectangle": {"to_world": UPRIGHT},
    "sdfgrid": {"grid": grid_of_two_balls(),
                "to_world": torch.tensor([[2.0, 0, 0, -1], [0, 2, 0, -1], [0, 0, 2, 0], [0, 0, 0, 1]])},
    "sphere": {"center": [0.0, 0.0, 1.0], "radius": 1.0},
}
WITHOUT = {"texture": ("blackbody", "mesh_attribute"), "shape": ("obj", "ply", "serialized", "shapegroup")}  # no picture
EXAMPLES = {"bsdf": BSDFS, "texture": TEXTURES, "emitter": EMITTERS, "shape": SHAPES}


def scene_of(category: str, name: str) -> dict[str, Any]:
    """The scene in which the example of a plugin is drawn."""
    plugin = {"type": name} | EXAMPLES[category][name]
    scene = {"type": "scene", "integrator": {"type": "path", "max_depth": 8}, "floor": FLOOR, "sensor": {
        "type": "perspective", "fov": 34.0, "to_world": rb.look_at([-0.8, -4.6, 2.4], [0.0, 0.0, 0.75], [0.0, 0.0, 1.0]),
        "film": {"type": "hdrfilm", "width": SIZE, "height": SIZE}}}
    red = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": RED}}
    if category == "emitter":
        own = {"lamp": LAMP | {"emitter": plugin}} if name in ("area", "directionalarea") else {"light": plugin}
        return scene | own | {"thing": BALL | {"bsdf": red}}
    scene |= {"lamp": LAMP, "sky": SKY}
    if category == "bsdf":
        return scene | {"thing": BALL | {"bsdf": plugin}}
    if category == "texture":
        return scene | {"thing": {"type": "rectangle", "to_world": UPRIGHT,
                                  "bsdf": {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": plugin}}}}
    if name == "instance":
        group = {"type": "shapegroup", "id": "group", "ball": {"type": "sphere", "bsdf": red}}
        moved = [plugin | {"to_world": lifted(scale, scale) + place} for scale, place in (
            (0.5, shift(-0.8, 0.0)), (0.4, shift(0.2, -0.6)), (0.6, shift(0.7, 0.4)))]
        return scene | {"group": group} | {f"thing_{number}": thing for number, thing in enumerate(moved)}
    return scene | {"thing": plugin | {"bsdf": red}}


def shift(x: float, y: float) -> torch.Tensor:
    """What is added to a transform so that it moves further."""
    matrix = torch.zeros(4, 4)
    matrix[0, 3], matrix[1, 3] = x, y
    return matrix


def draw(category: str, name: str, picture: Path) -> None:
    """Renders the example of a plugin into a PNG."""
    rb.save_image(picture, rb.render(rb.load_dict(scene_of(category, name)), spp=SAMPLES, seed=0)[0])


if __name__ == "__main__":
    draw(sys.argv[1], sys.argv[2], Path(sys.argv[3]))
