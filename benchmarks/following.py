"""How much noisier derivatives are by hybrid than by attached sampling: standard deviations per pixel over seeds.

    python -m benchmarks.following --roughness 0.05

Reads and needs nothing but the scenes of `tests/derivatives/noise.py`.
"""

from __future__ import annotations

import argparse
import warnings

import torch_radbp as rb
from tests.derivatives.noise import noise
from tests.scenes.rough import derivatives


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--roughness", type=float, default=0.05)
    parser.add_argument("--seeds", type=int, default=16)
    parser.add_argument("--spp", type=int, default=16)
    options = parser.parse_args()
    warnings.simplefilter("ignore", rb.SilhouetteWarning)
    print("| derivative | deviation / size: hybrid | attached | hybrid / attached |\n|---|---|---|---|")
    for name, derivative in derivatives(options.roughness).items():
        hybrid, attached = (noise(derivative, sampling, options.seeds, options.spp) for sampling in ("hybrid", "attached"))
        size = max(hybrid.size, attached.size) or float("nan")
        print(f"| {name} | {hybrid.deviation / size:.2f} | {attached.deviation / size:.2f} | "
              f"{hybrid.deviation / attached.deviation:.2f} |", flush=True)


if __name__ == "__main__":
    main()
