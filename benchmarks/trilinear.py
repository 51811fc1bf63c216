"""Noise, bias and time of bitmaps that are read from a pyramid: ``python -m benchmarks.trilinear``.

A tiled floor to the horizon, whose texels are smaller than pixels almost everywhere, a mirror ball and a rough one on it, a
white wall that it lights. The same scene with both filters, `bilinear` and `trilinear`, compiled. A row of the table holds

    noise   standard deviation of a pixel over independent renderings, root mean square over the image, relative to the mean
    lit     the same without the noise of the light: of the albedo that each pixel sees
    bias    of the trilinear image: difference of its pixels from the bilinear one's, by many samples of each, without what
            their noise explains, relative to the mean; and that of the mean
    time    of one rendering, median

The picture has both at four samples, and the bilinear image by many.
"""

from __future__ import annotations

import argparse
import statistics
import time
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from torch import Tensor

import torch_radbp as rb
from torch_radbp.formats.image import linear_to_srgb
from torch_radbp.io.values.transform import rotate, scale, translate

WIDTH, HEIGHT = 240, 140
FILTERS = ("bilinear", "trilinear")
SPP, RENDERINGS = 4, 16
MANY = 1024  # samples of what bias is measured by
MARGIN = 6  # pixels between the images of the picture


def tiles(count: int = 32, size: int = 16) -> Tensor:
    """(512, 512, 3) tiles in a few colours with grout between them, and grain."""
    generator = np.random.default_rng(1)
    palette = np.array([[0.75, 0.68, 0.55], [0.55, 0.20, 0.12], [0.20, 0.28, 0.40], [0.82, 0.80, 0.74]])
    colours = palette[generator.integers(0, len(palette), (count, count))]
    image = colours.repeat(size, 0).repeat(size, 1) * generator.uniform(0.7, 1.15, (count * size, count * size, 1))
    image[::size], image[:, ::size] = 0.08, 0.08
    return torch.from_numpy(image.clip(0, 0.95)).float()


def scene_of(filter_type: str) -> rb.Scene:
    """The scene with a filter."""
    floor = {"type": "bitmap", "data": tiles(), "raw": True, "filter_type": filter_type, "to_uv": scale((16, 16, 1))}
    film = {"type": "hdrfilm", "width": WIDTH, "height": HEIGHT, "rfilter": {"type": "box"}}
    return rb.load_dict({
        "type": "scene",
        "sensor": {"type": "perspective", "fov": 50, "film": film,
                   "to_world": rb.look_at((0.0, 1.3, 4.0), (0.0, 0.75, 0.0), (0, 1, 0))},
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": [0.7, 0.85, 1.0]}},
        "floor": {"type": "rectangle", "to_world": rotate((1, 0, 0), -90) @ scale((60, 60, 1)),
                  "bsdf": {"type": "diffuse", "reflectance": floor}},
        "mirror": {"type": "sphere", "center": [-0.9, 0.8, 0.0], "radius": 0.8, "bsdf": {"type": "conductor",
                                                                                       "material": "Ag"}},
        "rough": {"type": "sphere", "center": [0.95, 0.6, 0.6], "radius": 0.6, "bsdf": {
            "type": "roughconductor", "material": "Au", "distribution": "ggx", "alpha": 0.2}},
        "wall": {"type": "rectangle", "to_world": translate((2.6, 1.2, -1.5)) @ rotate((0, 1, 0), -50) @ scale((1.2,) * 3),
                 "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.8, 0.8, 0.8]}}}})


def deviation(images: Tensor) -> float:
    """The noise of images, (R, 3, H, W), relative to their mean."""
    return float(images.var(0).mean().sqrt() / images.mean())


def picture(images: list[Tensor], path: Path) -> None:
    """Writes images, (3, H, W), side by side."""
    gap = torch.ones(3, HEIGHT, MARGIN)
    parts = [part for image in images for part in (linear_to_srgb(image.movedim(0, -1)).movedim(-1, 0).clamp(0, 1), gap)]
    pixels = torch.cat(parts[:-1], 2).movedim(0, -1).numpy()
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray((255 * pixels + 0.5).astype(np.uint8)).save(path)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--picture", type=Path, default=Path("runs/trilinear.png"))
    parser.add_argument("--many", type=int, default=MANY, help="samples of what bias is measured by")
    options = parser.parse_args()
    renderers = {name: rb.Renderer(scene_of(name), spp=SPP, max_depth=5) for name in FILTERS}
    seconds, images, albedos = ({name: [] for name in FILTERS} for _ in range(3))
    with torch.no_grad():
        for renderer in renderers.values():
            renderer(seed=10_000)  # compiles
        for seed in range(RENDERINGS):
            for name, renderer in renderers.items():
                start = time.perf_counter()
                images[name].append(renderer(seed=seed)[0])
                seconds[name].append(time.perf_counter() - start)
                albedos[name].append(renderer.aovs(["albedo"], seed=seed)["albedo"][0])
        halves = {name: [renderer(seed=20_000 + half, spp=options.many // 2)[0] for half in range(2)]
                  for name, renderer in renderers.items()}
    print("| filter | noise | lit | time |\n|---|---|---|---|")
    for name in FILTERS:
        noise, lit = (100 * deviation(torch.stack(found[name])) for found in (images, albedos))
        print(f"| {name} | {noise:.1f}% | {lit:.1f}% | {1000 * statistics.median(seconds[name]):.0f} ms |")
    (a, b), (c, d) = halves["bilinear"], halves["trilinear"]
    squared = ((c - a) * (d - b)).mean()  # independent noises: the square of what differs
    level = (a + b).mean() / 2
    print(f"bias: {100 * float(squared.clamp_min(0).sqrt() / level):.2f}% of a pixel, root mean square; "
          f"{100 * float((c + d).mean() / (a + b).mean() - 1):+.2f}% of the image")
    picture([images["bilinear"][0], images["trilinear"][0], (a + b) / 2], options.picture)
    print(f"picture: {options.picture}")


if __name__ == "__main__":
    main()
