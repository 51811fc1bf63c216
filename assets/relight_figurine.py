"""Shows a figurine that `radbp optimize figurine_joint` has recovered under skies that no photograph shows.

    python assets/relight_figurine.py runs/figurine_joint      # prints errors and PSNR, draws pictures/figurine_joint.png

What was recovered, shape and maps, is rendered with the true camera of a view and compared with Mitsuba's images of the true
figurine under the same sky: on the screen's scale, over all pixels, and over those in which either figurine is seen.
"""

import json
import math
import sys
from pathlib import Path
from statistics import mean

import torch
from PIL import Image
from torch import Tensor

import torch_radbp as rb
from torch_radbp.formats.image import linear_to_srgb, read_image

ASSETS = Path(__file__).parent
FIGURINE, SKIES, VIEW, SPP = ASSETS / "figurine", ("dusk", "noon", "window"), "view_1", 512
VIEWS, MAPS = ("view_1", "view_10"), ("body.bsdf.base_color.data", "body.bsdf.roughness.data", "sky.data")
WIDTH, GAP = 144, 6


def under_sky(scene: rb.Scene, sky: str) -> Tensor:
    """(3, H, W) a scene seen by the true camera of a view, under another sky; linear."""
    scene.sky.data = torch.nn.Parameter(read_image(FIGURINE / f"{sky}.exr"))
    return rb.render(scene, spp=SPP, seed=1, sensors=VIEW)[0].detach()


def body_pixels(scene: rb.Scene) -> Tensor:
    """(H, W) bool: where the body is seen at all."""
    index = rb.Renderer(scene, spp=16).aovs(["shape_index"], seed=0, sensors=VIEW)["shape_index"][0, 0]
    floor = 2.0  # of pixels that the board fills; what lies between is an edge
    return (index > 0) & (index < floor)


def psnr(image: Tensor, target: Tensor, pixels: Tensor) -> float:
    """dB, of values as a screen shows them."""
    shown, wanted = (linear_to_srgb(each.clamp(0, 1))[:, pixels] for each in (image, target))
    return -10 * math.log10((shown - wanted).square().mean())


def picture(image: Tensor) -> Image.Image:
    """As a screen shows it."""
    return resized(Image.fromarray((linear_to_srgb(image.clamp(0, 1)) * 255 + 0.5).byte().movedim(0, -1).numpy()))


def resized(image: Image.Image) -> Image.Image:
    """As wide as all parts of the sheet, its pixels as they are."""
    return image.resize((WIDTH, WIDTH * image.height // image.width), Image.Resampling.NEAREST)


def sheet(rows: list[list[Image.Image]]) -> Image.Image:
    """Rows of pictures that are equally wide."""
    heights = [row[0].height + GAP for row in rows]
    whole = Image.new("RGB", (max(map(len, rows)) * (WIDTH + GAP) - GAP, sum(heights) - GAP), "white")
    for number, row in enumerate(rows):
        for column, each in enumerate(row):
            whole.paste(each, (column * (WIDTH + GAP), sum(heights[:number])))
    return whole


def print_errors(parameters: list[dict]) -> None:
    """Before and after, of each part; of cameras the means, and of the worst."""
    for each in parameters:
        kind = "chamfer" if "chamfer" in each else "rmse"
        if "pose_error" not in each:
            print(f"{each['name']}: {kind} {each[f'{kind}_before']:.4f} before, {each[kind]:.4f} after")
    for key, name in (("pose_error_before", "before"), ("pose_error", "after")):
        angles, distances = zip(*((each[key]["angle"], each[key]["distance"]) for each in parameters if key in each))
        print(f"cameras {name}: mean {mean(angles):.3f} degrees, {mean(distances):.4f}; at most {max(angles):.3f} degrees, "
              f"{max(distances):.4f}")


def main(run: Path) -> None:
    truth, found = rb.load(FIGURINE / "on_board.xml"), rb.load(run / "scene" / "scene.xml")
    setattr(found, VIEW, getattr(truth, VIEW))
    pixels = body_pixels(truth) | body_pixels(found)
    photographs = [picture(read_image(run / "images" / f"{view}_{role}.exr").movedim(-1, 0)) for view in VIEWS
                   for role in ("before", "target", "after")]
    maps = [resized(Image.open(run / "textures" / f"{name}_{role}.png").convert("RGB")) for name in MAPS
            for role in ("recovered", "true")]
    relit = []
    for sky in SKIES:
        target = read_image(FIGURINE / f"under_{sky}.exr").movedim(-1, 0)
        image = under_sky(found, sky)
        everywhere = psnr(image, target, torch.ones_like(pixels))
        print(f"{sky}: PSNR {everywhere:.1f} dB, of the figurine {psnr(image, target, pixels):.1f} dB; with the true one "
              f"{psnr(under_sky(truth, sky), target, pixels):.1f} dB")
        relit += [picture(target), picture(image)]
    sheet([photographs, maps, relit]).save(ASSETS / "pictures" / "figurine_joint.png", optimize=True)
    print_errors(json.loads((run / "summary.json").read_text())["parameters"])


if __name__ == "__main__":
    main(Path(sys.argv[1]))
