"""Draws a figure of pictures/ from a run: ``python assets/draw_figures.py sky runs/sky``.

Above the images before, by Mitsuba and after. Below them the map as recovered and as it is; of `camera_intrinsics`, which
has none, the errors before and after as colours of one scale. Of a normal map, prints the angles between the normals
recovered and the true ones, whose lengths an image does not tell.
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


def row(pictures: list[Image.Image], width: int) -> Image.Image:
    height = width * pictures[0].height // pictures[0].width
    canvas = Image.new("RGB", (len(pictures) * (width + GAP) - GAP, height), "white")
    for number, picture in enumerate(pictures):
        canvas.paste(picture.resize((width, height), Image.Resampling.NEAREST), (number * (width + GAP), 0))
    return canvas


def errors(run: Path, sensor: str) -> list[Image.Image]:
    """The errors before and after, light where they are large, on the scale of the former."""
    before, target, after = (read_image(run / "images" / f"{sensor}_{kind}.exr").movedim(-1, 0)
                             for kind in ("before", "target", "after"))
    scale = error_scale(absolute_error(before, target))
    colours = [false_colour(absolute_error(image, target), scale) for image in (before, after)]
    return [Image.fromarray((linear_to_srgb(each) * 255).byte().movedim(0, -1).numpy()) for each in colours]


if __name__ == "__main__":
    name, run = sys.argv[1], Path(sys.argv[2])
    sensors, parameter, columns = FIGURES[name]
    views = [run / "images" / f"{sensor}_{kind}.png" for sensor in sensors for kind in ("before", "target", "after")]
    if parameter is None:
        below = errors(run, sensors[0])
    else:
        maps = [run / "textures" / f"{parameter}_{kind}.png" for kind in ("recovered", "true")]
        below = [Image.open(path).convert("RGB") for path in maps]
    rows = [row([Image.open(path).convert("RGB") for path in views], WIDTH), row(below, columns * (WIDTH + GAP) - GAP)]
    figure = Image.new("RGB", (max(part.width for part in rows), rows[0].height + GAP + rows[1].height), "white")
    figure.paste(rows[0], (0, 0))
    figure.paste(rows[1], (0, rows[0].height + GAP))
    figure.save(ASSETS / "pictures" / f"{name}.png", optimize=True)
    if name == "normal_map":
        found = load_file(run / "parameters.safetensors")[parameter] * 2 - 1
        cosine = torch.cosine_similarity(found, read_image(ASSETS / "relief" / "normals.exr") * 2 - 1, dim=-1)
        angle = torch.rad2deg(cosine.clamp(-1, 1).acos())
        print(f"angles: mean {angle.mean():.2f}, at most {angle.max():.2f} degrees")
