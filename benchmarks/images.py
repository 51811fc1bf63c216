"""Both renderers' images of the scenes, to be looked at: ``python -m benchmarks.images FOLDER`` (needs mitsuba==3.9.1).

Prints the mean of each image, and the difference of the means in standard errors; these are estimated from independent
renderings.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import torch

import torch_radbp as rb
from benchmarks.peers import Mitsuba, Ours
from benchmarks.scenes import SCENES

RENDERINGS = 8


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="the images go there, as PNG")
    parser.add_argument("--scene", choices=SCENES, nargs="+", default=list(SCENES))
    parser.add_argument("--spp", type=int, default=32, help=f"samples per pixel of each of {RENDERINGS} renderings")
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    for name in options.scene:
        make, setting = SCENES[name]
        with tempfile.TemporaryDirectory() as folder:
            scene = make(Path(folder), setting)
            found = {}
            for peer, renderer in {"ours": Ours(scene, compiled=True), "mitsuba": Mitsuba(scene)}.items():
                images = torch.stack([renderer.image(options.spp, seed) for seed in range(RENDERINGS)])
                rb.save_image(options.folder / f"{name}_{peer}.png", images.mean(0))
                found[peer] = images.mean((1, 2, 3)).double()
            (a, b), (e, f) = zip(*((means.mean(), means.std() / RENDERINGS**0.5) for means in found.values()))
            print(f"{name:20} mean {a:.5f} (ours) {b:.5f} (Mitsuba), z {(a - b) / torch.hypot(e, f):+.1f}", flush=True)


if __name__ == "__main__":
    main()
