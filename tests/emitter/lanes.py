"""What reaches surface points in the scenes of lights, lane by lane."""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.utils._pytree import tree_map_only

import torch_radbp as rb
from torch_radbp.connection.light import LightNumbers
from torch_radbp.raycast import make_caster
from torch_radbp.scene.packing.pack import pack
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.tensors.vec import Ray, Vec3
from torch_radbp.vertex.interaction import SurfaceInteraction, surface_interaction


def detached(scene: rb.Scene) -> SceneTensors:
    return tree_map_only(Tensor, Tensor.detach, pack(scene))


def uniform(count: int, seed: int, dtype: torch.dtype = torch.float64, dimensions: int = 3) -> list[Tensor]:
    generator = torch.Generator().manual_seed(seed)
    return list(torch.rand(dimensions, count, generator=generator, dtype=dtype).unbind())


def light_numbers(count: int, seed: int) -> LightNumbers:
    """Random numbers for light samples; `choice` is spread evenly, so that few lanes too pick every light."""
    generator = torch.Generator().manual_seed(seed)
    choice = torch.randperm(count, generator=generator) * (1 << 32) // count
    bits = torch.randint(1 << 32, (3, count), generator=generator)
    return LightNumbers(choice.to(torch.int32), *bits.to(torch.int32).unbind())


class View(NamedTuple):
    """Rays, and what they meet."""

    ray: Ray
    hit: Any
    si: SurfaceInteraction


def cast(scene: rb.Scene, tensors: SceneTensors, ray: Ray) -> View:
    vertices, faces = tensors.triangles.vertices.p.detach().stack(), torch.stack(tensors.triangles.corners, 1)
    hit = make_caster(None, vertices, faces).intersect(ray)
    return View(ray, hit, surface_interaction(tensors, ray, hit))


def on_the_floor(scene: rb.Scene, tensors: SceneTensors, count: int, seed: int, spread: float = 1.0) -> View:
    """Surface points of the floor, seen from just above it."""
    x, y, _ = uniform(count, seed, tensors.dtype)
    o = Vec3(spread * (x - 0.5), torch.full_like(x, -0.5), spread * (y - 0.5))
    return cast(scene, tensors, Ray(o, Vec3(torch.zeros_like(x), torch.full_like(x, -1.0), torch.zeros_like(x))))


def mean_and_error(values: Tensor) -> tuple[Tensor, Tensor]:
    """The mean over lanes of (N, ...) values, and its standard error."""
    return values.mean(0), values.std(0) / len(values) ** 0.5


def at(points) -> Vec3:
    """Reference points, float64."""
    return Vec3.of(torch.as_tensor(points, dtype=torch.float64))
