"""Millions of rays per second of each ray caster: `python -m benchmarks.raycast [--lanes N] [--threads N]`.

Queries are timed as the renderer makes them: each one comes right after a torch operation on as many lanes, whose
threads are then still spinning. `embree, Python threads` is the same loop on a pool of its own. Mitsuba's LLVM mode is
timed beside them if it is installed and DRJIT_LIBLLVM_PATH is set. The variants of a query take turns within one
process; medians are printed. The machine must be idle otherwise.
"""

import argparse
import os
import statistics
import time

import torch
import trimesh

from torch_radbp.jit import team
from torch_radbp.raycast import Ray, make_caster
from torch_radbp.vec import Vec3, dot, normalize

BRUTE_LANES = 1 << 12
TMAX = 3.0  # of occlusion queries


def scenes():
    """(name, mesh) of 36 and 81,932 triangles: everything inside of a closed box of size 4."""
    box = trimesh.creation.box((4, 4, 4))
    blocks = [trimesh.creation.box((1, 1, 1)).apply_translation(place) for place in ((-1, 0, -1), (1, 0.5, -1))]
    yield "boxes", trimesh.util.concatenate([box, *blocks])
    yield "sphere", trimesh.util.concatenate([box, trimesh.creation.icosphere(subdivisions=6)])


def rays(lanes: int):
    """(name, ray): directions without order, and a pinhole camera's."""
    generator = torch.Generator().manual_seed(1)
    o = 3.8 * torch.rand(lanes, 3, generator=generator) - 1.9
    d = normalize(Vec3.of(torch.randn(lanes, 3, generator=generator)))
    yield "incoherent", Ray(Vec3.of(o), d)
    width = int(lanes**0.5)
    column, row = torch.arange(lanes) % width, torch.arange(lanes) // width
    zero = torch.zeros(lanes)
    pixel = Vec3(2 * column / width - 1, 2 * row / width - 1, zero - 1)
    yield "camera", Ray(Vec3(zero, zero, zero + 1.9), normalize(pixel))


def mitsuba_queries(mesh, ray: Ray):
    """(closest hit, any hit) of Mitsuba's llvm_ad_rgb as functions, or None."""
    try:
        import drjit as dr
        import mitsuba as mi
    except ImportError:
        return None
    if "DRJIT_LIBLLVM_PATH" not in os.environ:
        return None
    mi.set_variant("llvm_ad_rgb")
    shape = mi.Mesh("mesh", len(mesh.vertices), len(mesh.faces))
    parameters = mi.traverse(shape)
    parameters["vertex_positions"] = mesh.vertices.astype("float32").ravel()
    parameters["faces"] = mesh.faces.astype("uint32").ravel()
    parameters.update()
    scene = mi.load_dict({"type": "scene", "mesh": shape})
    o, d = (mi.Vector3f(*(component.numpy() for component in vector)) for vector in ray)
    there = mi.Ray3f(mi.Point3f(o), d, TMAX, 0.0, [])
    forever = mi.Ray3f(mi.Point3f(o), d)

    def closest():
        hit = scene.ray_intersect_preliminary(forever)
        dr.eval(hit.prim_index, hit.prim_uv)
        dr.sync_thread()

    def any_hit():
        dr.eval(scene.ray_test(there))
        dr.sync_thread()

    return closest, any_hit


def seconds(queries: dict, before, repeats: int) -> dict:
    """The median time of each query; they take turns, and `before` runs untimed ahead of each."""
    times = {name: [] for name in queries}
    for repeat in range(repeats + 2):
        for name, query in queries.items():
            before()
            start = time.perf_counter()
            query()
            if repeat >= 2:
                times[name].append(time.perf_counter() - start)
    return {name: statistics.median(values) for name, values in times.items()}


def on_python_threads(query):
    """The query with torch's OpenMP team out of sight."""

    def run():
        found, team.openmp_parallel = team.openmp_parallel, lambda: None
        try:
            query()
        finally:
            team.openmp_parallel = found

    return run


def rates(mesh, ray: Ray, repeats: int) -> dict[str, list[float]]:
    """[closest hits, any hits] per second of each caster, by name."""
    vertices, faces = torch.tensor(mesh.vertices, dtype=torch.float32), torch.tensor(mesh.faces)
    lanes = len(ray.o.x)
    tmax = torch.full((lanes,), TMAX)
    embree = make_caster("embree", vertices, faces)
    pairs = {"embree": (lambda: embree.intersect(ray), lambda: embree.occluded(ray, tmax))}
    pairs["embree, Python threads"] = tuple(map(on_python_threads, pairs["embree"]))
    if peer := mitsuba_queries(mesh, ray):
        pairs["mitsuba"] = peer
    columns = [{name: pair[kind] for name, pair in pairs.items()} for kind in (0, 1)]
    times = [seconds(column, lambda: dot(ray.o, ray.d), repeats) for column in columns]
    result = {name: [lanes / column[name] for column in times] for name in pairs}
    if len(faces) < 1000:
        brute = make_caster("brute", vertices, faces)
        few = Ray(*(Vec3(*(component[:BRUTE_LANES] for component in vector)) for vector in ray))
        queries = {"closest": lambda: brute.intersect(few), "any": lambda: brute.occluded(few, tmax[:BRUTE_LANES])}
        result["brute"] = [BRUTE_LANES / time for time in seconds(queries, lambda: None, 3).values()]
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--lanes", type=int, default=1 << 18)
    parser.add_argument("--threads", type=int, default=torch.get_num_threads())
    parser.add_argument("--repeats", type=int, default=15)
    arguments = parser.parse_args()
    torch.set_num_threads(arguments.threads)
    print(f"{arguments.lanes} lanes, {arguments.threads} threads, Mray/s")
    print(f"{'scene':8} {'rays':10}  {'caster':22} {'closest':>8} {'any':>8}")
    for scene, mesh in scenes():
        for kind, ray in rays(arguments.lanes):
            for caster, (closest, any_hit) in rates(mesh, ray, arguments.repeats).items():
                print(f"{scene:8} {kind:10}  {caster:22} {closest / 1e6:8.2f} {any_hit / 1e6:8.2f}", flush=True)


if __name__ == "__main__":
    main()
