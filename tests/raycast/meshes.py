"""Meshes and rays that the ray casting tests share."""

import torch
import trimesh
from torch import Tensor

from torch_radbp.raycast import Ray
from torch_radbp.tensors.vec import Vec3


def mesh(name: str, dtype: torch.dtype = torch.float32) -> tuple[Tensor, Tensor]:
    """(vertices, faces) of a named mesh around the origin, within a radius of about 2."""
    if name == "soup":
        return soup(200, dtype)
    made = {
        "box": lambda: trimesh.creation.box((2, 2, 2)),
        "sphere": lambda: trimesh.creation.icosphere(subdivisions=2),
        "fine sphere": lambda: trimesh.creation.icosphere(subdivisions=4),
        "sphere in a box": lambda: trimesh.creation.icosphere(subdivisions=1) + trimesh.creation.box((3, 3, 3)),
    }[name]()
    return torch.tensor(made.vertices, dtype=dtype), torch.tensor(made.faces, dtype=torch.int32)


def soup(count: int, dtype: torch.dtype = torch.float32) -> tuple[Tensor, Tensor]:
    """Unconnected triangles of size 1 or so, in random places."""
    generator = torch.Generator().manual_seed(11)
    centres = 2 * torch.rand(count, 1, 3, generator=generator, dtype=torch.float64) - 1
    corners = centres + 0.5 * torch.randn(count, 3, 3, generator=generator, dtype=torch.float64)
    return corners.reshape(-1, 3).to(dtype), torch.arange(3 * count, dtype=torch.int32).reshape(-1, 3)


def random_rays(lanes: int, dtype: torch.dtype = torch.float32, within: float = 0.9, seed: int = 3) -> Ray:
    """Origins uniform in a cube of half width `within`, directions normal in 3-D, hence of various lengths.

    The numbers are float32 ones in every dtype, so that the same rays can be asked in both.
    """
    generator = torch.Generator().manual_seed(seed)
    o = within * (2 * torch.rand(lanes, 3, generator=generator) - 1)
    d = torch.randn(lanes, 3, generator=generator)
    return Ray(Vec3.of(o.to(dtype)), Vec3.of(d.to(dtype)))


def single_ray(o: tuple[float, ...], d: tuple[float, ...], dtype: torch.dtype = torch.float32) -> Ray:
    return Ray(Vec3.of(torch.tensor([o], dtype=dtype)), Vec3.of(torch.tensor([d], dtype=dtype)))


def take(ray: Ray, index) -> Ray:
    """The lanes that `index` selects."""
    return Ray(*(Vec3(*(lanes[index] for lanes in vector)) for vector in ray))
