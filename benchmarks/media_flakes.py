"""Light that flakes scatter, by four programs: ``python -m benchmarks.media_flakes`` (needs mitsuba==3.9.1 and LLVM).

A ball of `sggx` under a sky, see `tests/scenes/flakes.py`: means of its image by a simulation that shares nothing with ours,
by ours, and by Mitsuba's `volpath` and `volpathmis`, each with its standard error. Below, the mean direction after a
scattering of Mitsuba's `sggx`, by what it samples, by the density that it tells, and by our density: but for light along z
its samples have another mean than its density.
"""

from __future__ import annotations

import argparse
import statistics
import tempfile
import warnings
from pathlib import Path

import numpy as np
import torch

import torch_radbp as rb
from benchmarks.peers import mitsuba_for
from tests.scenes.flakes import FLAKES, ball, simulated, sky_pixels
from torch_radbp.tensors.vec import Vec3

BATCHES, WIDTH = 16, 16
ASIDE = (0.0, 0.0, 1.0), (0.6, 0.0, 0.8), (0.48, 0.6, 0.64), (1.0, 0.0, 0.0)


def spread(means: list[float]) -> tuple[float, float]:
    """The mean of all, and its standard error."""
    return statistics.fmean(means), statistics.stdev(means) / len(means)**0.5


def theirs(mi, phase, depth: int, name: str, spp: int) -> tuple[float, float]:
    described = ball(WIDTH, depth)
    described["camera"]["to_world"] = mi.ScalarTransform4f().look_at(origin=(0, 0, 4), target=(0, 0, 0), up=(0, 1, 0))
    described["ball"]["interior"]["phase"] = phase
    sky = {"type": "envmap", "bitmap": mi.Bitmap(sky_pixels())}
    scene = mi.load_dict(described | {"integrator": {"type": name, "max_depth": depth, "rr_depth": 1000}, "sky": sky})
    return spread([float(np.array(mi.render(scene, spp=spp, seed=seed)).mean()) for seed in range(BATCHES)])


def ours(depth: int, spp: int) -> tuple[float, float]:
    scene = rb.load_dict(ball(WIDTH, depth) | {"sky": {"type": "envmap", "bitmap": sky_pixels()}})
    with torch.no_grad():
        return spread([float(rb.render(scene, spp=spp, seed=seed).mean()) for seed in range(BATCHES)])


def mean_directions(mi, phase, wi: tuple[float, float, float], samples: int) -> list[np.ndarray]:
    """The mean of what Mitsuba samples, that by its density, and that by ours."""
    import drjit as dr

    random = np.random.default_rng(0)
    at, ctx = dr.zeros(mi.MediumInteraction3f, samples), mi.PhaseFunctionContext()
    at.p, at.wi = mi.Point3f(0.5), mi.Vector3f(*wi)
    at.sh_frame = mi.Frame3f(at.wi)
    sampled = np.array(phase.sample(ctx, at, mi.Float(random.random(samples)), mi.Point2f(random.random((2, samples))))[0])
    even = random.normal(size=(3, samples))
    even /= np.linalg.norm(even, axis=0)
    density = np.array(phase.eval_pdf(ctx, at, mi.Vector3f(even))[1])
    flakes = rb.load_dict(ball(1, 2) | {"sky": {"type": "constant"}}).ball.interior.phase_function
    towards = [Vec3(*torch.from_numpy(np.broadcast_to(each, (3, samples)).astype(np.float32)))
               for each in (np.zeros((3, 1)), np.reshape(wi, (3, 1)), even)]
    value, _ = flakes.kind().eval_pdf(flakes.row(), *towards)
    return [sampled.mean(1), *(4 * np.pi * (even * each).mean(1) for each in (density, value.detach().numpy()))]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--depths", type=int, nargs="*", default=(2, 3, 16))
    parser.add_argument("--paths", type=float, default=4e6, help="of each program")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    mi = mitsuba_for("cpu")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "flakes.vol"
        mi.VolumeGrid(np.tile(np.float32(FLAKES), (1, 1, 1, 1))).write(str(path))
        grid = {"type": "gridvolume", "filename": str(path), "raw": True}
        grid["to_world"] = mi.ScalarTransform4f().translate(-1.0).scale(2.0)
        phase = {"type": "sggx", "S": grid}
        print("| depth | simulation | ours | volpath | volpathmis |\n|---|---|---|---|---|")
        spp = max(1, round(options.paths / BATCHES / WIDTH**2))
        for depth in options.depths:
            cells = [simulated(int(options.paths), depth, seed=depth), ours(depth, spp),
                     *(theirs(mi, phase, depth, name, spp) for name in ("volpath", "volpathmis"))]
            print(f"| {depth} | {' | '.join(f'{mean:.5f} +- {error:.5f}' for mean, error in cells)} |", flush=True)
        print("\n| light from | mean direction, sampled | by its density | by ours |\n|---|---|---|---|")
        loaded = mi.load_dict(phase)
        for wi in ASIDE:
            cells = [" ".join(f"{each:+.3f}" for each in mean) for mean in mean_directions(mi, loaded, wi, 10**6)]
            print(f"| {' '.join(map(str, wi))} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
