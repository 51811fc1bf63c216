"""Rays per second by scene, depth and kind: `python -m benchmarks.rays`, `--scene NAME`, `--caster NAME`, `--threads N`.

The rays are those of paths, in the order in which the tracer casts them: closest hits from the camera, after the first
bounce and after the third, and shadow rays from there, of which only those count that have a length. Casters take turns;
medians of processor seconds (of one thread; of several, seconds by the clock). Four kinds of scene: the Cornell box; a mesh
of 82,000 triangles under the open sky; a million triangles; a room with 200 small things.
"""

from __future__ import annotations

import argparse
import statistics
import time
from typing import NamedTuple

import numpy as np
import torch
import trimesh
from torch import Tensor

import torch_radbp as rb
from benchmarks.scenes.cornell_box import SCENE
from benchmarks.scenes.description import camera, rgb
from benchmarks.scenes.metal_mesh import bumpy_sphere
from torch_radbp.io.values.transform import rotate, scale, translate
from torch_radbp.raycast import CASTERS, Ray, RayCaster, make_caster

RESOLUTION, SPP, DEPTH = 256, 4, 5
DEPTHS = (0, 1, 3)


class Query(NamedTuple):
    """A call of a caster."""

    ray: Ray
    tmax: Tensor | None  # None: the closest hit

    def ask(self, caster: RayCaster) -> None:
        if self.tmax is None:
            caster.intersect(self.ray)
        else:
            caster.occluded(self.ray, self.tmax)

    @property
    def count(self) -> int:
        return len(self.ray.o.x) if self.tmax is None else int((self.tmax > 0).sum())


class Recorder:
    """A caster that keeps what it is asked."""

    def __init__(self, caster: RayCaster):
        self.caster, self.vertices, self.faces = caster, caster.vertices, caster.faces
        self.closest: list[Query] = []
        self.shadow: list[Query] = []

    recorded_as = None

    def intersect(self, ray: Ray):
        self.closest.append(Query(ray, None))
        return self.caster.intersect(ray)

    def occluded(self, ray: Ray, tmax: Tensor) -> Tensor:
        self.shadow.append(Query(ray, tmax))
        return self.caster.occluded(ray, tmax)


def mesh(shape: trimesh.Trimesh) -> dict:
    return {"type": "mesh", "vertex_positions": torch.tensor(shape.vertices, dtype=torch.float32),
            "faces": torch.tensor(np.array(shape.faces)), "bsdf": {"type": "diffuse", "reflectance": rgb(0.7, 0.6, 0.5)}}


def open_air(subdivisions: int, resolution: int) -> dict:
    """A bumpy sphere on a floor under a constant sky."""
    return {"type": "scene", "sensor": camera((0.0, 1.0, 3.2), (0.0, -0.1, 0.0), 45.0, resolution),
            "sky": {"type": "constant", "radiance": rgb(1.0, 1.0, 1.0)}, "sphere": mesh(bumpy_sphere(subdivisions)),
            "floor": {"type": "rectangle", "to_world": translate((0, -1.1, 0)) @ rotate((1, 0, 0), -90) @ scale((4, 4, 4))}}


def room(resolution: int) -> dict:
    """A closed room with boxes, balls and cylinders all over."""
    random = np.random.default_rng(3)
    things = []
    for number in range(200):
        size = 0.05 + 0.2 * random.random()
        thing = (trimesh.creation.box((size, size, size)), trimesh.creation.icosphere(subdivisions=2, radius=size / 1.5),
                 trimesh.creation.cylinder(size / 2, 1.5 * size, sections=20))[number % 3]
        thing.apply_transform(trimesh.transformations.random_rotation_matrix(random.random(3)))
        things.append(thing.apply_translation(random.random(3) * (3.6, 3.0, 3.0) - (1.8, 1.9, 1.9)))
    lamp = translate((0, 1.95, 0)) @ rotate((1, 0, 0), 90) @ scale((0.5, 0.5, 0.5))
    return {"type": "scene", "sensor": camera((0.0, 0.0, 1.95), (0.0, -0.1, 0.0), 60.0, resolution),
            "walls": mesh(trimesh.creation.box((4, 4, 4))), "things": mesh(trimesh.util.concatenate(things)),
            "lamp": {"type": "rectangle", "to_world": lamp, "emitter": {"type": "area", "radiance": rgb(9.0, 9.0, 9.0)}}}


SCENES = {
    "cornell": lambda resolution: rb.load(SCENE, resolution=resolution),
    "mesh": lambda resolution: rb.load_dict(open_air(6, resolution)),
    "million": lambda resolution: rb.load_dict(open_air(8, resolution)),
    "room": lambda resolution: rb.load_dict(room(resolution)),
}


def recorded(scene: rb.Scene, resolution: int) -> Recorder:
    """The rays of the paths of one picture, and the caster that answered them."""
    renderer = rb.Renderer(scene, spp=SPP, max_depth=DEPTH, rr_depth=10_000, chunk=resolution**2 * SPP)
    recorder = None

    def caster_of(tensors, *placed):
        nonlocal recorder
        recorder = recorder or Recorder(rb.Renderer.caster_of(renderer, tensors, *placed))
        return recorder

    renderer.caster_of = caster_of
    with torch.no_grad():
        renderer(seed=0)
    return recorder


def rates(query: Query, casters: dict[str, RayCaster], rounds: int, clock) -> dict[str, float]:
    """Rays per second of each caster."""
    seconds: dict[str, list[float]] = {name: [] for name in casters}
    for _ in range(rounds):
        for name, caster in casters.items():
            start = clock()
            query.ask(caster)
            seconds[name].append(clock() - start)
    return {name: query.count / statistics.median(times) for name, times in seconds.items()}


def lines(name: str, names: list[str], resolution: int, rounds: int, clock) -> list[str]:
    """The rows of the table for one scene."""
    recorder = recorded(SCENES[name](resolution), resolution)
    vertices, faces = recorder.vertices, recorder.faces
    casters = {caster: make_caster(None if caster == "default" else caster, vertices, faces) for caster in names}
    rows = []
    for kind, queries in (("closest", recorder.closest), ("shadow", recorder.shadow)):
        for depth in (depth for depth in DEPTHS if depth < len(queries)):
            found = rates(queries[depth], casters, rounds, clock)
            columns = "".join(f"{rate / 1e6:12.2f}" for rate in found.values())
            rows.append(f"{name:8} {len(faces):9,} {kind:8} {depth:5} {queries[depth].count:8,}{columns}")
    return rows


def main() -> None:
    """Measures and prints."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", choices=list(SCENES), action="append", help="default: all")
    parser.add_argument("--caster", choices=["default", *CASTERS], action="append", help="default: default and embree")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--resolution", type=int, default=RESOLUTION)
    parser.add_argument("--rounds", type=int, default=9)
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    clock = time.process_time if options.threads == 1 else time.perf_counter
    names = options.caster or ["default", "embree"]
    print(f"million rays a second, {options.threads} threads")
    print(f"{'scene':8} {'triangles':>9} {'rays':8} {'depth':>5} {'count':>8}" + "".join(f"{name:>12}" for name in names))
    for scene in options.scene or SCENES:
        print("\n".join(lines(scene, names, options.resolution, options.rounds, clock)), flush=True)


if __name__ == "__main__":
    main()
