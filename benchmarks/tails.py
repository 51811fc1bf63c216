"""How often derivatives are large, beside Mitsuba's: ``python -m benchmarks.tails`` (needs mitsuba==3.9.1 and LLVM).

Where a parameter matters to few paths, and to these very much, one pass in a hundred may hold most of the variance of all,
and the ratio of two variances tells nothing (`noise.py`). So here single samples are counted: of derivative images of one
sample a pixel by forward mode, `rb.jvp` and ``prb`` in ``llvm_ad_rgb`` (``dr.forward``), in how many pixels the derivative,
the sum over channels, is greater than a number. The direction is that in which all entries of the parameter grow alike.
"""

from __future__ import annotations

import argparse
import tempfile
import warnings
from pathlib import Path

import numpy as np
import torch
from rich.progress import track

import torch_radbp as rb
from benchmarks.forward_mode import MitsubaTangents
from benchmarks.scenes import ALL
from benchmarks.scenes.description import NO_ROULETTE
from torch_radbp.rendering.jvp import rendering_with_tangent

LIMITS = (1, 2, 4, 8, 16, 32, 64)
PARAMETERS = ("material_18.roughness.value", "material_11.roughness.data")


def counts(derivatives: np.ndarray) -> list[int]:
    """How many are greater than each of `LIMITS`, whatever their sign."""
    return [int((np.abs(derivatives) > limit).sum()) for limit in LIMITS]


def row(who: str, parameter: str, derivatives: np.ndarray) -> str:
    """The line of the table for the derivatives of one renderer."""
    error = derivatives.std() / len(derivatives) ** 0.5
    cells = [f"`{parameter}`", who, f"{derivatives.mean():.5f} +- {error:.5f}", f"{derivatives.var():.5f}",
             *map(str, counts(derivatives)), f"{np.abs(derivatives).max():.0f}"]
    return f"| {' | '.join(cells)} |"


def measure(name: str, parameter: str, resolution: int, rounds: int) -> dict[str, np.ndarray]:
    """The derivatives of all pixels of all rounds, of either renderer."""
    make, setting = ALL[name]
    with tempfile.TemporaryDirectory() as folder:
        described = make(Path(folder), setting._replace(resolution=resolution, spp=1))
        scene = described.load().requires_grad_(False)
        tangent = torch.ones_like(scene.get_parameter(parameter))
        theirs = MitsubaTangents(described, parameter, tangent)
    renderer = rb.Renderer(scene, spp=1, max_depth=described.setting.max_depth, rr_depth=NO_ROULETTE, share_samples=True,
                           terms=["interior"])
    found: dict[str, list[np.ndarray]] = {"ours": [], "Mitsuba's": []}
    for seed in track(range(rounds), parameter, transient=True):
        ours = rendering_with_tangent(renderer, {parameter: tangent}, seed).tangent[0]
        found["ours"].append(ours.sum(0).flatten().double().numpy())
        theirs.derivative(seed)
        found["Mitsuba's"].append(np.array(theirs.tangent_image).sum(2, dtype=np.float64).ravel())
    return {who: np.concatenate(parts) for who, parts in found.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", choices=ALL, default="principled-interior")
    parser.add_argument("--parameter", nargs="+", default=list(PARAMETERS))
    parser.add_argument("--resolution", type=int, default=256, help="pixels a side")
    parser.add_argument("--rounds", type=int, default=120)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    print("| parameter | whose | mean | variance | " + " | ".join(f"> {limit}" for limit in LIMITS) + " | greatest |\n"
          + "|---" * (5 + len(LIMITS)) + "|", flush=True)
    for parameter in options.parameter:
        for who, derivatives in measure(options.scene, parameter, options.resolution, options.rounds).items():
            print(row(who, parameter, derivatives), flush=True)


if __name__ == "__main__":
    main()
