"""A field of 10,000 instances of a mesh of 10,000 triangles: ``python -m benchmarks.instances`` (``--mitsuba``).

Time and memory of loading the field, of the first image and of the next one, 128 x 128 at 16 samples, depth 4; then, with
us, of forward and backward passes for the pose of one instance, of all instances, and for the vertices of the mesh. Memory
is by how much the process has grown since its imports, at the most; each side has a process of its own. ``--mitsuba``
needs mitsuba==3.9.1 and LLVM. ``--image FILE`` keeps our image.
"""

from __future__ import annotations

import argparse
import multiprocessing
import tempfile
import time
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
import trimesh

import torch_radbp as rb
from benchmarks.resident import MIB, resident
from torch_radbp.formats.image import save_image
from torch_radbp.io.values.transform import rotate, scale, translate
from torch_radbp.pose import look_at

INSTANCES, TRIANGLES, SIZE, SPP, DEPTH = 10_000, 10_000, 128, 16, 4


def write_stone(path: Path, triangles: int) -> None:
    """A PLY file of a bumpy ball of about so many triangles."""
    rings = round((triangles / 4) ** 0.5)
    ball = trimesh.creation.uv_sphere(count=(rings, 2 * rings))
    x, y, z = ball.vertices.T
    bumps = 1 + 0.12 * np.sin(5 * x + 1) * np.cos(4 * y) + 0.08 * np.sin(9 * z + 3 * x)
    trimesh.Trimesh(ball.vertices * bumps[:, None], ball.faces, process=False).export(path)


def field(stone: Path, instances: int, size: int, spp: int, larger: float = 1.0) -> dict[str, Any]:
    """The scene in Mitsuba's vocabulary, with stones so many times larger; transforms are arrays."""
    random, side = np.random.default_rng(0), int(np.ceil(instances**0.5))
    scene: dict[str, Any] = {
        "type": "scene", "integrator": {"type": "path", "max_depth": DEPTH, "rr_depth": 100},
        "camera": {"type": "perspective", "fov": 40.0, "sampler": {"type": "independent", "sample_count": spp},
                   "to_world": look_at([0, -1.1 * side, 0.45 * side], [0, -0.15 * side, 0], [0, 0, 1]).numpy(),
                   "film": {"type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"},
                            "pixel_format": "rgb"}},
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": [0.5, 0.6, 0.8]}},
        "sun": {"type": "directional", "direction": [0.5, 0.6, -0.7],
                "irradiance": {"type": "rgb", "value": [2.0, 1.8, 1.5]}},
        "ground": {"type": "rectangle", "to_world": scale((side, side, 1)),
                   "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.4, 0.35, 0.3]}}},
        "group": {"type": "shapegroup", "stone": {"type": "ply", "filename": str(stone), "bsdf": {
            "type": "diffuse", "reflectance": {"type": "rgb", "value": [0.6, 0.6, 0.55]}}}}}
    for number in range(instances):
        at = np.array([number % side, number // side, 0.3]) - [side / 2, side / 2, 0] + random.uniform(-0.3, 0.3, 3)
        turned = rotate(random.normal(size=3), random.uniform(0, 360))
        pose = translate(at) @ turned @ scale(larger * random.uniform(0.2, 0.5, 3))
        scene[f"stone_{number}"] = {"type": "instance", "to_world": pose, "shapegroup": {"type": "ref", "id": "group"}}
    return scene


def field_of(instances: int, triangles: int, resolution: int, larger: float = 1.0) -> rb.Scene:
    """The field as a scene, with a sample for each pixel."""
    with tempfile.TemporaryDirectory() as folder:
        write_stone(Path(folder) / "stone.ply", triangles)
        return rb.load_dict(field(Path(folder) / "stone.ply", instances, resolution, 1, larger))


def report(name: str, doing: Callable[[], Any], before: int) -> Any:
    """Does it, and says how long it took and by how much the process has grown at the most since `before`, bytes."""
    start = time.perf_counter()
    result = doing()
    print(f"  {name:<48}{time.perf_counter() - start:>8.2f} s {(resident('VmHWM') - before) / MIB:>9.0f} MiB", flush=True)
    return result


def ours(description: dict[str, Any], image_file: str | None) -> None:
    """Measures this renderer."""
    before = resident("VmHWM")
    scene = report("load", lambda: rb.load_dict(description), before)
    renderer = rb.Renderer(scene)
    with torch.no_grad():
        report("first image", lambda: renderer(seed=0), before)
        image = report("next image", lambda: renderer(seed=1), before)
        scene.stone_0.to_world[2, 3] += 0.1
        report("image after one instance has moved", lambda: renderer(seed=1), before)
    if image_file:
        save_image(image_file, image[0])

    def differentiate(parameters: list[torch.Tensor]) -> None:
        for parameter in parameters:
            parameter.requires_grad_()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", rb.SilhouetteWarning)
            torch.autograd.grad(renderer(seed=2).mean(), parameters)
        for parameter in parameters:
            parameter.requires_grad_(False)

    poses = [instance.to_world for instance in scene.groups[id(scene.group)]]
    for name, parameters in (("pose of one instance", poses[:1]), ("vertices", [scene.group.stone.vertex_positions]),
                             ("poses of all instances", poses)):
        for turn in ("first", "next"):
            report(f"{turn} forward + backward: {name}", partial(differentiate, parameters), before)


def mitsubas(description: dict[str, Any], image_file: str | None) -> None:
    """Measures Mitsuba."""
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")

    def translated(value):
        if isinstance(value, dict):
            return {key: translated(part) for key, part in value.items()}
        return mi.ScalarTransform4f(value) if isinstance(value, np.ndarray) else value

    before = resident("VmHWM")
    scene = report("load", lambda: mi.load_dict(translated(description)), before)
    report("first image", lambda: np.array(mi.render(scene, seed=0)), before)
    report("next image", lambda: np.array(mi.render(scene, seed=1)), before)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--instances", type=int, default=INSTANCES)
    parser.add_argument("--triangles", type=int, default=TRIANGLES)
    parser.add_argument("--size", type=int, default=SIZE, help="pixels along a side")
    parser.add_argument("--spp", type=int, default=SPP)
    parser.add_argument("--mitsuba", action="store_true", help="measure Mitsuba, too")
    parser.add_argument("--image", help="file for our image")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        stone = Path(folder) / "stone.ply"
        write_stone(stone, options.triangles)
        description = field(stone, options.instances, options.size, options.spp)
        for name, side in (("torch_radbp", ours), ("Mitsuba", mitsubas))[:1 + options.mitsuba]:
            print(f"{name}: {options.instances} instances of about {options.triangles} triangles")
            process = multiprocessing.get_context("spawn").Process(target=side, args=(description, options.image))
            process.start()
            process.join()


if __name__ == "__main__":
    main()
