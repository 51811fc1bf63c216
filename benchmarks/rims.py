"""Derivatives at silhouettes of smoothly shaded meshes against finite differences: ``python -m benchmarks.rims``.

A black band lies along the outline of a mesh whose vertex normals turn away from the viewer before its triangles do, and the
image jumps at both borders of the band. Each row of the table is a scene in which one thing moves, and has the derivative of
a weighted sum of the image by central differences, of two images of the same samples a step apart, and by the backward pass
with samples of its own. `beyond noise` is how far the two are apart, less two standard errors, as a share of the difference;
an asterisk where that is more than 2%. `half` is the difference with half the step. Steps are a small part of a pixel.
Batches are added until the standard errors are below ``--noise``. ``--only "camera,lamp"`` picks rows by parts of names.
"""

from __future__ import annotations

import argparse
import math
import time
import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.func import functional_call

import torch_radbp as rb
from tests.scenes import diffuse, load, look_at, meshes, rgb, texels
from tests.scenes.meshes import POSE, icosphere
from torch_radbp.io.values.transform import rotate, scale, translate

SIZE = 32  # pixels
STEP = 0.1  # pixels, that what moves is moved to either side
SPP = 64  # of an image
FEWEST = 8  # batches
ENOUGH = 0.02  # beyond noise
SKY = {"type": "constant", "radiance": rgb(1, 1, 1)}
SURROUNDINGS = {"type": "envmap", "bitmap": texels(8, 16)}
GLOW = {"emitter": {"type": "area", "radiance": rgb(3, 2, 1)}}
GREY = {"bsdf": diffuse(0.8, 0.6, 0.4)}
VIEW = {"to_world": look_at((0, 0, 3.5), (0, 0, 0), (0, 1, 0)),
        "film": {"type": "hdrfilm", "width": SIZE, "height": SIZE, "rfilter": {"type": "box"}}}
CAMERAS = {"perspective": {"type": "perspective", "fov": 30},
           "thinlens": {"type": "thinlens", "fov": 30, "aperture_radius": 0.1, "focus_distance": 3.0},
           "orthographic": {"type": "orthographic"},
           "calibrated, distorted": {"type": "calibrated", "fx": 55.0, "k1": 0.1, "k2": -0.05},
           "fisheye": {"type": "calibrated", "fx": 55.0, "distortion": "fisheye", "k1": 0.05}}
PIXEL = 2 * 3.5 * math.tan(math.radians(15)) / SIZE  # at the origin, of the first of them

Direction = Callable[[Tensor], Tensor]


class Case(NamedTuple):
    """A scene in which one thing moves."""

    objects: dict[str, Any]
    name: str  # of what moves
    direction: Direction  # in which, from its value; by about a unit of length
    depth: int  # of paths
    ramp: bool = False  # whether the weights of pixels rise to the right, or are all 1


def grown(value: Tensor) -> Tensor:
    """Away from the origin, of vertices."""
    return value


def shifted(value: Tensor) -> Tensor:
    """To the right, of vertices."""
    return torch.tensor([1.0, 0.0, 0.0], dtype=value.dtype).expand_as(value)


def nearer(value: Tensor) -> Tensor:
    """Towards the origin and to a side, of the pose of a camera."""
    direction = torch.zeros_like(value)
    direction[:3, 3] = torch.tensor([0.5, -0.5, -1.5])
    return direction


def mesh(vertices: Tensor, faces: Tensor, smooth: bool = True, **attributes: Any) -> dict[str, Any]:
    return {"type": "mesh", "vertex_positions": vertices, "faces": faces, "recompute_normals": smooth, **attributes}


def bumpy(subdivisions: int, **attributes: Any) -> dict[str, Any]:
    """A bumpy ball of 20 * 4^subdivisions triangles."""
    shape = meshes.ball(subdivisions)
    return mesh(placed(shape["vertex_positions"]), shape["faces"], **attributes)


def rabbit(**attributes: Any) -> dict[str, Any]:
    """A body with a head and two ears, of 5,120 triangles, which hides parts of itself."""
    vertices, faces = icosphere(4)
    lumps = (((0.5, 0.7, 0.5), 0.35, 0.35), ((0.45, 0.85, 0.1), 0.9, 0.16), ((0.2, 0.9, 0.45), 0.9, 0.16))
    radius = torch.full((len(vertices),), 0.75, dtype=torch.float64)
    for middle, height, width in lumps:
        towards = torch.nn.functional.normalize(torch.tensor(middle, dtype=torch.float64), dim=0)
        radius += height * torch.exp(-(vertices - towards).square().sum(1) / width**2)
    return mesh(0.7 * vertices * radius[:, None], faces, **attributes)


def ball(triangles: int, **attributes: Any) -> dict[str, Any]:
    """A ball of about as many triangles, between meridians and circles of latitude."""
    circles = round(math.sqrt(triangles) / 2)
    meridians = round(triangles / (2 * circles))
    angle = torch.arange(meridians, dtype=torch.float64) * (2 * math.pi / meridians)
    height = torch.arange(1, circles + 1, dtype=torch.float64)[:, None] * (math.pi / (circles + 1))
    around = torch.stack([height.sin() * angle.cos(), height.sin() * angle.sin(), height.cos().expand(-1, meridians)], -1)
    poles = torch.tensor([[0.0, 0, 1], [0, 0, -1]], dtype=torch.float64)
    vertices = torch.cat([around.reshape(-1, 3), poles])
    here = torch.arange(meridians)
    after, last = (here + 1) % meridians, meridians * (circles - 1)
    faces = [torch.stack([torch.full_like(here, len(vertices) - 2), here, after], 1),
             torch.stack([torch.full_like(here, len(vertices) - 1), after + last, here + last], 1)]
    for row in range(0, last, meridians):
        faces += [torch.stack([here + row, here + row + meridians, after + row], 1),
                  torch.stack([after + row, here + row + meridians, after + row + meridians], 1)]
    return mesh(placed(vertices), torch.cat(faces), **attributes)


def placed(vertices: Tensor) -> Tensor:
    """Vertices turned and moved so that nothing is symmetric."""
    pose = torch.from_numpy(POSE)
    return vertices @ pose[:3, :3].T + pose[:3, 3]


def zero_set() -> dict[str, Any]:
    """The zero set of distances to a ball, on a coarse grid."""
    x, y, z = torch.meshgrid(*(torch.linspace(-1, 1, 8, dtype=torch.float64),) * 3, indexing="ij")
    grid = (torch.sqrt(x**2 + y**2 + z**2) - 0.8 + 0.05 * torch.sin(4 * x + 1) * torch.sin(3 * y))[..., None]
    pose = translate((-0.6, -0.55, 0)) @ rotate((1, 2, 3), 20) @ scale((1.2, 1.2, 1.2))
    return {"type": "sdfgrid", "grid": grid.numpy().astype(np.float32), "to_world": pose}


def camera(kind: str = "perspective") -> dict[str, Any]:
    return VIEW | CAMERAS[kind]


def cases() -> dict[str, Case]:
    """The rows of the table."""
    found = {}
    for subdivisions in (2, 4, 5):
        count = f"{20 * 4**subdivisions:,} triangles"
        for light, sky in (("constant", SKY), ("envmap", SURROUNDINGS)):
            objects = {"camera": camera(), "sky": sky, "shape": bumpy(subdivisions, **GREY)}
            found[f"bumpy ball, {count}, {light}, scaled"] = Case(objects, "shape.vertex_positions", grown, 2)
            found[f"bumpy ball, {count}, {light}, moved"] = Case(objects, "shape.vertex_positions", shifted, 2, True)
        found[f"bumpy ball, {count}, constant, camera"] = Case(
            objects | {"sky": SKY}, "camera.to_world", nearer, 2, True)
        found[f"bumpy ball, {count}, constant, scaled, flat"] = Case(
            {"camera": camera(), "sky": SKY, "shape": bumpy(subdivisions, smooth=False, **GREY)}, "shape.vertex_positions",
            grown, 2)
    for smooth in (True, False):
        flat = "" if smooth else ", flat"
        found[f"rabbit, lamp, scaled{flat}"] = Case(
            {"camera": camera(), "shape": rabbit(smooth=smooth, **GLOW)}, "shape.vertex_positions", grown, 1)
        found[f"rabbit, constant, scaled{flat}"] = Case(
            {"camera": camera(), "sky": SKY, "shape": rabbit(smooth=smooth, **GREY)}, "shape.vertex_positions", grown, 2)
    values = {"camera": camera(), "sky": SKY, "shape": zero_set() | GREY}
    found["sdfgrid, values"] = Case(values, "shape.grid", torch.ones_like, 2)
    found["sdfgrid, values, analytic normals"] = Case(
        values | {"shape": values["shape"] | {"normals": "analytic"}}, "shape.grid", torch.ones_like, 2)
    for triangles in (100, 1000, 10_000, 100_000):
        for what, light, depth in (("lamp", GLOW, 1), ("constant", GREY, 2)):
            objects = {"camera": camera(), "sky": SKY, "shape": ball(triangles, **light)}
            if depth == 1:
                del objects["sky"]
            found[f"ball, {triangles:,} triangles, {what}, scaled"] = Case(objects, "shape.vertex_positions", grown, depth)
    vertices, faces = icosphere(3)
    lamp = mesh(placed(vertices), faces, False, vertex_normals=placed(vertices) - placed(torch.zeros(1, 3).double()), **GLOW)
    for what, direction, ramp in (("scaled", grown, False), ("moved", shifted, True)):
        found[f"lamp of exact normals, 1,280 triangles, {what}"] = Case(
            {"camera": camera(), "shape": lamp}, "shape.vertex_positions", direction, 1, ramp)
    for kind in CAMERAS:
        objects = {"camera": camera(kind), "sky": SKY, "shape": bumpy(3, **GREY)}
        found[f"{kind}, bumpy ball scaled"] = Case(objects, "shape.vertex_positions", grown, 2)
        found[f"{kind}, camera moved"] = Case(objects, "camera.to_world", nearer, 2, True)
    return found


class Mean:
    """The mean of some numbers, and its standard error."""

    def __init__(self) -> None:
        self.values: list[float] = []

    @property
    def value(self) -> float:
        return float(np.mean(self.values))

    @property
    def error(self) -> float:
        return float(np.std(self.values, ddof=1)) / math.sqrt(len(self.values))


class Measurement:
    """The derivative of a case, by batches of differences and of backward passes."""

    def __init__(self, case: Case) -> None:
        scene = load(torch.float32, **case.objects)
        self.renderer = rb.Renderer(scene, spp=SPP, max_depth=case.depth, share_samples=True)
        self.renderer.jump_watch.looks.clear()
        self.name, self.value = f"scene.{case.name}", scene.get_parameter(case.name).detach().clone()
        self.direction = case.direction(self.value)
        self.weights = torch.linspace(-1, 1, SIZE).expand(SIZE, SIZE) if case.ramp else torch.ones(SIZE, SIZE)
        self.step = STEP * PIXEL
        self.parameters = {f"scene.{name}": value.detach() for name, value in scene.named_parameters()}

    def sum_at(self, value: Tensor, seed: int) -> Tensor:
        image = functional_call(self.renderer, self.parameters | {self.name: value}, kwargs={"seed": seed})
        return (image[0].double() * self.weights).sum()

    def difference(self, seed: int, share: float = 1.0) -> float:
        """Central, of a share of the step."""
        step = share * self.step
        with torch.no_grad():
            after, before = (self.sum_at(self.value + way * self.direction, seed) for way in (step, -step))
        return float(after - before) / (2 * step)

    def backward(self, seed: int) -> float:
        """The derivative that the renderer computes."""
        value = self.value.clone().requires_grad_()
        gradient, = torch.autograd.grad(self.sum_at(value, seed), value)
        return float((gradient.double() * self.direction).sum())


def measured(case: Case, noise: float, most: int) -> tuple[Mean, Mean, Mean]:
    """Differences, differences with half the step, and the backward pass; batches until the noise is below, or `most`."""
    measurement, means = Measurement(case), (Mean(), Mean(), Mean())
    ways = (measurement.difference, lambda seed: measurement.difference(seed, 0.5), measurement.backward)
    for number, (mean, way) in enumerate(zip(means, ways)):
        while len(mean.values) < FEWEST or (mean.error > noise * abs(mean.value) and len(mean.values) < most):
            mean.values.append(way(1 + number * most + len(mean.values)))
    return means


def row(name: str, found: tuple[Mean, Mean, Mean], seconds: float) -> str:
    """A line of the table."""
    difference, half, ours = found
    errors = math.hypot(difference.error, ours.error)
    beyond = max(0.0, abs(difference.value - ours.value) - 2 * errors) / abs(difference.value)
    cells = [name, *(f"{mean.value:.4g} +- {mean.error:.2g}" for mean in found),
             f"{ours.value / difference.value - 1:+.1%}", f"{beyond:.1%}{' *' if beyond > ENOUGH else ''}", f"{seconds:.0f}"]
    return "| " + " | ".join(cells) + " |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--noise", type=float, default=0.015, help="standard errors as a share of the derivative")
    parser.add_argument("--most", type=int, default=256, help=f"batches of {SPP} samples a pixel, at most")
    parser.add_argument("--only", default="", help="parts of names, with commas between")
    options = parser.parse_args()
    warnings.simplefilter("ignore", rb.SilhouetteWarning)
    print(f"{SIZE} x {SIZE} pixels; step {STEP} pixels to either side, half of it in the third column\n")
    headings = ("case", "differences", "half the step", "ours", "off by", "beyond noise", "seconds")
    print("| " + " | ".join(headings) + " |\n|" + "---|" * len(headings), flush=True)
    for name, case in cases().items():
        if any(part in name for part in options.only.split(",")):
            start = time.perf_counter()
            print(row(name, measured(case, options.noise, options.most), time.perf_counter() - start), flush=True)


if __name__ == "__main__":
    main()
