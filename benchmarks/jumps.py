"""Each kind of jump of an image, its derivative beside its difference, on one sheet: ``python -m benchmarks.jumps``.

For every kind a scene is drawn in which little else moves: the image, its derivative by forward mode, and the finite
difference of two images of the same samples, which are others than those of the derivative. Red is where the image becomes
brighter, blue where darker; both have one scale. It writes jumps.png, with some of them
jumps_in_short.png and jumps_in_rows.png, and prints

    off by    |derivative - difference| over |difference|, each summed over pixels and channels
    noise     what of it the standard errors explain alone

``--only "mirror,glass"`` draws kinds by parts of their names, into a folder that ``--out`` names.
"""

from __future__ import annotations

import argparse
import math
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from PIL import Image
from torch import Tensor

import torch_radbp as rb
from benchmarks.sheet import PANEL, derivative_panels, write_sheet
from tests.derivatives.in_expectation import Effort, Estimate
from tests.scenes import diffuse, inner_jumps, mirrors, moving, sensor, shadows
from tests.scenes.meshes import POSE, ball
from tests.scenes.moving import TWIST, MovingScene, constant, rigid, scene
from tests.scenes.projected import PROJECTOR, SMOOTH
from torch_radbp.formats.image import linear_to_srgb
from torch_radbp.io.values.transform import rotate, scale, translate

SIZE = PANEL // 2  # pixels of an image
PICTURES = Path("assets/pictures")
IN_SHORT = ("silhouette", "soft shadow", "edge in a mirror")
COLUMNS = 3  # kinds side by side
FILM = {"film": {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "box"}}}
FLOOR_ALONE = sensor(SIZE, (0.3, -1.0, 0.9), (0.1, 0.0, 0.0), 36)


def seen_by(view: dict[str, Any], **objects: Any) -> Callable[[], rb.Scene]:
    """Objects before a sensor of more pixels than it has in tests."""
    return scene(sensor=view | FILM, **objects)


def hybrid(build: Callable[[], rb.Scene], name: str, direction: Callable[[Tensor], Tensor], step: float,
           max_depth: int = 2) -> MovingScene:
    """A moving scene with the default sampling alone."""
    return MovingScene(build, name, direction, step, max_depth, ("hybrid",))


def jumps() -> dict[str, MovingScene]:
    """A moving scene of each kind."""
    view, floor, plate = shadows.VIEWED, {"floor": shadows.FLOOR}, {"plate": shadows.PLATE}
    push, lamps = shadows.PUSH, shadows.LAMPS
    smaller = inner_jumps.LEAF["opacity"] | {"to_uv": scale((2.5, 2.5, 1))}
    leaf = inner_jumps.CUT_OUT | {"bsdf": inner_jumps.LEAF | {"opacity": smaller}}
    sky, near = moving.SKY, moving.camera()
    wall = {"wall": shadows.WALL, "lamp": shadows.SPOT_ASIDE, "plate": shadows.PLATE | {
        "to_world": translate((0.1, 0.65, 0.6)) @ rotate((1, 0.3, 0.2), 65) @ scale((0.4, 0.3, 1))}}
    return {
        "silhouette": hybrid(seen_by(near, solid=moving.SOLID, **sky), "solid.to_world", rigid(TWIST), 0.003),
        "rim of a smooth mesh": hybrid(seen_by(near, ball=ball(1) | {"to_world": POSE, "bsdf": diffuse(0.8, 0.6, 0.4)},
                                               **sky), "ball.to_world", rigid(TWIST), 0.003),
        "crease": hybrid(seen_by(near, book=moving.BOOK, **moving.POINT), "sensor.to_world",
                         rigid(TWIST, (0.5, -0.4, 2.6)), 0.0005),
        "hard shadow": hybrid(seen_by(view, **floor, **plate, lamp=lamps["point"]), "lamp.position",
                              constant(0.4, 0.3, 0.5), 0.02),
        "soft shadow": hybrid(seen_by(view, **floor, **plate, lamp=lamps["rectangle"]), "lamp.to_world", push["lamp"], 0.02),
        "shadow of indirect light": hybrid(seen_by(FLOOR_ALONE, **floor, **wall), "plate.to_world", push["plate"], 0.05, 3),
        "line of a texture": hybrid(seen_by(inner_jumps.VIEWED, **inner_jumps.patterned(inner_jumps.CHECKERBOARD),
                                            sky=inner_jumps.SKY), "floor.to_world", inner_jumps.PUSH, 0.003),
        "cut-out of a mask": hybrid(seen_by(inner_jumps.VIEWED, leaf=leaf, sky=inner_jumps.SKY),
                                    "leaf.to_world", inner_jumps.PUSH, 0.002),
        "surfaces that cross": hybrid(seen_by(inner_jumps.VIEWED, **inner_jumps.CROSSING, lamp=inner_jumps.POINT),
                                      "one.to_world", inner_jumps.PUSH, 0.005),
        "edge in a mirror": hybrid(seen_by(mirrors.IN_MIRROR, mirror=mirrors.MIRROR, cube=mirrors.CUBE,
                                           sky=mirrors.SKY), "cube.to_world", mirrors.PUSH["cube"], 0.004, 4),
        "edge through glass": hybrid(seen_by(mirrors.VIEWED, lens=mirrors.LENS, cube=mirrors.CUBE,
                                             sky=mirrors.SKY), "cube.to_world", mirrors.PUSH["cube"], 0.005, 5),
        "border of a projector": hybrid(seen_by(view, **floor, lamp=PROJECTOR | {"irradiance": SMOOTH}), "lamp.to_world",
                                        push["lamp"], 0.0015),
    }


def picture(image: Tensor) -> Image.Image:
    """(1, 3, H, W) linear RGB as a panel, its brightest parts white."""
    shown = linear_to_srgb(image[0] / torch.quantile(image, 0.995)).permute(1, 2, 0)
    return Image.fromarray((255 * shown.clamp(0, 1) + 0.5).byte().numpy()).resize((PANEL, PANEL), Image.Resampling.NEAREST)


def drawn(example: MovingScene, effort: Effort, rounds: int) -> tuple[list[Image.Image], float, float]:
    """Image, derivative and difference of a scene; how far the latter are apart; and the noise of that."""
    estimate = Estimate(example, effort)
    for _ in range(rounds):
        estimate.add_round()
    found = estimate.checks()
    (result,) = found.values()
    difference, derivative = derivative_panels(found)
    size = result.comparison.difference.abs().sum()
    apart = (result.comparison.jvp - result.comparison.difference).abs().sum() / size
    noise = math.sqrt(2 / math.pi) * result.comparison.standard_error.sum() / size
    image = rb.render(example.build(), spp=effort.spp * effort.batches, seed=10**6, max_depth=example.max_depth)
    return [picture(image.detach()), derivative, difference], float(apart), float(noise)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--spp", type=int, default=64, help="samples per pixel of a batch in a round")
    parser.add_argument("--batches", type=int, default=16)
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="parts of names, with commas between")
    parser.add_argument("--out", type=Path, default=PICTURES, help="the folder of the pictures")
    options = parser.parse_args()
    warnings.simplefilter("ignore", rb.SilhouetteWarning)  # of edges that surfaces see in mirrors and glass, which are dim
    chosen = {name: example for name, example in jumps().items() if any(part in name for part in options.only.split(","))}
    panels: dict[str, list[Image.Image]] = {}
    print("| jump | off by | noise | seconds |\n|---|---|---|---|")
    for name, example in chosen.items():
        start = time.perf_counter()
        panels[name], apart, noise = drawn(example, Effort(options.spp, options.batches, options.seed, backward=False),
                                           options.rounds)
        print(f"| {name} | {apart:.3f} | {noise:.3f} | {time.perf_counter() - start:.0f} |", flush=True)
    in_short = [name for name in IN_SHORT if name in panels]
    sheets = {"jumps.png": ([*panels], COLUMNS), "jumps_in_short.png": (in_short, COLUMNS),
              "jumps_in_rows.png": (in_short, 1)}
    for file, (names, columns) in sheets.items():
        if names:
            rows = [(f"{name}: image, derivative, difference", panels[name]) for name in names]
            write_sheet(options.out / file, rows, columns)


if __name__ == "__main__":
    main()
