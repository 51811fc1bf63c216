"""Derivatives of participating media against differences: ``python -m benchmarks.media_derivatives``.

Each row of `tests/scenes/media_rows.py` is a scene and a parameter. The gradient of one functional of a tiny image is
compared, entry by entry, with finite differences of that functional, whose samples are others: central ones, to one side
where the parameter is at the end of its range. Of poses directions are compared instead of entries. A row holds

    n        entries
    error    |gradient - differences| over |differences|, of the whole vector
    noise    what of it standard errors explain, over independent batches
    z        the worst entry in standard errors, and the bound that chance exceeds as rarely as 3.5 for one entry
    verdict  right: error of at most 3%; within 3.5 standard errors: error above that, but z within the bound; wrong:
             neither; not known: not wrong, but noise above 3%

Batches are added until the noise is below ``--noise``, for at most ``--seconds``. ``--mitsuba`` adds the gradient of
`prbvolpath` (mitsuba==3.9.1), compared with the same differences, and its size along them, 1 where it is right; poses are
not compared. What Mitsuba raises is printed in place of its verdict.

    python -m benchmarks.media_derivatives --only "smoke;fog" --seconds 60
    python -m benchmarks.media_derivatives --mitsuba
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections import Counter

import numpy as np
import torch

from benchmarks.peers import mitsuba_for
from tests.medium.differences import CLOSE, FEWEST, Batches, Comparison, Experiment
from tests.scenes.media_rows import PARAMETERS, Row, rows, scene_of

HEADER = ["scene: parameter", "n", "error", "noise", "z (bound)", "verdict"]


class Peer:
    """The same gradient by Mitsuba's `prbvolpath`."""

    def __init__(self, experiment: Experiment):
        self.mi, self.experiment = mitsuba_for("cpu"), experiment
        import drjit as dr

        self.dr = dr
        self.scene = self.mi.load_dict(translated(self.mi, scene_of(experiment.row)))
        self.parameters = self.mi.traverse(self.scene)
        end = experiment.name.removeprefix("air.").replace(".interior.", ".interior_medium.")
        self.name = min((name for name in self.parameters.keys() if name.endswith(end)), key=len)
        self.integrator = self.mi.load_dict({"type": "prbvolpath", "max_depth": experiment.row.depth,
                                             "rr_depth": experiment.renderer.rr_depth})
        self.cotangent = self.mi.TensorXf(experiment.cotangent[0].permute(1, 2, 0).contiguous().numpy())
        self.gradients = Batches()

    def add_batch(self) -> None:
        """Renders a batch more."""
        dr, seed = self.dr, 2 * len(self.gradients.values)
        leaf = type(self.parameters[self.name])(dr.detach(self.parameters[self.name]))
        dr.enable_grad(leaf)
        self.parameters[self.name] = leaf
        self.parameters.update()
        image = self.mi.render(self.scene, self.parameters, integrator=self.integrator, spp=self.experiment.spp, seed=seed,
                               seed_grad=seed + 1)
        dr.backward(dr.sum(image * self.cotangent, axis=None))
        self.gradients.values.append(torch.from_numpy(np.array(dr.grad(leaf), dtype=np.float64)).flatten())

    def comparison(self) -> Comparison:
        """With the differences of the experiment."""
        found = self.experiment.comparison()
        return found._replace(gradient=self.gradients.mean(), gradient_error=self.gradients.error())


def translated(mi, described: dict) -> dict:
    """The description in Mitsuba's own types."""
    found = {}
    for key, value in described.items():
        if isinstance(value, dict):
            value = translated(mi, value)
            if key == "sigma_t" and value["type"] == "rgb":  # which it takes for a reflectance, at most 1
                value = {"type": "constvolume", "value": value}
        elif key == "to_world":
            value = mi.ScalarTransform4f(np.asarray(value))
        elif key in ("data", "bitmap"):
            values = np.ascontiguousarray(value, dtype=np.float32)
            grid = described["type"] == "gridvolume"
            key, value = ("grid", mi.VolumeGrid(values)) if grid else ("bitmap", mi.Bitmap(values))
            found |= {"raw": True} if grid else {}
        found[key] = value
    return found


def cells(found: Comparison) -> list[str]:
    return [f"{found.error:.3f}", f"{found.noise:.3f}", f"{found.z:.1f} ({found.bound:.1f})", found.verdict]


def measured(row: Row, options: argparse.Namespace) -> tuple[list[str], list[str]]:
    """The cells of a row, and the verdicts of both."""
    experiment = Experiment(row, options.spp, options.seed)
    run(experiment, options)
    found = experiment.comparison()
    line, verdicts = [str(row), str(len(found.gradient)), *cells(found)], [found.verdict]
    if options.mitsuba and not PARAMETERS[row.parameter].poses:
        try:
            peer = Peer(experiment)
            run(peer, options)
        except RuntimeError as error:  # which all of Mitsuba's own errors are
            return [*line, "", "", "", "", f"fails: {' '.join(str(error).split())[-160:]}"], [*verdicts, "fails"]
        theirs = peer.comparison()
        along = float((theirs.gradient * theirs.difference).sum()) / theirs.size**2
        line, verdicts = [*line, f"{along:.3f}", *cells(theirs)], [*verdicts, theirs.verdict]
    return line, verdicts


def run(side: Experiment | Peer, options: argparse.Namespace) -> None:
    """Adds batches until there is little noise, or no more time; the first is not timed."""
    side.add_batch()
    start = time.perf_counter()
    while len(side.gradients.values) < FEWEST or (
            side.comparison().noise > options.noise and time.perf_counter() - start < options.seconds):
        side.add_batch()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="parts of names, with semicolons between")
    parser.add_argument("--spp", type=int, default=512, help="samples a pixel of a batch")
    parser.add_argument("--seconds", type=float, default=12, help="of a row and a renderer, at most")
    parser.add_argument("--noise", type=float, default=0.5 * CLOSE, help="that is enough")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--mitsuba", action="store_true", help="prbvolpath's gradients, too")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    header = HEADER + ["prbvolpath's size", *(f"its {name}" for name in HEADER[2:])] * options.mitsuba
    print(f"| {' | '.join(header)} |\n|{'---|' * len(header)}", flush=True)
    counts = Counter(), Counter()
    for row in rows():
        if any(part in str(row) for part in options.only.split(";")):
            line, verdicts = measured(row, options)
            print(f"| {' | '.join(line)} |", flush=True)
            for count, verdict in zip(counts, verdicts):
                count[verdict] += 1
    for name, count in zip(("ours", "prbvolpath"), counts):
        if count:
            print(f"{name}: {count.total()} rows, " + ", ".join(f"{number} {verdict}" for verdict, number in count.items()))


if __name__ == "__main__":
    main()
