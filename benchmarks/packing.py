"""What a call costs beside tracing: ``python -m benchmarks.packing``, or with names of scenes.

Each scene is loaded and then rendered with 8 x 8 pixels and one sample per pixel, so that there is next to nothing to trace,
while one colour is optimised: forward, backward, step. Printed are the seconds to load it and for its first step (functions
are compiled, the hierarchy of triangles is built), and of the later ones the medians in milliseconds: the whole step, the
part that prepares a rendering (checks, tables, ray caster, cameras) and the part that looks for silhouettes. `cpu` is the
processor time of all threads of a step; `memory` is what the process holds, in MB.
"""

from __future__ import annotations

import argparse
import re
import statistics
import subprocess
import sys
import time
from pathlib import Path

import torch

import torch_radbp as rb
from torch_radbp.boundary.terms.jump_watch import JumpWatch
from torch_radbp.io.values.transform import translate
from torch_radbp.shape.surface import grid

CORNELL = Path(__file__).parents[1] / "assets" / "cornell_box" / "scene.xml"
COLOUR = "box.bsdf.reflectance.value"


def constant(*value: float) -> dict:
    return {"type": "rgb", "value": list(value)}


def sheet(columns: int, **attributes) -> dict:
    """A wavy sheet of 2 x columns x columns triangles over [-1, 1]^2, with normals and texture coordinates."""
    uv, faces = grid(columns, columns)
    x, y = (2 * uv - 1).unbind(1)
    normals = torch.stack([-0.3 * torch.cos(3 * x), torch.zeros_like(x), torch.ones_like(x)], 1)
    return {"type": "mesh", "vertex_positions": torch.stack([x, y, 0.1 * torch.sin(3 * x)], 1), "faces": faces,
            "vertex_normals": torch.nn.functional.normalize(normals, dim=1), "vertex_texcoords": uv, **attributes}


def scene_of(**objects) -> rb.Scene:
    """A box whose colour is optimised, and other objects."""
    film = {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}}
    sensor = {"type": "perspective", "fov": 45.0, "film": film, "to_world": rb.look_at((0, 0.2, 4), (0, 0, 0), (0, 1, 0))}
    box = {"type": "cube", "to_world": translate((0.5, 0.5, 1)),
           "bsdf": {"type": "diffuse", "reflectance": constant(0.5, 0.4, 0.3)}}
    objects.setdefault("sky", {"type": "constant", "radiance": constant(0.5, 0.6, 0.7)})
    return rb.load_dict({"type": "scene", "integrator": {"type": "path", "max_depth": 3}, "sensor": sensor, "box": box,
                         **objects})


def image(height: int, width: int) -> torch.Tensor:
    """(height, width, 3) random texels."""
    return torch.rand(height, width, 3, generator=torch.Generator().manual_seed(1))


def bitmap_wall() -> dict:
    return {"type": "rectangle", "to_world": translate((0, 0, -1)),
            "bsdf": {"type": "diffuse", "reflectance": {"type": "bitmap", "data": image(4096, 4096)}}}


SCENES = {
    "a million triangles": lambda: scene_of(hills=sheet(707)),
    "the same, bitmap of 4096 x 4096": lambda: scene_of(hills=sheet(707), wall=bitmap_wall()),
    "environment map of 2048 x 1024": lambda: scene_of(sky={"type": "envmap", "bitmap": image(1024, 2048)}),
    "lamp of 100,000 triangles": lambda: scene_of(
        lamp=sheet(224, emitter={"type": "area", "radiance": constant(3, 2, 1)})),
    "Cornell box, 32 x 32": lambda: rb.load(CORNELL, resolution=32, max_depth=3),
}


class Clock:
    """Adds up the time that a method takes."""

    def __init__(self, owner: type, name: str):
        self.spent, method = 0.0, getattr(owner, name)

        def timed(*arguments, **settings):
            start = time.perf_counter()
            result = method(*arguments, **settings)
            self.spent += time.perf_counter() - start
            return result

        setattr(owner, name, timed)

    def read(self) -> float:
        """The milliseconds since the last reading."""
        spent, self.spent = 1e3 * self.spent, 0.0
        return spent


def resident() -> float:
    """The megabytes that this process holds; NaN where the system does not tell."""
    status = Path("/proc/self/status")
    return int(re.search(r"VmRSS:\s*(\d+)", status.read_text())[1]) / 1024 if status.exists() else float("nan")


def measure(name: str, steps: int, compiled: bool) -> str:
    """The row of one scene."""
    prepare, look = Clock(rb.Renderer, "prepare"), Clock(JumpWatch, "look")
    start = time.perf_counter()
    scene = SCENES[name]()
    loaded = time.perf_counter() - start
    colour = scene.get_parameter("white.reflectance.value" if "Cornell" in name else COLOUR).requires_grad_()
    renderer, optimiser = rb.Renderer(scene, spp=1, compile=compiled), torch.optim.SGD([colour], lr=1e-3)

    def step() -> tuple[float, ...]:
        wall, processor = time.perf_counter(), time.process_time()
        renderer().mean().backward()
        optimiser.step()
        optimiser.zero_grad()
        return (1e3 * (time.perf_counter() - wall), prepare.read(), look.read(), 1e3 * (time.process_time() - processor))

    first = step()[0] / 1e3
    for _ in range(2):
        step()
    whole, prepared, looked, processor = map(statistics.median, zip(*(step() for _ in range(steps))))
    return (f"{name:32} {loaded:8.2f} {first:8.2f} {whole:8.1f} {prepared:8.1f} {looked:8.2f} {processor:8.1f} "
            f"{resident():8.0f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", nargs="*", help=f"of: {', '.join(SCENES)}")
    parser.add_argument("--steps", type=int, default=9)
    parser.add_argument("--eager", action="store_true")
    parser.add_argument("--row", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.row:
        print(measure(options.row, options.steps, not options.eager))
        return
    print(f"{'':32} {'load s':>8} {'first s':>8} {'step ms':>8} {'prepare':>8} {'look':>8} {'cpu':>8} {'memory':>8}")
    for name in options.scenes or SCENES:  # each in a process of its own
        subprocess.run([sys.executable, "-m", "benchmarks.packing", "--row", name, "--steps", str(options.steps),
                        *(["--eager"] * options.eager)], check=True)


if __name__ == "__main__":
    main()
