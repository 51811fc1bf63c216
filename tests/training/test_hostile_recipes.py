"""Recipes that ask for what cannot be: one message, before anything is written."""

import re

import pytest
import torch

from torch_radbp.io.image import save_image
from torch_radbp.training.optimize import Recovery
from torch_radbp.training.recipe_file import read_recipe

COLOUR = 'name = "paint.reflectance.value"\ninitial = 0.5\nbounds = [0.0, 1.0]\ntruth = "scene"'
IDENTITY = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]


def pose(**entries: float) -> str:
    rows = [list(row) for row in IDENTITY]
    for place, value in entries.items():
        rows[int(place[1])][int(place[3])] = value
    return f'name = "wall.to_world"\ninitial = {rows}'


CUBE = '<shape type="cube" id="box"><transform name="to_world"><scale value="0.3"/></transform>{}</shape>'
PLAIN, PICTURE = CUBE.format('<ref id="paint"/>'), CUBE.format('<ref id="picture"/>')
PARAMETERS = {
    "pose of halves": (
        "",
        'name = "wall.to_world"\ninitial = 0.5',
        "parameter 'wall.to_world': initial must be affine: its last row must be 0 0 0 1, got [0.5, 0.5, 0.5, 0.5]",
    ),
    "pose of zeros": ("", 'name = "camera.to_world"\ninitial = 0.0', "parameter 'camera.to_world': initial must be affine"),
    "projective pose": (
        "",
        pose(r3c0=0.5),
        "initial must be affine: its last row must be 0 0 0 1, got [0.5, 0.0, 0.0, 1.0]",
    ),
    "flat pose": (
        "",
        pose(r0c0=0),
        "parameter 'wall.to_world': initial must be invertible, got a matrix with determinant 0",
    ),
    "pose of three rows": (
        "",
        f'name = "wall.to_world"\ninitial = {IDENTITY[:3]}',
        "must be one number or have shape (4, 4), got",
    ),
    "true pose of halves": ("", 'name = "wall.to_world"\ntruth = 0.5', "parameter 'wall.to_world': truth must be affine"),
    "negative colour": ("", 'name = "paint.reflectance.value"\ninitial = -0.5', "initial must be in [0, 1], got -0.5"),
    "bright colour": ("", 'name = "paint.reflectance.value"\ninitial = 2.0', "initial must be in [0, 1], got 2"),
    "true colour": ("", 'name = "paint.reflectance.value"\ntruth = 2.0', "truth must be in [0, 1], got 2"),
    "negative light": ("", 'name = "lamp.emitter.radiance.value"\ninitial = -1', "initial must be at least 0, got -1"),
    "no field of view": ("", 'name = "camera.x_fov"\ninitial = 0', "initial must be between 0 and 180 degrees, got 0"),
    "wide field of view": ("", 'name = "camera.x_fov"\ninitial = 200', "initial must be between 0 and 180 degrees, got 200"),
    "coordinates without a bitmap": (
        PLAIN,
        'name = "box.vertex_texcoords"',
        "parameter 'box.vertex_texcoords' cannot be recovered: "
        "no sensor with a target sees what it changes; texture coordinates are read where a "
        "material or an emitter has a bitmap",
    ),
    "material without a shape": (
        '<bsdf type="diffuse" id="spare"/>',
        'name = "spare.reflectance.value"',
        "parameter 'spare.reflectance.value' cannot be recovered: no sensor with a target sees what it changes",
    ),
    "sensor without a target": (
        '<sensor type="perspective" id="other"/>',
        'name = "other.x_fov"',
        "parameter 'other.x_fov' cannot",
    ),
}


def change(folder, scene: str, parameter: str):
    path = folder / "scene.xml"
    text = path.read_text()
    if not scene.startswith("<bsdf") and "picture" not in scene:  # without a bitmap anywhere
        text = text.replace('<ref id="picture"/>', '<ref id="paint"/>')
    path.write_text(text.replace("</scene>", f"{scene}</scene>"))
    recipe = folder / "recipe.toml"
    text = recipe.read_text().replace(COLOUR, parameter)
    recipe.write_text(text.replace('image = "target.exr"', 'image = "target.exr"\nsensor = "camera"'))
    return recipe


@pytest.mark.parametrize("scene, parameter, message", PARAMETERS.values(), ids=PARAMETERS)
def test_a_parameter_that_cannot_be_recovered_is_named(folder, scene, parameter, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        Recovery(read_recipe(change(folder, scene, parameter)))


def test_texture_coordinates_under_a_bitmap_are_recovered(folder):
    recovery = Recovery(read_recipe(change(folder, PICTURE, 'name = "box.vertex_texcoords"')))
    image = recovery.renderer(seed=0, sensors=recovery.targets.sensors)
    image.square().sum().backward()
    assert recovery.parameters[0].raw.grad.any()


@pytest.mark.parametrize("value", [-1.0, -1e-3])
def test_a_target_of_negative_radiance_is_refused(folder, value):
    save_image(folder / "target.exr", torch.full((3, 6, 8), value))
    message = r"target.exr has 48 of 48 pixels of negative luminance, but radiance is at least 0; a target is a linear image"
    with pytest.raises(ValueError, match=message):
        Recovery(read_recipe(folder / "recipe.toml"))


def test_a_target_may_have_colours_out_of_gamut(folder):
    """Of positive luminance, one channel below 0, as conversions from wider gamuts give."""
    image = torch.full((3, 6, 8), 0.5)
    image[0] = -0.05
    save_image(folder / "target.exr", image)
    assert Recovery(read_recipe(folder / "recipe.toml")).targets.images.min() < 0
