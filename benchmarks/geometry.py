"""What gradients of 100,000 vertices cost beside those of materials: ``python -m benchmarks.geometry``, `--compile`.

Two wavy sheets of 224 x 224 vertices each, a lamp and a constant sky, no Russian roulette. In turns: gradients of both
reflectances and the lamp; of all vertices, glued (hybrid sampling), inside of surfaces alone and at edges as well; of all
vertices, attached. Medians of a forward and a backward pass. The sheets are flat-shaded, so that all 300,000 edges may jump.
"""

from __future__ import annotations

import argparse
import statistics
import time
from typing import NamedTuple

import torch

import torch_radbp as rb
from torch_radbp.io.values.transform import rotate, scale, translate

SIDE = 224  # vertices


class Case(NamedTuple):
    """Which gradients are taken, and how."""

    names: tuple[str, ...]
    sampling: str
    terms: tuple[str, ...] = ("interior", "primary")


VERTICES = ("floor.vertex_positions", "wall.vertex_positions")
CASES = {
    "materials": Case(("floor.bsdf.reflectance.value", "wall.bsdf.reflectance.value", "lamp.emitter.radiance.value"),
                      "hybrid"),
    "vertices, hybrid, no edges": Case(VERTICES, "hybrid", ("interior",)),
    "vertices, hybrid": Case(VERTICES, "hybrid"),
    "vertices, attached": Case(VERTICES, "attached"),
}


def sheet(colour: list[float], pose) -> dict:
    """A wavy sheet over [-1, 1]^2."""
    line = torch.linspace(-1, 1, SIDE)
    y, x = torch.meshgrid(line, line, indexing="ij")
    height = 0.03 * torch.sin(9 * x) * torch.cos(7 * y)
    corner = (torch.arange(SIDE - 1)[:, None] * SIDE + torch.arange(SIDE - 1)).reshape(-1)
    faces = torch.cat([torch.stack([corner, corner + 1, corner + SIDE + 1], 1),
                       torch.stack([corner, corner + SIDE + 1, corner + SIDE], 1)])
    return {"type": "mesh", "vertex_positions": torch.stack([x, y, height], 2).reshape(-1, 3), "faces": faces,
            "to_world": pose, "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": colour}}}


def load(size: int, depth: int) -> rb.Scene:
    """The scene, seen by a camera with `size` x `size` pixels."""
    return rb.load_dict({
        "type": "scene", "integrator": {"type": "path", "max_depth": depth, "rr_depth": 1000},
        "sensor": {"type": "perspective", "fov": 45.0, "to_world": rb.look_at((0, 0.2, 3.2), (0, 0, 0), (0, 1, 0)),
                   "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"}}},
        "wall": sheet([0.6, 0.5, 0.4], torch.eye(4)),
        "floor": sheet([0.3, 0.5, 0.4], translate((0, -1, 1)) @ rotate((1, 0, 0), -90)),
        "lamp": {"type": "rectangle", "to_world": translate((0, 1.2, 1.5)) @ rotate((1, 0, 0), 110) @ scale((0.4, 0.4, 0.4)),
                 "emitter": {"type": "area", "radiance": {"type": "rgb", "value": [9.0, 7.0, 4.0]}}},
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": [0.2, 0.2, 0.3]}},
    })


class Measured:
    """One case, rendered again and again."""

    def __init__(self, case: Case, size: int, spp: int, depth: int, compiled: bool):
        self.scene = load(size, depth)
        self.wanted = [self.scene.get_parameter(name).requires_grad_() for name in case.names]
        self.renderer = rb.Renderer(self.scene, spp=spp, sampling=case.sampling, compile=compiled, terms=case.terms)
        self.forward, self.both = [], []

    def run(self, seed: int) -> None:
        start = time.perf_counter()
        image = self.renderer(seed=seed)
        middle = time.perf_counter()
        gradients = torch.autograd.grad(image.square().mean(), self.wanted)
        end = time.perf_counter()
        if not all(gradient.isfinite().all() and gradient.abs().max() > 0 for gradient in gradients):
            raise RuntimeError("a gradient is zero or not finite: there is nothing to compare")
        self.forward.append(middle - start)
        self.both.append(end - start)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", type=int, default=128)
    parser.add_argument("--spp", type=int, default=16)
    parser.add_argument("--depth", type=int, default=6)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--compile", action="store_true")
    options = parser.parse_args()
    cases = {name: Measured(case, options.size, options.spp, options.depth, options.compile)
             for name, case in CASES.items()}
    for repeat in range(options.repeats + 1):  # the first run only warms up
        for case in cases.values():
            case.run(repeat)
    count = sum(len(parameter) for parameter in cases["vertices, hybrid"].wanted)
    print(f"{count} vertices, {'compiled' if options.compile else 'eager'}, {torch.get_num_threads()} threads; seconds")
    reference = statistics.median(cases["materials"].both[1:])
    for name, case in cases.items():
        forward, both = statistics.median(case.forward[1:]), statistics.median(case.both[1:])
        print(f"{name:26} forward {forward:.2f}  backward {both - forward:.2f}  both {both:.2f}, "
              f"{both / reference:.2f} x the materials")


if __name__ == "__main__":
    main()
