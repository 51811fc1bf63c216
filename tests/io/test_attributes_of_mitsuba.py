"""Every attribute that Mitsuba 3.9.1's textures, volumes and emitters take is taken here, and by Mitsuba if it is there.

The names are those of Mitsuba's documentation and of its binaries. Meshes' attributes and media are left out.
"""

import numpy as np
import pytest
import torch

import torch_radbp as rb
from torch_radbp.formats.image import save_image
from torch_radbp.formats.volume import write_volume
from torch_radbp.plugin import REGISTRY

IMAGE, GRID, POSE = "the name of an image", "the name of a grid", "a matrix"
COLOUR = {"type": "rgb", "value": [0.2, 0.3, 0.4]}
TEXTURE = {"type": "checkerboard"}
WEIGHT = {"sampling_weight": 0.5}
# By plugin what it needs, and its attributes.
TEXTURES = {
    "bitmap": ({"filename": IMAGE}, {"filter_type": "nearest", "wrap_mode": "mirror", "format": "fp16", "raw": True,
                                     "to_uv": POSE, "accel": False}),
    "checkerboard": ({}, {"color0": TEXTURE, "color1": 0.3, "to_uv": POSE}),
    "d65": ({}, {"color": COLOUR, "scale": 0.5}),
    "srgb": ({"color": [0.1, 0.2, 0.3]}, {"unbounded": True}),
    "uniform": ({"value": 0.3}, {"wavelength_min": 400.0, "wavelength_max": 700.0}),
    "rawconstant": ({}, {"value": 0.3}),
    "volume": ({}, {"volume": {"type": "constvolume"}}),
}
VOLUMES = {
    "constvolume": ({}, {"value": COLOUR}),
    "gridvolume": ({"filename": GRID}, {"use_grid_bbox": True, "filter_type": "nearest", "wrap_mode": "mirror", "raw": True,
                                        "to_world": POSE, "accel": False, "max_value": 1.0}),
}
EMITTERS = {
    "constant": ({}, WEIGHT | {"radiance": COLOUR}),
    "directional": ({}, WEIGHT | {"irradiance": COLOUR, "direction": [0.1, 0.2, 0.9], "to_world": POSE}),
    "envmap": ({"filename": IMAGE}, WEIGHT | {"scale": 2.0, "to_world": POSE, "mis_compensation": True}),
    "point": ({}, WEIGHT | {"intensity": COLOUR, "position": [1.0, 2.0, 3.0], "to_world": POSE}),
    "projector": ({}, WEIGHT | {"irradiance": TEXTURE, "scale": 2.0, "to_world": POSE, "fov": 30.0,
                                "fov_axis": {"fov": 30.0, "fov_axis": "y"},
                                "focal_length": "50mm"}),
    "spot": ({}, WEIGHT | {"intensity": COLOUR, "cutoff_angle": 30.0, "beam_width": 10.0, "texture": TEXTURE,
                           "to_world": POSE}),
    "sunsky": ({}, WEIGHT | {"turbidity": 4.0, "albedo": 0.2, "sun_direction": [0.1, 0.2, 0.9], "latitude": 35.0,
                             "longitude": 139.0, "timezone": 9.0, "year": 2012, "month": 3, "day": 4, "hour": 13.0,
                             "minute": 5.0, "second": 6.0, "sun_aperture": 0.6, "sun_scale": 0.5, "sky_scale": 0.7,
                             "complex_sun": False, "to_world": POSE}),
    "area": ({}, WEIGHT | {"radiance": TEXTURE}),
    "directionalarea": ({}, WEIGHT | {"radiance": TEXTURE}),
}
KINDS = {"texture": TEXTURES, "volume": VOLUMES, "emitter": EMITTERS}
CASES = [(category, plugin, name) for category, plugins in KINDS.items()
         for plugin, (_, attributes) in plugins.items() for name in attributes]


def scene_with(category: str, plugin: str, name: str, image: str, matrix) -> dict:
    """A scene in which a plugin has an attribute, or several that need each other."""
    needed, attributes = KINDS[category][plugin]
    value = attributes[name]
    together = value if isinstance(value, dict) and "type" not in value else {name: value}
    subject = {"type": plugin, **needed, **together}
    subject = {key: image if value is IMAGE else image.replace(".exr", ".vol") if value is GRID else
               matrix(np.eye(4)) if value is POSE else value for key, value in subject.items()}
    lamp = {"type": "constant"}
    if category == "volume":
        subject = {"type": "volume", "volume": subject}
    if category in ("texture", "volume"):
        objects = {"wall": {"type": "rectangle", "bsdf": {"type": "diffuse", "reflectance": subject}}, "lamp": lamp}
    elif plugin in ("area", "directionalarea"):
        objects = {"wall": {"type": "rectangle", "emitter": subject}}
    else:
        objects = {"subject": subject}
    return {"type": "scene", "sensor": {"type": "perspective"}, **objects}


@pytest.fixture
def image(tmp_path) -> str:
    path = tmp_path / "image.exr"
    save_image(path, torch.rand(3, 4, 6, generator=torch.Generator().manual_seed(1)))
    write_volume(path.with_suffix(".vol"), np.full((2, 2, 2, 3), 0.5, "f4"))
    return str(path)


@pytest.mark.parametrize("category, plugin, name", CASES)
def test_an_attribute_is_taken(category, plugin, name, image):
    scene = rb.load_dict(scene_with(category, plugin, name, image, torch.as_tensor))
    assert any(module.type == plugin for module in scene.modules() if hasattr(module, "type"))


def test_mitsuba_takes_the_same(mi, image):
    for case in CASES:
        mi.load_dict(scene_with(*case, image, mi.ScalarTransform4f))


def test_every_texture_and_emitter_that_both_have_is_in_the_list():
    spectra = {"blackbody", "regular", "irregular", "rgb", "mesh_attribute"}  # their own tests have them
    assert set(TEXTURES) == set(REGISTRY["texture"]) - spectra and set(EMITTERS) == set(REGISTRY["emitter"])
    assert set(VOLUMES) == set(REGISTRY["volume"])
