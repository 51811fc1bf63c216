"""Draws a figure of pictures/ from a run: ``python assets/draw_figures.py sky runs/sky``.

Above the images before, by Mitsuba and after. Below them the map as recovered and as it is; of `camera_intrinsics`, which
has none, the errors before and after as colours of one scale. Of shapes, poses and lamps a row for each view. Of a normal
map, prints the angles between the normals recovered and the true ones, whose lengths an image does not tell.
"""

import sys
from pathlib import Path

import torch
from PIL import Image
from safetensors.torch import load_file

from torch_radbp.formats.image import linear_to_srgb, read_image
from torch_radbp.training.false_colour import absolute_error, error_scale, false_colour

ASSETS = Path(__file__).parent
WIDTH, GAP = 160, 6
# name -> (sensors shown, the parameter that is a picture, how many images its row is as wide as)
FIGURES = {"sky": (["front", "back"], "sky.data", 3), "normal_map": (["sensor"], "carved.normalmap.data", 1),
           "camera_intrinsics": (["sensor"], None, 1), "pot_network": (["view_0", "view_1"], "glaze.base_color.data", 3),
           "neural_painting": (["sensor"], "painting.bsdf.reflectance.data", 1)}
# name -> sensors shown, each in a row of its own
VIEWS = {"figurine_shape": ["view_0", "view_3", "view_7"], "three_shadows": ["on_floor", "on_back", "on_left"],
         "figurine_pose": ["sensor"], "lamp_place": ["sensor"], "room_camera": ["sensor"],
         "mirror_pose": ["sensor"]}
ROLES = ("before", "target", "after")


def row(pictures: list[Image.Image], width: int) -> Image.Image:
    height = width * pictures[0].height // pictures[0].width
    canvas = Image.new("RGB", (len(pictures) * (width + GAP) - GAP, height), "white")
    for number, picture in enumerate(pictures):
        canvas.paste(picture.resize((width, height), Image.Resampling.NEAREST), (number * (width + GAP), 0))
    return canvas


def errors(run: Path, sensor: str) -> list[Image.Image]:
    """The errors before and after, light where they are large, on the scale of the former."""
    before, target, after = (read_image(run / "images" / f"{sensor}_{kind}.exr").movedim(-1, 0)
                             for kind in ROLES)
    scale = error_scale(absolute_error(before, target))
    colours = [false_colour(absolute_error(image, target), scale) for image in (before, after)]
    return [Image.fromarray((linear_to_srgb(each) * 255).byte().movedim(0, -1).numpy()) for each in colours]


def views_of(run: Path, sensors: list[str]) -> list[Image.Image]:
    """The images of sensors before, by Mitsuba and after."""
    return [Image.open(run / "images" / f"{sensor}_{role}.png").convert("RGB") for sensor in sensors for role in ROLES]


def below(run: Path, sensor: str, parameter: str | None) -> list[Image.Image]:
    """The map as recovered and as it is, or the errors if there is none."""
    if parameter is None:
        return errors(run, sensor)
    return [Image.open(run / "textures" / f"{parameter}_{kind}.png").convert("RGB") for kind in ("recovered", "true")]


if __name__ == "__main__":
    name, run = sys.argv[1], Path(sys.argv[2])
    if name in VIEWS:
        rows = [row(views_of(run, [sensor]), WIDTH) for sensor in VIEWS[name]]
    else:
        sensors, parameter, columns = FIGURES[name]
        rows = [row(views_of(run, sensors), WIDTH), row(below(run, sensors[0], parameter), columns * (WIDTH + GAP) - GAP)]
    figure = Image.new("RGB", (max(part.width for part in rows), sum(part.height + GAP for part in rows) - GAP), "white")
    for number, part in enumerate(rows):
        figure.paste(part, (0, sum(each.height + GAP for each in rows[:number])))
    figure.save(ASSETS / "pictures" / f"{name}.png", optimize=True)
    if name == "normal_map":
        found = load_file(run / "parameters.safetensors")[FIGURES[name][1]] * 2 - 1
        cosine = torch.cosine_similarity(found, read_image(ASSETS / "relief" / "normals.exr") * 2 - 1, dim=-1)
        angle = torch.rad2deg(cosine.clamp(-1, 1).acos())
        print(f"angles: mean {angle.mean():.2f}, at most {angle.max():.2f} degrees")
