"""Smoke: boxes of media that vary in space."""

from __future__ import annotations

import torch

from tests.scenes import diffuse, load, overhead, rectangle, rgb
from tests.scenes.media import BLACK

NULL = {"type": "null"}
SETTINGS = {"spp": 8, "max_depth": 4, "rr_depth": 2}
MOVING = ["box.to_world", "stone.to_world", "floor.to_world", "camera.to_world", "bulb.position"]


def grid(channels: int = 1, size: tuple[int, ...] = (9, 5, 12), scale: float = 1.0) -> torch.Tensor:
    """Values in [0, 1], of which some are 0; no side is a multiple of what a cell of the coarse grid holds."""
    generator = torch.Generator().manual_seed(channels)
    values = torch.rand(*size, channels, generator=generator, dtype=torch.float64).square()
    values[:3] = 0.0
    return values * scale


def placed(half: float = 1.0, height: float = 1.5) -> torch.Tensor:
    """The pose of a unit cube that fills a cube of this half side, with its middle at a height."""
    pose = torch.eye(4, dtype=torch.float64) * 2 * half
    pose[:3, 3] = torch.tensor([-half, -half, height - half])
    pose[3, 3] = 1.0
    return pose


def smoke(data=None, albedo=(0.9, 0.6, 0.3), scale: float = 2.0, g: float = 0.4, **more) -> dict:
    data = grid() if data is None else data
    return {"type": "heterogeneous", "scale": scale, "albedo": rgb(*albedo) if isinstance(albedo, tuple) else albedo,
            "sigma_t": {"type": "gridvolume", "data": data, "to_world": placed()}, "phase": {"type": "hg", "g": g}, **more}


def box(medium: dict, half: float = 1.0, bsdf: dict = NULL) -> dict:
    pose = torch.diag(torch.tensor([half, half, half, 1.0]))
    pose[2, 3] = 1.5
    return {"type": "cube", "to_world": pose, "bsdf": bsdf, "interior": medium}


def room(medium: dict, bsdf: dict = NULL, half: float = 1.0, **more):
    """A box of smoke with a stone in it over a floor, under a lamp, a point light and a sky."""
    return load(torch.float64, camera=overhead(4, 4.0, 1.0), floor=rectangle((0, 0, 0), 3.0, bsdf=diffuse(0.6, 0.5, 0.4)),
                box=box(medium, half, bsdf), stone={"type": "sphere", "center": [0.3, 0.2, 1.2], "radius": 0.4},
                lamp=rectangle((0.3, -0.8, 3.0), 0.4, (1, 0, 0), 170, bsdf=BLACK,
                               emitter={"type": "area", "radiance": rgb(3, 2, 1)}),
                bulb={"type": "point", "position": [-0.5, 0.6, 3.5], "intensity": rgb(2, 3, 4)},
                sky={"type": "constant", "radiance": rgb(0.2, 0.3, 0.4)}, **more)


NAMES = ["box.interior.sigma_t.data", "box.interior.albedo.data", "box.interior.scale", "box.interior.phase_function.g",
         "stone.bsdf.reflectance.value", "lamp.emitter.radiance.value", "sky.radiance.value"]


def varied(channels: int = 1) -> dict:
    return smoke(grid(channels), {"type": "gridvolume", "data": 0.9 - 0.7 * grid(3, (4, 3, 2)), "to_world": placed()})
