"""What fills the view, and lights without edges there: planes, meshes, panes and smooth textures that repeat.

Planes are endless: so large that their borders do not count. Everything is turned, so that no symmetry hides an error.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torch import Tensor

from tests.scenes import diffuse, look_at, rgb, sensor
from tests.scenes.quadrilateral import mesh_file
from torch_radbp.io.values.transform import rotate, scale, translate

HALF = 40.0  # half the width of an endless plane
PERIOD = 4.0  # of its texture, in units of length
TILT, ANGLE = (0.8, 0.5, 0.33), 24.0  # how planes are turned
SIZE = 16


def smooth_noise(seed: int, low: float = 0.1, high: float = 0.9, shape: tuple[int, int] = (48, 48),
                 blur: float = 3.5) -> np.ndarray:
    """(H, W, 3) noise from `low` to `high` that repeats without a seam, blurred by a Gaussian of `blur` texels."""
    noise = np.random.default_rng(seed).standard_normal((*shape, 3))
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(shape[0]), np.fft.fftfreq(shape[1]), indexing="ij"))
    blurred = np.fft.ifft2(np.fft.fft2(noise, axes=(0, 1)) * np.exp(-2 * (np.pi * blur * frequency[..., None]) ** 2),
                           axes=(0, 1)).real
    smallest, largest = blurred.min((0, 1)), blurred.max((0, 1))
    return low + (high - low) * (blurred - smallest) / (largest - smallest)


def endless_texture(seed: int, low: float = 0.1, high: float = 0.9, half: float = HALF, **attributes: Any) -> dict[str, Any]:
    """Smooth noise that repeats every `PERIOD` on a rectangle with half width `half`."""
    repeats = 2 * half / PERIOD
    return {"type": "bitmap", "data": smooth_noise(seed, low, high),
            "to_uv": translate((0.13, 0.37, 0)) @ scale((repeats, repeats, 1))} | attributes


def textured(seed: int = 1, half: float = HALF, **attributes: Any) -> dict[str, Any]:
    return {"type": "diffuse", "reflectance": endless_texture(seed, half=half, **attributes)}


def plane(at=(0, 0, 0), axis=TILT, angle: float = ANGLE, half: float = HALF, **attributes: Any) -> dict[str, Any]:
    """An endless rectangle; faces +z if it is not turned."""
    return {"type": "rectangle", "to_world": translate(at) @ rotate(axis, angle) @ scale((half, half, half))} | attributes


def bright_plane(seed: int, at, axis=TILT, angle: float = ANGLE, high: float = 2.0) -> dict[str, Any]:
    """An endless textured emitter."""
    return plane(at, axis, angle, bsdf=diffuse(0, 0, 0),
                 emitter={"type": "area", "radiance": endless_texture(seed, 0.1, high)})


def camera(**attributes: Any) -> dict[str, Any]:
    return sensor(SIZE, (0.5, -0.4, 2.6), (0.1, 0.15, 0), 40, **{"rfilter": "gaussian"} | attributes)


def point(at=(0.7, 0.9, 1.8)) -> dict[str, Any]:
    return {"type": "point", "position": list(at), "intensity": rgb(9, 7, 5)}


def envmap() -> dict[str, Any]:
    return {"type": "envmap", "bitmap": smooth_noise(5, 0.05, 3.0, (24, 48), 2.5),
            "to_world": rotate((0.3, 1, 0.4), 40)}


def grid_mesh(height: Callable, cells: int = 12, half: float = 5.0, normals: bool = True, at=(0, 0, 0), axis=TILT,
              angle: float = ANGLE, **attributes: Any) -> dict[str, Any]:
    """A mesh z = height(x, y) with its exact normals, turned as a plane is."""
    axis_of_grid = torch.linspace(-half, half, cells + 1, dtype=torch.float64)
    y, x = torch.meshgrid(axis_of_grid, axis_of_grid, indexing="ij")
    x, y = x.reshape(-1).requires_grad_(), y.reshape(-1).requires_grad_()
    z = height(x, y) + 0 * (x + y)
    slope_x, slope_y = torch.autograd.grad(z.sum(), (x, y))
    x, y, z = x.detach(), y.detach(), z.detach()
    normal = torch.stack([-slope_x, -slope_y, torch.ones_like(z)], 1)
    corner = (torch.arange(cells)[:, None] * (cells + 1) + torch.arange(cells)).reshape(-1)
    faces = torch.cat([torch.stack([corner, corner + 1, corner + cells + 2], 1),
                       torch.stack([corner, corner + cells + 2, corner + cells + 1], 1)])
    pose = torch.as_tensor(translate(at) @ rotate(axis, angle), dtype=torch.float64)
    mesh = {"type": "mesh", "vertex_positions": torch.stack([x, y, z], 1), "faces": faces, "to_world": pose,
            "vertex_texcoords": torch.stack([x, y], 1) / PERIOD + 0.2}
    if normals:
        mesh["vertex_normals"] = torch.nn.functional.normalize(normal, dim=1)
    return mesh | attributes


def shaded_as(height: Callable) -> dict[str, Any]:
    """A flat textured mesh with the normals of another."""
    return grid_mesh(flat, bsdf=MESH_TEXTURE, vertex_normals=grid_mesh(height)["vertex_normals"])


def flat(x: Tensor, y: Tensor) -> Tensor:
    return 0 * x


def wavy(x: Tensor, y: Tensor) -> Tensor:
    return 0.12 * torch.sin(1.1 * x + 0.4) * torch.cos(0.9 * y - 0.3)


def bowl(x: Tensor, y: Tensor) -> Tensor:
    return 0.06 * (x * x + 0.8 * y * y)


def lamp(soft: bool, half: float = 0.8) -> dict[str, Any]:
    """A textured emitter outside the view that lights it; `soft`: its light fades out before its edges."""
    data = smooth_noise(8, 2.0, 14.0, (32, 32))
    if soft:
        fade = np.sin(np.pi * (np.arange(32) + 0.5) / 32) ** 2
        data = data * 2.5 * np.clip(fade - fade[1], 0, None)[:, None, None] * np.clip(fade - fade[1], 0, None)[None, :, None]
    pose = look_at((1.0, 1.3, 1.9), (0.1, 0.1, 0), (0, 0, 1)) @ scale((half, half, half))
    return {"type": "rectangle", "to_world": pose, "bsdf": diffuse(0, 0, 0),
            "emitter": {"type": "area", "radiance": {"type": "bitmap", "data": data, "wrap_mode": "clamp"}}}


def projector() -> dict[str, Any]:
    return {"type": "projector", "irradiance": {"type": "bitmap", "data": smooth_noise(6, 0.2, 3.0)}, "scale": 2.0,
            "to_world": look_at((-0.8, 0.9, 2.4), (0.1, 0.1, 0), (0, 1, 0)), "fov": 90}


def window(bsdf: dict[str, Any], front: Callable, back: Callable, thickness: float = 0.5) -> dict[str, Any]:
    """A sheet of glass between two surfaces, normals outwards, with a bright plane behind it."""
    far = rotate((0, 1, 0), 180)
    return {"glass": bsdf,
            "front": grid_mesh(front, half=7.0, cells=20, at=(0, 0, 0.4), angle=14, bsdf={"type": "ref", "id": "glass"}),
            "rear": grid_mesh(back, half=7.0, cells=20, at=(0, 0, 0.4 - thickness), angle=14,
                              bsdf={"type": "ref", "id": "glass"}) | {
                "to_world": translate((0, 0, 0.4 - thickness)) @ rotate(TILT, 14) @ far},
            "behind": bright_plane(9, (0, 0, -1.3), angle=20)}


def rough_sheet(distribution: str = "beckmann", z: float = -4.0) -> dict[str, Any]:
    """Rough glass without a rear side, as the boundary of a half space, with a bright plane inside it at `z`.

    It is so far behind that the glass visibly blurs it, without which glued directions have much noise; attached ones
    have less if what moves sideways is near.
    """
    return {"sheet": plane((0, 0, 0.3), bsdf={"type": "roughdielectric", "distribution": distribution, "alpha": 0.25,
                                              "int_ior": 1.5}),
            "behind": bright_plane(9, (0, 0, z), angle=20)}


def shown() -> dict[str, Any]:
    """A waved sheet that a mirroring instance shows."""
    pose = translate((0.2, -0.1, 0.1)) @ rotate((0.1, 1, 0.3), 8) @ scale((-1.1, 0.9, 1.2))
    return {"group": {"type": "shapegroup", "sheet": grid_mesh(wavy, bsdf=MESH_TEXTURE)},
            "shown": {"type": "instance", "to_world": pose, "group": {"type": "ref", "id": "group"}}}


def tube() -> dict[str, Any]:
    """A cylinder around camera and light, seen from inside."""
    texture = {"type": "bitmap", "data": smooth_noise(2), "to_uv": translate((0.13, 0.37, 0)) @ scale((5, 20, 1))}
    return {"type": "cylinder", "p0": [-40, 0.1, -0.2], "p1": [40, -0.1, 0.1], "radius": 3.0, "flip_normals": True,
            "bsdf": {"type": "diffuse", "reflectance": texture}}


def mesh_of_file(suffix: str) -> dict[str, Any]:
    pose = translate((0, 0, 0)) @ rotate(TILT, ANGLE) @ scale((20, 20, 1))
    return {"type": suffix, "filename": mesh_file(suffix), "to_world": pose}


def relief() -> dict[str, Any]:
    """Hills given by distances on a coarse grid, which fill the view."""
    height = torch.as_tensor(smooth_noise(5, 0.35, 0.65, (6, 7), 1.0)[..., 0])
    grid = torch.linspace(0, 1, 4, dtype=torch.float64)[:, None, None] - height
    pose = rotate(TILT, ANGLE) @ scale((2 * HALF, 2 * HALF, 1)) @ translate((-0.5, -0.5, -0.5))
    return {"type": "sdfgrid", "grid": grid[..., None], "to_world": pose, "bsdf": diffuse(0.5, 0.6, 0.7)}


MESH_TEXTURE = {"type": "diffuse", "reflectance": {"type": "bitmap", "data": smooth_noise(1)}}
