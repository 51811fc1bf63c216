"""Noise in a room of many small lamps: ``python -m benchmarks.lamps`` (``--mitsuba`` needs mitsuba==3.9.1 and LLVM).

Lamps hang under the ceiling and stand about in the room; every fourth is five times as bright, and the room gets about as
much light however many there are. Lights are picked uniformly and by the tree (`Renderer.light_choice`), and perhaps by
Mitsuba (``llvm_ad_rgb``), with equally many samples. Time is that of the CPU, the least of the rounds; noise is the squared
difference from a reference with many samples, as mean and as median over the pixels. Lamps themselves are not shown: their
edges in the image would be most of the noise.

"equal time" is noise times time beside that of the uniform choice: below 1 the way is better.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import torch

import torch_radbp as rb
from torch_radbp.pose import look_at

LAMPS = (2, 4, 8, 16, 64, 1000)
SPP, REFERENCE_SPP, ROUNDS, SIZE, DEPTH = 16, 2048, 5, 64, 4
KINDS = ("area", "mixed")
HALF = 4.0  # of the room's length, whose height is 3


class Result(NamedTuple):
    """What one way of picking lights gives."""

    seconds: float  # for an image
    mean: float  # squared error over the pixels
    median: float


def pose(at: np.ndarray, towards: np.ndarray, size: float = 1.0) -> np.ndarray:
    """(4, 4): +z from a place along a direction, the other axes scaled."""
    matrix = look_at(torch.as_tensor(at, dtype=torch.float64), torch.as_tensor(at + towards, dtype=torch.float64)).numpy()
    return matrix @ np.diag([size, size, 1.0, 1.0])


def rgb(*values: float) -> dict[str, Any]:
    return {"type": "rgb", "value": list(map(float, values))}


def room(lamps: int, kind: str, spp: int) -> dict[str, Any]:
    """The room in Mitsuba's vocabulary; transforms are arrays."""
    random = np.random.default_rng(0)
    film = {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "box"}, "pixel_format": "rgb"}
    eye = look_at([3.6, 1.2, 1.5], [-1.0, -1.0, 1.2], [0, 0, 1]).numpy()
    scene: dict[str, Any] = {
        "type": "scene", "integrator": {"type": "path", "max_depth": DEPTH, "rr_depth": 100, "hide_emitters": True},
        "camera": {"type": "perspective", "fov": 70.0, "to_world": eye,
                   "film": film, "sampler": {"type": "independent", "sample_count": spp}},
        "block": {"type": "cube", "to_world": np.array([[0.5, 0, 0, 0], [0, 0.5, 0, -1], [0, 0, 0.6, 0.6], [0, 0, 0, 1]]),
                  "bsdf": {"type": "diffuse", "reflectance": rgb(0.5, 0.5, 0.5)}}}
    for number, (at, normal) in enumerate([((0, 0, 0), (0, 0, 1)), ((0, 0, 3), (0, 0, -1)), ((-HALF, 0, 1.5), (1, 0, 0)),
                                           ((HALF, 0, 1.5), (-1, 0, 0)), ((0, -HALF, 1.5), (0, 1, 0)),
                                           ((0, HALF, 1.5), (0, -1, 0))]):
        colour = np.roll([0.7, 0.6, 0.4], number)
        scene[f"wall_{number}"] = {"type": "rectangle", "to_world": pose(np.array(at, float), np.array(normal, float), HALF),
                                   "bsdf": {"type": "diffuse", "reflectance": rgb(*colour)}}
    for number in range(lamps):
        at = random.uniform((-3.8, -3.8, 2.2 if number % 2 else 0.05), (3.8, 3.8, 2.9))
        towards, colour = random.normal(size=3), random.uniform(0.2, 1, 3) * random.choice([1, 1, 1, 5]) * 600 / lamps
        scene[f"lamp_{number}"] = lamp(kind if kind == "area" else ("area", "point", "spot")[number % 3], at,
                                       towards / np.linalg.norm(towards), colour)
    return scene


def lamp(kind: str, at: np.ndarray, towards: np.ndarray, colour: np.ndarray) -> dict[str, Any]:
    """One lamp; of a square, six centimetres wide if the room is eight metres long."""
    if kind == "area":
        return {"type": "rectangle", "to_world": pose(at, towards, 0.03), "bsdf": {"type": "diffuse", "reflectance": 0.0},
                "emitter": {"type": "area", "radiance": rgb(*(20 * colour))}}
    if kind == "point":
        return {"type": "point", "position": at.tolist(), "intensity": rgb(*(0.07 * colour))}
    return {"type": "spot", "to_world": pose(at, towards), "cutoff_angle": 40.0, "intensity": rgb(*(0.07 * colour))}


def ours(description: dict[str, Any], light_choice: str) -> Callable[[int, int], np.ndarray]:
    """Renders with a seed and a number of samples, (H, W, 3)."""
    renderer = rb.Renderer(rb.load_dict(description), light_choice=light_choice)

    def render(seed: int, spp: int) -> np.ndarray:
        with torch.no_grad():
            return renderer(seed=seed, spp=spp)[0].permute(1, 2, 0).numpy()

    return render


def mitsubas(description: dict[str, Any]) -> Callable[[int, int], np.ndarray]:
    """The same by Mitsuba."""
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")

    def translated(value):
        if isinstance(value, dict):
            return {key: translated(part) for key, part in value.items()}
        return mi.ScalarTransform4f(value) if isinstance(value, np.ndarray) else value

    scene = mi.load_dict(translated(description))
    return lambda seed, spp: np.array(mi.render(scene, seed=seed, spp=spp))


def measured(render: Callable[[int, int], np.ndarray], reference: np.ndarray) -> Result:
    """Time and noise of images."""
    render(999, SPP)
    seconds, errors = [], []
    for seed in range(ROUNDS):
        start = time.process_time()
        image = render(seed, SPP)
        seconds.append(time.process_time() - start)
        errors.append((image - reference) ** 2)
    error = np.mean(errors, 0)
    return Result(min(seconds), float(error.mean()), float(np.median(error)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--lamps", type=int, nargs="*", default=LAMPS)
    parser.add_argument("--kinds", nargs="*", default=KINDS, choices=KINDS)
    parser.add_argument("--mitsuba", action="store_true", help="render with Mitsuba, too")
    options = parser.parse_args()
    torch.set_num_threads(1)
    print(f"{'lamps':>5} {'kind':<6} {'lights picked by':<17} {'seconds':>8} {'noise: mean':>12} {'median':>9} "
          f"{'equal time: mean':>17} {'median':>7}")
    for kind in options.kinds:
        for lamps in options.lamps:
            description = room(lamps, kind, SPP)
            ways = {way: ours(description, way) for way in ("uniform", "tree")}
            reference = ways["tree"](10_000, REFERENCE_SPP)
            if options.mitsuba:
                ways["Mitsuba"] = mitsubas(description)
            results = {way: measured(render, reference) for way, render in ways.items()}
            base = results["uniform"]
            for way, found in results.items():
                cells = [found.seconds * getattr(found, each) / (base.seconds * getattr(base, each))
                         for each in ("mean", "median")]
                print(f"{lamps:>5} {kind:<6} {way:<17} {found.seconds:>8.3f} {found.mean:>12.2e} {found.median:>9.2e} "
                      f"{cells[0]:>17.2f} {cells[1]:>7.2f}", flush=True)


if __name__ == "__main__":
    main()
