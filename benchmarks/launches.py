"""How the host drives a rendering on a GPU: ``python -m benchmarks.launches``. Needs no GPU.

Kernels run on the processor (`tests/jit/emulated.py`), rays are cast by Warp's CPU device, and tensors say that they lie on
CUDA, so that everything takes the way that it takes there. Counted are, forwards and backwards:

* launches: kernels of ours and of Warp's that are started;
* waits: where the host needs what the device has computed, and so waits until it has come there;
* sent: what the host sends to the device, which takes a copy each;
* torch: operations of torch that compute something, each of which takes a launch of its own;
* Python: functions of lanes and of torch, and sequences of launches, that are started one by one from Python;
* driver: calls of CUDA's driver for these kernels, and those as they are where sequences that come again are graphs.

What is counted of two depths tells what a bounce adds, and what a call takes beside its bounces. Before each call the
parameters change a little, as in training. Calls that compile do not count. Paths do not end before their time, and
derivatives have samples of their own.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

import pytest
import torch
import warp as wp

import torch_radbp as rb
from benchmarks.instances import field_of
from benchmarks.peers import PRB, change
from benchmarks.scenes import ALL, QUICK, SCENES
from tests.gradients import cotangent
from tests.jit.emulated import Emulated
from tests.rendering.host import exchanges
from tests.rendering.on_gpu import render_on
from tests.scenes import media, networks, smoke
from tests.scenes.closed_box import closed_box
from torch_radbp.adjoint.function import RenderFunction
from torch_radbp.jit.nvidia.gpu import Gpu
from torch_radbp.jit.nvidia.graphs import Graphs
from torch_radbp.jit.run import LaneFunction
from torch_radbp.raycast.warp import Warp
from torch_radbp.tensors.torch_internals import TorchDispatchMode

DEPTHS = (3, 5)
SETTLING = 3  # calls until nothing is made that is kept for the next ones
COUNTED = ("launches", "waits", "sent", "torch", "Python", "driver", "by graphs")
# Operations of torch that start no kernel: they make tensors, or say where one lies.
STARTS_NONE = {"empty", "empty_like", "empty_strided", "new_empty", "new_empty_strided", "view", "_unsafe_view", "slice",
               "select", "narrow", "unbind", "split", "split_with_sizes", "as_strided", "expand", "permute", "transpose",
               "t", "unsqueeze", "squeeze", "detach", "alias", "is_same_size", "_has_same_storage_numel", "unfold",
               "diagonal", "lift_fresh", "set_", "resize_", "_local_scalar_dense"}
# What is computed on the host, from its own numbers: the words that kernels are given.
ON_THE_HOST = {"index_select", "add_", "frombuffer"}


class Operations(TorchDispatchMode):
    """Counts the operations of torch that start a kernel."""

    def __init__(self) -> None:
        super().__init__()
        self.found: Counter[str] = Counter()

    def __torch_dispatch__(self, function, types, args=(), kwargs=None):
        name = function.overloadpacket.__name__
        if name not in STARTS_NONE and not (name in ON_THE_HOST and of_words(args)):
            self.found[name] += 1
        return function(*args, **kwargs or {})


def of_words(arguments) -> bool:
    """True for the words that kernels are given, which are computed by the host: no other tensor is of int64."""
    return isinstance(arguments[0], torch.Tensor) and arguments[0].dtype == torch.int64


class Card:
    """A GPU in name, and what is started on it."""

    def __init__(self) -> None:
        self.gpu = Gpu(Emulated())
        self.rays = self.functions = 0

    def started(self) -> tuple[int, int, int, int, int]:
        """The kernels, sequences of them, calls of the driver, Warp's kernels and functions of lanes that were started."""
        launcher = self.gpu.launcher
        return len(launcher.launches), launcher.sequences, launcher.calls, self.rays, self.functions

    def counted(self, run: Callable[[], object]) -> Counter:
        """What the host does while something runs."""
        before = self.started()
        with Operations() as operations:
            found = exchanges(run)
        kernels, sequences, calls, rays, functions = (after - first for after, first in zip(self.started(), before))
        waits, sent = (sum(count for (way, _), count in found.items() if way == direction)
                       for direction in ("to the host", "from the host"))
        computed = sum(operations.found.values())
        return Counter({"launches": kernels + rays, "waits": waits, "sent": sent, "torch": computed,
                        "Python": sequences + functions + computed, "driver": calls})


@contextmanager
def card() -> Iterator[Card]:
    """A GPU in name, on which compiled renderings run meanwhile; it begins with nothing compiled."""
    made = Card()
    start, prepared = Warp._start, LaneFunction.prepared

    def started(self, *arguments):
        made.rays += 1
        return start(self, *arguments)

    def called(self, arguments):
        made.functions += 1
        return prepared(self, arguments)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Warp, "_start", started)
        render_on(made.gpu, patch, taped=True)
        for module in (wp, import_module("warp._src.torch")):  # whatever tensors say
            patch.setattr(module, "device_from_torch", lambda device: wp.get_device("cpu"))
        patch.setattr(Warp, "_stream", lambda self: None)
        patch.setattr(LaneFunction, "prepared", called)
        patch.setattr("torch_radbp.rendering.cost.memory_of", lambda device: float("inf"))
        yield made


class Passes(NamedTuple):
    """What the host does in the passes of a call."""

    forward: Counter
    backward: Counter


def passes(device: Card, renderer: rb.Renderer, parameters: Sequence[str]) -> Passes:
    """What the host does in a call of a renderer and its backward pass, on this thread, after some like it.

    Args:
        device: on which it renders.
        renderer: of a scene.
        parameters: of it, that are not the same in any two calls.
    """
    def changed(seed: int) -> None:
        with torch.no_grad():
            for name in parameters:
                value = renderer.scene.get_parameter(name)
                (value[:3] if name.endswith("to_world") else value).mul_(change(seed))

    def both(counted: Callable[[Callable[[], object]], Counter]) -> Passes:
        held = []
        forward = counted(lambda: held.append(renderer(seed=1)))
        image, = held
        gradient = cotangent(image.detach())
        with torch.no_grad():  # as autograd's engine does, by which it would leave a mode
            return Passes(forward, counted(lambda: RenderFunction.backward(image.grad_fn, gradient)))

    both(lambda run: Counter(run() or ()))  # makes the caster, which asks where the vertices truly lie
    for seed in range(SETTLING):
        changed(seed)
        found = both(device.counted)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Graphs, "of", lambda self, given, make: make())  # as if all words had come before
        for counted, by_graphs in zip(found, both(device.counted)):
            counted["by graphs"] = by_graphs["driver"]
    return found


class Driven(NamedTuple):
    """What the host does for a scene: for each bounce, and for a call beside its bounces."""

    scene: str
    way: str  # "forward" or "backward"
    of_bounce: dict[str, float]
    of_call: dict[str, float]

    def row(self) -> str:
        """The line of the table."""
        cells = [self.scene, self.way, *(f"{self.of_bounce[what]:g}" for what in COUNTED),
                 *(f"{self.of_call[what]:g}" for what in COUNTED)]
        return f"| {' | '.join(cells)} |"


def driven(name: str, make: Callable[[int], rb.Renderer], parameters: Sequence[str] = ()) -> list[Driven]:
    """What the host does for a scene.

    Args:
        name: of the scene.
        make: makes a renderer that takes so many bounces.
        parameters: of the scene, that change between calls.
    """
    with card() as device, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        few, many = (passes(device, make(depth), parameters) for depth in DEPTHS)
    found = []
    for way, shallow, deep in zip(Passes._fields, few, many):
        of_bounce = {what: (deep[what] - shallow[what]) / (DEPTHS[1] - DEPTHS[0]) for what in COUNTED}
        found.append(Driven(name, way, of_bounce, {what: shallow[what] - DEPTHS[0] * of_bounce[what] for what in COUNTED}))
    return found


def driven_of_benchmark(name: str) -> list[Driven]:
    """What the host does for a scene of the benchmarks, whose parameters change between calls as in training."""
    with tempfile.TemporaryDirectory() as folder:
        scene = ALL[name].make(Path(folder), QUICK)
        return driven(name, lambda depth: scene._replace(setting=QUICK._replace(max_depth=depth)).renderer(
            True, terms=PRB, caster="warp"), scene.parameters)


def driven_of_rarer(name: str) -> list[Driven]:
    """What the host does for a small scene of `RARER`, whose parameters change between calls."""
    make, parameters = RARER[name]

    def renderer(depth: int) -> rb.Renderer:
        scene = make().float()
        for parameter in parameters:
            scene.get_parameter(parameter).requires_grad_()
        return rb.Renderer(scene, spp=QUICK.spp, max_depth=depth, rr_depth=100, caster="warp", terms=PRB)

    return driven(name, renderer, parameters)


# Scenes that bounces do more for: boundaries of media that are passed, media that vary in space, and networks as textures;
# a pose among instances that together have many triangles; and few triangles, some of which move, in the light of a surface.
RARER = {"boundaries": (media.room, ["ball.interior.sigma_t.value.value"]),
         "smoke": (lambda: smoke.room(smoke.varied(3)), ["box.interior.sigma_t.data"]),
         "networks": (networks.room, [f"{name}.bsdf.reflectance.module.0.weight" for name in ("floor", "wall", "box")]),
         "moving instances": (lambda: field_of(27, 10_000, QUICK.resolution), ["stone_0.to_world"]),
         "moving box": (lambda: closed_box({"type": "diffuse"}), ["thing.vertex_positions"])}
HEADER = f"""| scene | pass | a bounce: {' | '.join(COUNTED)} | a call: {' | '.join(COUNTED)} |
|{'---|' * (2 + 2 * len(COUNTED))}"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", choices=[*ALL, *RARER], nargs="+", default=[*SCENES, *RARER])
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    options = parser.parse_args()
    print(HEADER, flush=True)
    results = []
    for name in options.scene:
        for found in driven_of_rarer(name) if name in RARER else driven_of_benchmark(name):
            results.append(found)
            print(found.row(), flush=True)
    if options.json:
        options.json.write_text(json.dumps([found._asdict() for found in results], indent=1))


if __name__ == "__main__":
    main()
