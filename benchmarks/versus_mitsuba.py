"""Time and gradients beside Mitsuba's: ``python -m benchmarks.versus_mitsuba`` (needs mitsuba==3.9.1 and LLVM).

Scenes of `benchmarks.scenes`, no Russian roulette. Mitsuba renders with ``prb`` in ``llvm_ad_rgb``, or, with
``--device cuda``, where both are on the GPU, in ``cuda_ad_rgb``; it and this renderer,
compiled or with ``--eager``, take turns within one process, one for each scene. Medians of the rounds are compared, and
beside them the CPU seconds of all threads, which other programs on the machine disturb less. As in training, the parameters
change a little before every pass, by the same factor on both sides, and what the scene makes of them belongs to the forward
pass. The first call compiles, ours and Mitsuba's (whose kernels of earlier runs, on disk, are out of its sight); one more
warms up.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.peers import Mitsuba, Ours, Pass
from benchmarks.scenes import ALL, QUICK, SCENES

MITSUBA = "Mitsuba"


def measure(options: argparse.Namespace) -> dict:
    """First calls, times and gradients of both peers on one scene, in this process."""
    make, setting = ALL[options.only]
    with tempfile.TemporaryDirectory() as folder:
        setting = QUICK if options.quick else setting
        scene = make(Path(folder), setting._replace(resolution=options.resolution or setting.resolution,
                                                    spp=options.spp or setting.spp))
        peers = {MITSUBA: Mitsuba(scene, options.device),
                 "eager" if options.eager else "compiled": Ours(scene, not options.eager, options.device,
                                                                  options.share_samples)}
    first = {name: peer.run(10_000)._asdict() for name, peer in peers.items()}
    for peer in peers.values():
        peer.run(10_001)
    passes: dict[str, list[Pass]] = {name: [] for name in peers}
    sums: dict[str, list[dict[str, float]]] = {name: [] for name in peers}
    for seed in range(options.rounds):
        for name, peer in peers.items():
            passes[name].append(peer.run(seed))
            sums[name].append(peer.gradient_sums())
        print(f"{options.only}, round {seed + 1} of {options.rounds}: "
              + ", ".join(f"{name} {passes[name][-1].both:.2f} s" for name in peers), file=sys.stderr, flush=True)
    return {"scene": options.only, "setting": scene.setting._asdict(), "first": first,
            "passes": {name: [each._asdict() for each in passes[name]] for name in peers}, "gradient_sums": sums}


def in_own_process(name: str, arguments: list[str]) -> dict | None:
    """`measure` in a new process, whose home folder holds no kernels of Mitsuba; None if it has failed and said why."""
    command = [sys.executable, "-m", "benchmarks.versus_mitsuba", *arguments, "--only", name]
    with tempfile.TemporaryDirectory() as home:
        done = subprocess.run(command, stdout=subprocess.PIPE, text=True, env={**os.environ, "HOME": home})
    return None if done.returncode else json.loads(done.stdout.splitlines()[-1])


def z_score(ours: list[float], theirs: list[float]) -> float:
    """The difference of two means in standard errors."""
    error = sum(statistics.variance(values) / len(values) for values in (ours, theirs)) ** 0.5
    return (statistics.fmean(ours) - statistics.fmean(theirs)) / max(error, 1e-30)


def row(result: dict) -> str:
    """The line of the table for one scene."""
    theirs, ours = (name for name in sorted(result["passes"], key=lambda name: name != MITSUBA))

    def median(name: str, what) -> float:
        return statistics.median(what(Pass(**each)) for each in result["passes"][name])

    def ratio(what) -> str:
        return f"{median(ours, what) / median(theirs, what):.2f}"

    times = " + ".join(f"{median(theirs, what):.2f}" for what in (lambda p: p.forward, lambda p: p.backward))
    first = {name: Pass(**each) for name, each in result["first"].items()}
    cells = [result["scene"], ours, times, ratio(lambda p: p.forward), ratio(lambda p: p.backward), ratio(lambda p: p.both),
             ratio(lambda p: p.cpu), *(f"{first[name].both:.1f} ({first[name].cpu:.1f})" for name in (ours, theirs))]
    sums = result["gradient_sums"]
    if len(sums[ours]) > 1:
        z = [z_score(*([run[parameter] for run in sums[name]] for name in (ours, theirs))) for parameter in sums[ours][0]]
        cells.append(f"{max(z, key=abs):+.1f} of {len(z)}")
    return f"| {' | '.join(cells)} |"


HEADER = """| scene | ours | Mitsuba, s | forward | backward | both | CPU | first call, s (CPU) | Mitsuba's | z of gradient |
|---|---|---|---|---|---|---|---|---|---|"""
LEGEND = """Ratios: ours over Mitsuba's, medians of {} rounds; CPU: of the CPU seconds of both passes.
z: the difference of the gradient, summed over the entries of a parameter, in standard errors; the greatest of them all.
Of vertices it need not be small: what is interior and what is left to boundaries depends on how points follow what moves."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", choices=ALL, nargs="+", default=list(SCENES))
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--resolution", type=int, help="pixels a side; default: that of the scene")
    parser.add_argument("--spp", type=int, help="samples a pixel; default: those of the scene")
    parser.add_argument("--eager", action="store_true", help="this renderer with compile=False")
    parser.add_argument("--share-samples", action="store_true",
                        help="of image and derivative, which Mitsuba and, by default, this renderer do not")
    parser.add_argument("--quick", action="store_true", help="tiny images, to see that it works")
    parser.add_argument("--device", choices=["cpu", "cuda"], default="cpu", help="that both render on")
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    parser.add_argument("--only", choices=ALL, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.only:
        print(json.dumps(measure(options)))
        return
    flags = [f"--{name}" for name in ("eager", "quick", "share-samples") if getattr(options, name.replace("-", "_"))]
    flags += [f"--{name}={value}" for name in ("resolution", "spp") if (value := getattr(options, name))]
    print(HEADER, flush=True)
    results, failed = [], []
    for name in options.scene:
        found = in_own_process(name, [*flags, "--rounds", str(options.rounds), "--device", options.device])
        if found is None:
            failed.append(name)
            print(f"| {name} | failed |", flush=True)
            continue
        results.append(found)
        print(row(found), flush=True)
        if options.json:
            options.json.write_text(json.dumps(results, indent=1))
    print(LEGEND.format(options.rounds))
    if failed:
        raise SystemExit(f"failed: {', '.join(failed)}")


if __name__ == "__main__":
    main()
