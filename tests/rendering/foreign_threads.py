"""What threads that are not ours do meanwhile: ``python -m tests.rendering.foreign_threads`` prints it as JSON.

For each kind of rendering, forward and backward: threads that it started, and nanoseconds that all which are not
ours computed, during the rendering and after it. And the nanoseconds that they spun after operations of torch's, before the
first rendering and after the last.
"""

from __future__ import annotations

import json
import sys
import threading
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import torch

THREADS = 2
LANES = 1 << 17  # of an operation that torch divides
WAIT = 0.05  # seconds, in which a thread that spins computes for many milliseconds
TASKS = Path("/proc/self/task")


def foreign() -> dict[int, int]:
    """Nanoseconds that each thread has computed that is none of Python's."""
    ours = {thread.native_id for thread in threading.enumerate()}
    return {int(task.name): int((task / "schedstat").read_text().split()[0]) for task in TASKS.iterdir()
            if int(task.name) not in ours}


def computed(work: Callable[[], None]) -> tuple[int, int]:
    """How many foreign threads `work()` has started, and the nanoseconds that all of them have computed."""
    before = foreign()
    work()
    after = foreign()
    return len(after.keys() - before.keys()), sum(after.values()) - sum(before.values())


def spun() -> int:
    """Nanoseconds that torch's threads compute after some operations."""
    numbers, total = torch.ones(LANES), 0
    for _ in range(5):
        numbers + numbers
        total += computed(lambda: time.sleep(WAIT))[1]
    return total


def renderings() -> dict[str, Callable[[], torch.Tensor]]:
    """Renderings by name, each with its backward pass."""
    import torch_radbp as rb
    from tests.scenes import cornell

    def rendering(parameter: str, **settings) -> Callable[[], torch.Tensor]:
        scene = cornell(torch.float32, 48)  # more lanes than torch computes on one thread
        scene.get_parameter(parameter).requires_grad_()
        return rb.Renderer(scene, **{"spp": 16, "max_depth": 2} | settings)

    colour, vertices = "white.reflectance.value", "box.vertex_positions"
    still, moving = rendering(colour, chunk=1 << 16), rendering(vertices)  # one chunk, which is not dealt out
    eager = rendering(colour, chunk=1 << 16, compile=False)
    tape = rendering(colour, adjoint=rb.TapeAdjoint())
    tangent = {colour: torch.ones(3)}
    return {"compiled": lambda: still().sum().backward(), "eager": lambda: eager().sum().backward(),
            "vertices": lambda: moving().sum().backward(), "tape": lambda: tape().sum().backward(),
            "forward mode": lambda: rb.jvp(still.scene, tangent, spp=16, max_depth=2),
            "aovs": lambda: moving.aovs(["depth", "albedo"])["depth"].sum().backward()}


def main() -> None:
    torch.set_num_threads(THREADS)
    found = {"spun before": spun()}
    warnings.simplefilter("ignore")
    for name, render in renderings().items():
        render()
        time.sleep(WAIT)
        threads, during = computed(render)
        found[name] = {"threads": threads, "during": during, "after": computed(lambda: time.sleep(WAIT))[1]}
    found["spun after"] = spun()
    json.dump(found, sys.stdout)


if __name__ == "__main__":
    main()
