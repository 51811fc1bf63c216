"""Time and gradients beside Mitsuba's: ``python -m benchmarks.versus_mitsuba`` (needs mitsuba==3.9.1 and LLVM).

Cornell box, no Russian roulette, gradients of three reflectances and the lamp. Mitsuba renders with ``prb`` in
``llvm_ad_rgb``, this renderer eagerly and compiled, all in one process and in turns; medians are compared. Mitsuba's own
kernels are compiled in a warm-up, and its lazily evaluated results are forced within the measured time. Start-up times
(compilation without and with the disk cache) are measured in processes of their own.
"""

from __future__ import annotations

import argparse
import glob
import json
import os
import statistics
import subprocess
import sys
import time

import torch

import torch_radbp as rb
from benchmarks import cornell

LLVM = ("/usr/lib/*/libLLVM.so.19*", "/usr/lib/*/libLLVM-19.so*")  # Debian's libllvm19


class Ours:
    """One forward and backward pass of this renderer."""

    def __init__(self, resolution: int, spp: int, depth: int, compiled: bool):
        self.scene = cornell.load(resolution, depth)
        self.renderer = rb.Renderer(self.scene, spp=spp, compile=compiled)
        self.cotangent = torch.from_numpy(cornell.cotangent(resolution)).permute(2, 0, 1)[None]

    def run(self, seed: int) -> tuple[float, float]:
        """Seconds of the forward and the backward pass."""
        self.scene.zero_grad()
        start = time.perf_counter()
        image = self.renderer(seed=seed)
        middle = time.perf_counter()
        (image * self.cotangent).sum().backward()
        return middle - start, time.perf_counter() - middle

    def gradients(self) -> dict[str, list[float]]:
        return cornell.gradients(self.scene)


class Mitsuba:
    """Forward and backward passes by Mitsuba."""

    def __init__(self, resolution: int, spp: int, depth: int):
        libraries = [path for pattern in LLVM for path in sorted(glob.glob(pattern))]
        if libraries:
            os.environ.setdefault("DRJIT_LIBLLVM_PATH", libraries[0])
        import drjit as dr
        import mitsuba as mi

        mi.set_variant("llvm_ad_rgb")
        self.dr, self.mi, self.spp = dr, mi, spp
        self.scene = mi.load_file(str(cornell.SCENE), resolution=resolution)
        self.integrator = mi.load_dict({"type": "prb", "max_depth": depth, "rr_depth": cornell.NO_ROULETTE})
        self.parameters = mi.traverse(self.scene)
        for name in cornell.PARAMETERS:
            dr.enable_grad(self.parameters[name])
        self.parameters.update()
        self.cotangent = mi.TensorXf(cornell.cotangent(resolution))
        dr.eval(self.cotangent)

    def run(self, seed: int) -> tuple[float, float]:
        """Seconds of the forward and the backward pass, both evaluated to the end."""
        dr, values = self.dr, [self.parameters[name] for name in cornell.PARAMETERS]
        for value in values:
            dr.set_grad(value, 0)
        dr.sync_thread()
        start = time.perf_counter()
        image = self.mi.render(self.scene, self.parameters, integrator=self.integrator, spp=self.spp, seed=2 * seed,
                               seed_grad=2 * seed + 1)
        dr.eval(image)
        dr.sync_thread()
        middle = time.perf_counter()
        dr.backward(dr.sum(image * self.cotangent, axis=None))
        self.latest = [dr.grad(value) for value in values]
        dr.eval(self.latest)
        dr.sync_thread()
        return middle - start, time.perf_counter() - middle

    def gradients(self) -> dict[str, list[float]]:
        return {name: [float(channel[0]) for channel in value] for name, value in zip(cornell.PARAMETERS, self.latest)}


def start_up(options: argparse.Namespace) -> dict[str, float]:
    """The seconds of this process's first eager pass, and those by which its first compiled pass exceeds the third."""
    setting = options.resolution, options.spp, options.depth
    start = time.perf_counter()
    Ours(8, 1, 2, compiled=False).run(0)
    caster = time.perf_counter() - start
    ours = Ours(*setting, compiled=True)
    first, _, third = (sum(ours.run(seed)) for seed in range(3))
    return {"caster": caster, "compile": first - third, "steady": third}


def measure_start_up(options: argparse.Namespace) -> dict[str, float]:
    """`start_up` in a new process."""
    command = [sys.executable, "-m", "benchmarks.versus_mitsuba", "--only-start-up", "--resolution", str(options.resolution),
               "--spp", str(options.spp), "--depth", str(options.depth)]
    result = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout
    return json.loads(result.splitlines()[-1])


def measure(options: argparse.Namespace) -> dict:
    """Times and mean gradients of all peers, run in turns."""
    setting = options.resolution, options.spp, options.depth
    peers = {"mitsuba": Mitsuba(*setting), "eager": Ours(*setting, compiled=False),
             "compiled": Ours(*setting, compiled=True)}
    for name, peer in peers.items():
        for warm_up in range(2):
            seconds = sum(peer.run(10_000 + warm_up))
            print(f"warm-up of {name}: {seconds:.2f} s", file=sys.stderr, flush=True)
    times = {name: [] for name in peers}
    totals = {name: {parameter: torch.zeros(3, dtype=torch.float64) for parameter in cornell.PARAMETERS} for name in peers}
    squares = {name: {parameter: torch.zeros(3, dtype=torch.float64) for parameter in cornell.PARAMETERS} for name in peers}
    for seed in range(options.repeats):
        for name, peer in peers.items():
            times[name].append(peer.run(seed))
            for parameter, gradient in peer.gradients().items():
                value = torch.tensor(gradient, dtype=torch.float64)
                totals[name][parameter] += value
                squares[name][parameter] += value**2
        print(f"run {seed + 1} of {options.repeats}: " + ", ".join(f"{name} {sum(times[name][-1]):.2f} s" for name in peers),
              file=sys.stderr, flush=True)
    n = options.repeats
    result = {"setting": dict(zip(("resolution", "spp", "depth", "repeats"), (*setting, n))), "peers": {}}
    for name in peers:
        forward, backward = (statistics.median(each) for each in zip(*times[name]))
        both = statistics.median(sum(each) for each in times[name])
        mean = {parameter: totals[name][parameter] / n for parameter in cornell.PARAMETERS}
        error = {parameter: ((squares[name][parameter] / n - mean[parameter]**2).clamp_min(0) / max(1, n - 1)).sqrt()
                 for parameter in cornell.PARAMETERS}
        result["peers"][name] = {
            "forward": forward, "backward": backward, "both": both, "runs": times[name],
            "gradient": {parameter: mean[parameter].tolist() for parameter in mean},
            "gradient_error": {parameter: error[parameter].tolist() for parameter in error}}
    return result


def report(result: dict) -> str:
    """The figures as text."""
    peers = result["peers"]
    lines = ["Cornell box {resolution} x {resolution}, {spp} spp, depth {depth}, medians of {repeats} runs in turns".format(
        **result["setting"]), "", f"{'':10s}{'forward':>9s}{'backward':>10s}{'both':>8s}{'backward/forward':>18s}"
                                  f"{'both / Mitsuba':>16s}"]
    for name, peer in peers.items():
        lines.append(f"{name:10s}{peer['forward']:8.3f}s{peer['backward']:9.3f}s{peer['both']:7.3f}s"
                     f"{peer['backward'] / peer['forward']:18.2f}{peer['both'] / peers['mitsuba']['both']:16.2f}")
    lines += ["", "mean gradients (z: difference to Mitsuba's in standard errors)"]
    for parameter in cornell.PARAMETERS:
        for name, peer in peers.items():
            values, errors = peer["gradient"][parameter], peer["gradient_error"][parameter]
            theirs, their_errors = (peers["mitsuba"][key][parameter] for key in ("gradient", "gradient_error"))
            z = [(a - b) / max(1e-30, (e * e + f * f) ** 0.5) for a, b, e, f in zip(values, theirs, errors, their_errors)]
            shown = "" if name == "mitsuba" else "  z " + " ".join(f"{value:+.1f}" for value in z)
            lines.append(f"  {parameter:30s}{name:10s}" + " ".join(f"{value:10.6f}" for value in values) + shown)
    if figures := result.get("start_up"):
        lines.append(f"start-up: compilation {figures['compile']:.1f} s, ray caster {figures['caster']:.1f} s, "
                     f"then {figures['steady']:.3f} s a pass")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--resolution", type=int, default=256)
    parser.add_argument("--spp", type=int, default=16)
    parser.add_argument("--depth", type=int, default=8)
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--json", help="also write the figures to this file")
    parser.add_argument("--no-start-up", action="store_true", help="leave out the start-up times")
    parser.add_argument("--only-start-up", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.only_start_up:
        print(json.dumps(start_up(options)))
        return
    result = measure(options)
    if not options.no_start_up:
        result["start_up"] = measure_start_up(options)
    print(report(result))
    if options.json:
        with open(options.json, "w") as file:
            json.dump(result, file, indent=1)


if __name__ == "__main__":
    main()
