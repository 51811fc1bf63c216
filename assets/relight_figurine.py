"""Shows a figurine that `radbp optimize figurine_joint` has recovered under skies that no photograph shows.

    python assets/relight_figurine.py runs/figurine_joint      # prints PSNR, draws pictures/figurine_joint.png

What was recovered, shape and maps, is rendered with the true camera of a view and compared with Mitsuba's images of the true
figurine under the same sky: on the screen's scale, over all pixels, and over those in which either figurine is seen. Prints
errors of cameras, and of maps where both figurines have them, too.
"""

import json
import math
import sys
from pathlib import Path

import torch
from PIL import Image
from torch import Tensor

import torch_radbp as rb
from torch_radbp.formats.image import linear_to_srgb, read_image

ASSETS = Path(__file__).parent
FIGURINE, SKIES, VIEW, SPP = ASSETS / "figurine", ("dusk", "noon", "window"), "view_1", 512
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
    levels = (linear_to_srgb(image.clamp(0, 1)) * 255 + 0.5).byte().movedim(0, -1).numpy()
    return Image.fromarray(levels).resize((WIDTH, WIDTH), Image.Resampling.NEAREST)


def sheet(rows: list[list[Image.Image]]) -> Image.Image:
    """Pictures of one size in rows."""
    whole = Image.new("RGB", (max(map(len, rows)) * (WIDTH + GAP) - GAP, len(rows) * (WIDTH + GAP) - GAP), "white")
    for y, row in enumerate(rows):
        for x, each in enumerate(row):
            whole.paste(each, (x * (WIDTH + GAP), y * (WIDTH + GAP)))
    return whole


def main(run: Path) -> None:
    truth, found = rb.load(FIGURINE / "on_board.xml"), rb.load(run / "scene" / "scene.xml")
    setattr(found, VIEW, getattr(truth, VIEW))
    pixels = body_pixels(truth) | body_pixels(found)
    rows = [[picture(read_image(run / "images" / f"{view}_{role}.exr").movedim(-1, 0)) for view in ("view_1", "view_10")
             for role in ("before", "target", "after")]]
    relit = []
    for sky in SKIES:
        target = read_image(FIGURINE / f"under_{sky}.exr").movedim(-1, 0)
        image = under_sky(found, sky)
        everywhere = psnr(image, target, torch.ones_like(pixels))
        print(f"{sky}: PSNR {everywhere:.1f} dB, of the figurine {psnr(image, target, pixels):.1f} dB; with the true one "
              f"{psnr(under_sky(truth, sky), target, pixels):.1f} dB")
        relit += [picture(target), picture(image)]
    sheet([*rows, relit]).save(ASSETS / "pictures" / "figurine_joint.png", optimize=True)
    parameters = json.loads((run / "summary.json").read_text())["parameters"]
    poses = [each["pose_error"] for each in parameters if "pose_error" in each]
    before = [each["pose_error_before"] for each in parameters if "pose_error" in each]
    for name, errors in (("before", before), ("after", poses)):
        print(f"cameras {name}: mean {sum(each['angle'] for each in errors) / len(errors):.3f} degrees, "
              f"{sum(each['distance'] for each in errors) / len(errors):.4f}; at most "
              f"{max(each['angle'] for each in errors):.3f} degrees, {max(each['distance'] for each in errors):.4f}")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
