"""Draws a figure of pictures/ from a run: ``python assets/draw_figures.py sky runs/sky``.

Above the images before, by Mitsuba and after; below them the map as recovered and as it is. Of a normal map, prints the
angles between the normals recovered and the true ones, whose lengths an image does not tell.
"""

import sys
from pathlib import Path

import torch
from PIL import Image
from safetensors.torch import load_file

from torch_radbp.io.image import read_image

ASSETS = Path(__file__).parent
WIDTH, GAP = 160, 6
FIGURES = {"sky": (["front", "back"], "sky.data", 3), "normal_map": (["sensor"], "carved.normalmap.data", 1)}


def row(paths: list[Path], width: int) -> Image.Image:
    pictures = [Image.open(path).convert("RGB") for path in paths]
    height = width * pictures[0].height // pictures[0].width
    canvas = Image.new("RGB", (len(paths) * (width + GAP) - GAP, height), "white")
    for number, picture in enumerate(pictures):
        canvas.paste(picture.resize((width, height), Image.Resampling.NEAREST), (number * (width + GAP), 0))
    return canvas


if __name__ == "__main__":
    name, run = sys.argv[1], Path(sys.argv[2])
    sensors, parameter, columns = FIGURES[name]
    views = [run / "images" / f"{sensor}_{kind}.png" for sensor in sensors for kind in ("before", "target", "after")]
    maps = [run / "textures" / f"{parameter}_{kind}.png" for kind in ("recovered", "true")]
    rows = [row(views, WIDTH), row(maps, columns * (WIDTH + GAP) - GAP)]
    figure = Image.new("RGB", (max(part.width for part in rows), rows[0].height + GAP + rows[1].height), "white")
    figure.paste(rows[0], (0, 0))
    figure.paste(rows[1], (0, rows[0].height + GAP))
    figure.save(ASSETS / "pictures" / f"{name}.png", optimize=True)
    if name == "normal_map":
        found = load_file(run / "parameters.safetensors")[parameter] * 2 - 1
        cosine = torch.cosine_similarity(found, read_image(ASSETS / "relief" / "normals.exr") * 2 - 1, dim=-1)
        angle = torch.rad2deg(cosine.clamp(-1, 1).acos())
        print(f"angles: mean {angle.mean():.2f}, at most {angle.max():.2f} degrees")
