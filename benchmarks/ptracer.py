"""Time and memory of paths from lamps, beside Mitsuba's `ptracer`: ``python -m benchmarks.ptracer`` (needs mitsuba==3.9.1).

Three scenes, 128 x 128 pixels, depth 4: a box under a point light, by the box's colour; the plate of glass of
`benchmarks.caustic`, by its heights (a bump map in both renderers); a square lamp before rough metal, by its roughness. Both
renderers trace ``--spp`` paths a pixel in images, and in derivatives. Mitsuba differentiates its `ptracer` by a tape, which
grows with the number of paths; our memory does not. Each side runs in a process of its own: a pass that compiles, then the
peak of resident memory during a pass, over what was resident before, then ``--rounds`` passes. Processes of the two take
turns; times are medians of all passes. The last columns are ours over Mitsuba's. Run it on an idle machine.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import time
import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
import torch

import torch_radbp as rb
from benchmarks.peers import mitsuba_for, translated
from benchmarks.resident import MIB, peak_of
from benchmarks.scenes.caustic import GLASS, PIXELS, grey, plate_scene, rectangle

PLATE, TURNS = 512, 5
KEYS = {"box": "box.bsdf.reflectance.value", "plate": "top.bsdf.nested_texture.data", "metal": "metal.bsdf.alpha.value"}


def description(name: str, heights: Any) -> dict[str, Any]:
    """A scene in Mitsuba's vocabulary."""
    if name == "plate":
        texture = {"type": "bitmap", "data": heights, "raw": True, "wrap_mode": "clamp"}
        return plate_scene(rectangle(0, True, 1, bsdf={"type": "bumpmap", "texture": texture, "bsdf": GLASS}))
    film = {"type": "hdrfilm", "width": PIXELS, "height": PIXELS, "rfilter": {"type": "gaussian"}, "pixel_format": "rgb"}
    eye = rb.look_at([3, 3, 4], [0, 0, 0], up=[0, 1, 0]).numpy()
    white = {"type": "diffuse", "reflectance": grey(0.7)}
    scene = {"type": "scene", "integrator": {"type": "ptracer", "max_depth": 4},
             "sensor": {"type": "perspective", "fov": 45.0, "to_world": eye, "film": film},
             "floor": rectangle(-1, True, 5, bsdf=white)}
    if name == "box":
        return scene | {"box": {"type": "cube", "to_world": np.diag([0.6, 0.6, 0.6, 1.0]), "bsdf": white},
                        "lamp": {"type": "point", "position": [1.0, 3.0, 1.0], "intensity": grey(10.0)}}
    metal = {"type": "roughconductor", "material": "none", "distribution": "ggx", "alpha": 0.3}
    return scene | {"metal": {"type": "sphere", "bsdf": metal},
                    "lamp": rectangle(3, False, 0.5, emitter={"type": "area", "radiance": grey(10.0)})}


def our_passes(name: str, spp: int) -> tuple[Callable[[int], object], ...]:
    """An image; an image and its derivative; what gives memory back before it is measured."""
    scene = rb.load_dict(description(name, torch.zeros(PLATE, PLATE, 1)))
    renderer = rb.Renderer(scene, spp=spp)
    parameter = dict(scene.named_parameters())[KEYS[name]]

    def image(seed: int) -> object:
        with torch.no_grad():
            return renderer(seed=seed)

    def both(seed: int) -> object:
        parameter.requires_grad_().grad = None
        renderer(seed=seed).square().mean().backward()
        return parameter.grad

    return image, both, lambda seed: seed


def their_passes(name: str, spp: int) -> tuple[Callable[[int], object], ...]:
    """The same by Mitsuba."""
    mi = mitsuba_for("cpu")
    import drjit as dr

    flat = mi.TensorXf(np.zeros((PLATE, PLATE, 1), np.float32))
    scene = mi.load_dict(translated(mi, description(name, flat)), optimize=False)
    parameters = mi.traverse(scene)
    key = KEYS[name]

    def image(seed: int) -> object:
        found = mi.render(scene, spp=spp, seed=seed)
        dr.eval(found)
        dr.sync_thread()
        return found

    def alone(seed: int) -> object:
        dr.flush_malloc_cache()  # what earlier passes have left to be used again counts when it is taken
        return seed

    def both(seed: int) -> object:
        dr.enable_grad(parameters[key])
        parameters.update()
        dr.backward(dr.mean(dr.square(mi.render(scene, parameters, spp=spp, spp_grad=spp, seed=seed)), axis=None))
        gradient = dr.grad(parameters[key])
        dr.eval(gradient)
        dr.sync_thread()
        return gradient

    return image, both, alone


def measured(side: str, name: str, spp: int, rounds: int) -> dict[str, Any]:
    """Seconds of passes and bytes of one, in this process."""
    warnings.simplefilter("ignore")
    found = {}
    *passes, free = (our_passes if side == "ours" else their_passes)(name, spp)
    for what, run in zip(("forward", "both"), passes):
        run(0)
        free(0)
        found[f"{what} bytes"] = peak_of(lambda: run(1))  # noqa: B023
        found[what] = []
        for seed in range(rounds):
            start = time.perf_counter()
            run(2 + seed)
            found[what].append(time.perf_counter() - start)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", nargs="*", default=[*KEYS], choices=KEYS)
    parser.add_argument("--spp", type=int, default=32, help="paths a pixel")
    parser.add_argument("--rounds", type=int, default=3, help="passes of a process")
    parser.add_argument("--turns", type=int, default=TURNS, help="processes of each side")
    parser.add_argument("--side", choices=("ours", "Mitsuba"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.side:
        print(json.dumps(measured(options.side, options.scenes[0], options.spp, options.rounds)))
        return
    print("| scene | pass | ours | Mitsuba | ours: MiB | Mitsuba | time | memory |", "|---" * 8 + "|", sep="\n")
    for name in options.scenes:
        runs: dict[str, list[dict]] = {"ours": [], "Mitsuba": []}
        for _ in range(options.turns):
            for side, found in runs.items():
                command = [sys.executable, "-m", "benchmarks.ptracer", "--scenes", name, "--side", side,
                           "--spp", str(options.spp), "--rounds", str(options.rounds)]
                done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
                found.append(json.loads(done.stdout.splitlines()[-1]))
        for what in ("forward", "both"):
            seconds = [statistics.median(each for run in found for each in run[what]) for found in runs.values()]
            memory = [statistics.median(run[f"{what} bytes"] for run in found) / MIB for found in runs.values()]
            print(f"| {name} | {what} | {seconds[0]:.3f} s | {seconds[1]:.3f} s | {memory[0]:.0f} | {memory[1]:.0f} | "
                  f"{seconds[0] / seconds[1]:.2f} | {memory[0] / memory[1]:.2f} |", flush=True)


if __name__ == "__main__":
    main()
