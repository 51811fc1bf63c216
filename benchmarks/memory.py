"""Peak memory and time of every adjoint strategy: ``python -m benchmarks.memory``.

The scene of `versus_mitsuba` at depth 32: Cornell box, no Russian roulette, the same gradients, the renderer's own
chunks. By default image and derivative have samples of their own; all other rows share them. Each strategy runs in a
process of its own: a small pass first, which loads what there is to load; then the peak of resident memory during one
forward and backward pass, over what was resident before, and what the renderer predicts beside it. `checkpoint per bounce`
is plain autograd over `torch.utils.checkpoint` at every bounce, which is what torch offers without this project. The last
column is the relative difference of the gradient to the first strategy's.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

import torch
from torch.utils.checkpoint import checkpoint

import torch_radbp as rb
from benchmarks.resident import MIB, peak_of
from benchmarks.scenes.cornell_box import PARAMETERS, cornell_box
from benchmarks.scenes.description import Setting, cotangent
from torch_radbp.call.pixels import Films, film_places, sums_of_wavefront
from torch_radbp.call.render_call import start_paths
from torch_radbp.call.wavefronts import Wavefront
from torch_radbp.path.lanes import add_at
from torch_radbp.path.step import survivors
from torch_radbp.path.wavefront import take_step
from torch_radbp.tensors.record import joined
from torch_radbp.tensors.vec import Vec3, masked, rows

CHECKPOINT = "checkpoint per bounce"
DEFAULT = "default"
STRATEGIES = {
    DEFAULT: rb.MemoizedAdjoint(),
    "stride 1": rb.MemoizedAdjoint(1),
    "stride 8": rb.MemoizedAdjoint(8),
    'stride "sqrt"': rb.MemoizedAdjoint("sqrt"),
    'stride "log"': rb.MemoizedAdjoint("log"),
    "stride 1, no hits": rb.MemoizedAdjoint(1, keep_hits=False),
    'stride "log", no hits': rb.MemoizedAdjoint("log", keep_hits=False),
    "replay": rb.ReplayAdjoint(),
    "quadratic": rb.QuadraticAdjoint(),
    "tape": rb.TapeAdjoint(),
    CHECKPOINT: rb.TapeAdjoint(),
}


def render_with_checkpoints(renderer: rb.Renderer, seed: int) -> torch.Tensor:
    """The image by plain autograd that keeps the path state at every bounce and computes the rest again."""
    call = renderer.prepare(seed, None, renderer.spp, None)
    integrand = call.make_integrand(call.scene)

    def one_bounce(state, depth):
        vertex, light, step = take_step(integrand, state, depth)
        found = vertex.Le + masked(step.visible, vertex.Ld)
        found = found if light is None else joined([found, light])
        return rows(state.lane, step.order), rows(state.beta, step.order) * found, survivors(integrand, vertex.next, step)

    def deposited(wavefront: Wavefront) -> tuple[list[torch.Tensor], None]:
        state, depth = start_paths(call, wavefront, 0), 0
        L = Vec3.buffer(state.beta.x)
        while depth < integrand.max_depth and len(state.lane):
            lane, found, state = checkpoint(one_bounce, state, depth, use_reentrant=False)
            add_at(L, lane, found)
            depth += 1
        return sums_of_wavefront(call, wavefront, L, film_places(call, wavefront, 0)), None

    return Films().gather(call._replace(workers=1), deposited).values


def one_pass(renderer: rb.Renderer, name: str, adj_image: torch.Tensor, seed: int) -> float:
    """Seconds of a forward and backward pass."""
    renderer.scene.zero_grad()
    start = time.perf_counter()
    image = render_with_checkpoints(renderer, seed) if name == CHECKPOINT else renderer(seed=seed)
    (image * adj_image).sum().backward()
    return time.perf_counter() - start


def measure(name: str, options: argparse.Namespace) -> dict:
    """Peak and time of one strategy, in this process."""
    def make(resolution: int) -> tuple[rb.Renderer, torch.Tensor]:
        scene = cornell_box(Setting(resolution, options.spp, options.depth))
        renderer = scene.renderer(options.compile, adjoint=STRATEGIES[name], chunk=options.chunk or None,
                                  sampling=options.sampling, share_samples=name != DEFAULT)
        return renderer, torch.from_numpy(cotangent(resolution)).permute(2, 0, 1)[None]

    small, small_adjoint = make(16)
    one_pass(small, name, small_adjoint, 0)
    renderer, adj_image = make(options.resolution)
    predicted = 0 if name == CHECKPOINT else renderer.memory_plan().peak
    seconds = 0.0

    def run() -> None:
        nonlocal seconds
        seconds = one_pass(renderer, name, adj_image, 1)

    peak = peak_of(run)
    return {"name": name, "bytes": peak, "seconds": seconds, "predicted": predicted,
            "gradient": {parameter: renderer.scene.get_parameter(parameter).grad.tolist() for parameter in PARAMETERS}}


def in_own_process(name: str, options: argparse.Namespace) -> dict:
    """`measure` in a new process."""
    command = [sys.executable, "-m", "benchmarks.memory", "--only", name]
    for option in ("resolution", "spp", "depth", "chunk", "sampling"):
        command += [f"--{option}", str(getattr(options, option))]
    command += ["--compile"] if options.compile else []
    run = subprocess.run(command, stdout=subprocess.PIPE, text=True)
    if run.returncode:
        return {"name": name, "failed": run.returncode}
    return json.loads(run.stdout.splitlines()[-1])


def disagreement(gradient: dict, reference: dict) -> float:
    """Greatest relative difference of two gradients, parameter by parameter."""
    pairs = [(torch.tensor(gradient[name]), torch.tensor(reference[name])) for name in reference]
    return max(float((a - b).norm() / b.norm()) for a, b in pairs)


def report(results: list[dict], options: argparse.Namespace) -> str:
    """The table as markdown."""
    lanes = options.resolution**2 * options.spp
    mode = "compiled" if options.compile else "eager"
    lines = [f"Cornell box {options.resolution} x {options.resolution}, {options.spp} spp ({lanes} paths), "
             f"depth {options.depth}, chunk {options.chunk or 'default'}, {mode}, {options.sampling}", "",
             "| strategy | peak MiB | predicted MiB | predicted / peak | seconds | gradient off by |",
             "|---|---|---|---|---|---|"]
    reference = next((result["gradient"] for result in results if "gradient" in result), None)
    for result in results:
        if "failed" in result:
            lines.append(f"| {result['name']} | failed: exit status {result['failed']} | | | | |")
            continue
        peak, predicted = result["bytes"] / MIB, result["predicted"] / MIB
        prediction = f"{predicted:.0f} | {predicted / peak:.2f}" if predicted else " | "
        lines.append(f"| {result['name']} | {peak:.0f} | {prediction} | {result['seconds']:.2f} | "
                     f"{disagreement(result['gradient'], reference):.1e} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--resolution", type=int, default=256)
    parser.add_argument("--spp", type=int, default=16)
    parser.add_argument("--depth", type=int, default=32)
    parser.add_argument("--chunk", type=int, default=0, help="lanes traced together; 0: the renderer's choice")
    parser.add_argument("--sampling", default="hybrid", help="attached: rays carry derivatives")
    parser.add_argument("--compile", action="store_true")
    parser.add_argument("--strategies", nargs="+", choices=STRATEGIES, default=list(STRATEGIES))
    parser.add_argument("--json", help="also write the figures to this file")
    parser.add_argument("--only", choices=STRATEGIES, help="measure one strategy in this process and print JSON")
    options = parser.parse_args()
    if options.only:
        print(json.dumps(measure(options.only, options)))
    else:
        results = [in_own_process(name, options) for name in options.strategies]
        print(report(results, options))
        if options.json:
            Path(options.json).write_text(json.dumps(results, indent=1))


if __name__ == "__main__":
    main()
