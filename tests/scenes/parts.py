"""Cameras, lights, shapes and textures of scenes in which each parameter matters.

All is turned by odd angles: a basis around a normal has a kink where its z is exactly zero.
"""

from __future__ import annotations

from typing import Any

import torch

from tests.scenes import diffuse, look_at, rectangle, rgb, sensor, texels
from torch_radbp.io.values.transform import rotate, scale, translate

TO_UV = translate((0.11, -0.07, 0)) @ rotate((0, 0, 1), 25) @ scale((1.4, 1.7, 1))  # of squares
AIMED = look_at((0.9, 1.5, 2.8), (0.1, 0.05, 0), (0.1, 1, 0.2))


def bitmap(height: int = 2, width: int = 3, factor: float = 1.0, seed: int = 1, **attributes: Any) -> dict[str, Any]:
    """An image that is read beyond its border."""
    to_uv = translate((-0.31, 0.17, 0)) @ rotate((0, 0, 1), 20) @ scale((1.7, 1.4, 1))
    return {"type": "bitmap", "data": factor * texels(height, width, seed), "raw": True, "to_uv": to_uv} | attributes


def fine(height: int = 12, width: int = 13, **attributes: Any) -> dict[str, Any]:
    """An image with texels smaller than pixels, read at the level of detail that fits."""
    return bitmap(height, width, filter_type="trilinear", **attributes)


def bumps() -> dict[str, Any]:
    """A normal map of gentle slopes."""
    flat = torch.tensor([0.5, 0.5, 1.0], dtype=torch.float64)
    return bitmap(data=flat + 0.15 * (texels(2, 3, 6) - 0.5))


def heights() -> dict[str, Any]:
    """Bumps of gentle slopes."""
    return bitmap(3, 3, 0.25, 6)


def squares(color0: Any, color1: Any) -> dict[str, Any]:
    """A checkerboard with some squares in view."""
    return {"type": "checkerboard", "color0": color0, "color1": color1,
            "to_uv": TO_UV}


def printed(**attributes: Any) -> dict[str, Any]:
    return {"type": "diffuse", "reflectance": bitmap(**attributes)}


def camera(size: int = 2, fov: float = 34, **attributes: Any) -> dict[str, Any]:
    return sensor(size, (0.3, 0.4, 3.5), (0.05, 0.02, 0), fov, **attributes)


def parallel(scaled: float = 0.8, size: int = 2) -> dict[str, Any]:
    """A camera without perspective."""
    pose = look_at((0.3, 0.4, 3.5), (0.05, 0.02, 0), (0, 1, 0)) @ scale((scaled, 1.2 * scaled, 1))
    return {"type": "orthographic", "to_world": pose, "film": camera(size, rfilter="gaussian")["film"]}


def blurred(size: int = 2, fov: float = 34) -> dict[str, Any]:
    """A camera with a lens, in focus before what it sees."""
    return camera(size, fov, type="thinlens", aperture_radius=0.13, focus_distance=2.6, rfilter="gaussian")


def calibrated(size: int = 2, factor: float = 1.0, **attributes: Any) -> dict[str, Any]:
    """A camera with intrinsics and every coefficient of distortion; `factor` scales what it sees."""
    given = {"k1": -0.13, "k2": 0.07, "k3": -0.05, "k4": 0.04, "k5": 0.06, "k6": -0.03, "p1": 0.02, "p2": -0.03} | attributes
    pinhole = camera(size, rfilter="gaussian")
    return {"type": "calibrated", "to_world": pinhole["to_world"], "film": pinhole["film"], "fx": factor * 1.6 * size,
            "fy": factor * 1.7 * size, "cx": 0.47 * size - 0.5, "cy": 0.52 * size - 0.5, "skew": 0.02 * size} | given


FISHEYE = {"distortion": "fisheye", "k1": 0.06, "k2": -0.04, "k3": 0.05, "k4": -0.02, "k5": None, "k6": None, "p1": None,
           "p2": None}
THIN_PRISM = FISHEYE | {"distortion": "thin_prism_fisheye", "p1": 0.02, "p2": -0.03, "sx1": 0.03, "sy1": -0.02}
FIELD_OF_VIEW = {"distortion": "field_of_view", "omega": 0.9, "k1": None, "k2": None, "k3": None, "k4": None, "k5": None,
                 "k6": None, "p1": None, "p2": None}


def lamp(**attributes: Any) -> dict[str, Any]:
    """A lamp above that faces down."""
    return rectangle((0.5, 2.6, 1.7), 0.8, (1, 0.13, 0.21), 119, **{
        "bsdf": diffuse(0.3, 0.2, 0.4), "emitter": {"type": "area", "radiance": rgb(9, 7, 8)}} | attributes)


def floor(**attributes: Any) -> dict[str, Any]:
    """A floor without end in view."""
    return rectangle((0.1, -1.3, 0.2), 9.0, (1, 0.27, 0.19), -67, **{"bsdf": diffuse(0.5, 0.6, 0.7)} | attributes)


def plane(at=(0, 0, 0), **attributes: Any) -> dict[str, Any]:
    """A plane that fills the view."""
    return rectangle(at, 3.1, (0.35, 1, 0.23), 24, **attributes)


def sky(factor: float = 1.5) -> dict[str, Any]:
    return {"type": "envmap", "bitmap": factor * texels(4, 5, 3),
            "to_world": rotate((0.4, 1, 0.3), 50) @ rotate((1, 0.2, 0.1), 20)}


def glowing() -> dict[str, Any]:
    """A textured emitter, seen through glass or in a mirror."""
    return rectangle((0.2, -0.1, -2.3), 6.0, (0.3, 1, 0.41), 17, bsdf=diffuse(0.4, 0.5, 0.3),
                     emitter={"type": "area", "radiance": bitmap(factor=3.0, seed=4)})


def distances(**attributes: Any) -> dict[str, Any]:
    """A dented ball given by distances on a coarse grid."""
    places = torch.meshgrid(*(torch.linspace(-1, 1, count, dtype=torch.float64) for count in (4, 5, 6)), indexing="ij")
    noise = torch.as_tensor(texels(4, 10, 8)).reshape(4, 5, 6)
    grid = torch.stack(places).norm(dim=0) - 0.8 + 0.3 * (noise - 0.5)
    pose = turned((0.1, -0.05, 0.1), 11, 23, 37, size=2.4)["to_world"] @ translate((-0.5, -0.5, -0.5))
    return {"type": "sdfgrid", "grid": grid[..., None], "to_world": pose, "bsdf": diffuse(0.7, 0.5, 0.3)} | attributes


def beam(**attributes: Any) -> dict[str, Any]:
    """A panel that throws parallel light on the middle of the view."""
    return {"type": "rectangle", "to_world": AIMED @ scale((0.7, 0.7, 1)),
            "emitter": {"type": "directionalarea", "radiance": bitmap(factor=3.0)}} | attributes


def turned(at, *angles: float, size: float = 1.0, **attributes: Any) -> dict[str, Any]:
    """A shape turned by odd angles about x, y and z."""
    x, y, z = angles
    pose = translate(at) @ rotate((0, 0, 1), z) @ rotate((0, 1, 0), y) @ rotate((1, 0, 0), x) @ scale((size, size, size))
    return {"to_world": pose} | attributes


def lamps() -> dict[str, Any]:
    """More lamps of all kinds than are picked without regard to where they are, in front of the planes of `light`.

    No two have a coordinate in common, so that their tree does not hang on rounding.
    """
    found = {}
    for number in range(9):
        x, y, z = 1.1 * (number % 3 - 1.1) + 0.013 * number, 1.3 + 0.4 * (number // 3) + 0.017 * number, 2.3 - 0.1 * number
        name, pose = f"lamp_{number}", look_at((x, y, z), (0.1 * x, 0.05, 0), (0.1, 1, 0.2))
        found[name] = ({"type": "rectangle", "to_world": pose @ scale((0.2, 0.3, 1)), "bsdf": {"type": "ref", "id": "dark"},
                        "emitter": {"type": "area", "radiance": bitmap(factor=20.0, seed=number)}},
                       {"type": "point", "position": [x, y, z], "intensity": rgb(0.9, 0.8, 0.7), "sampling_weight": 2.0},
                       {"type": "spot", "to_world": pose, "intensity": rgb(1, 2, 1), "cutoff_angle": 50.0})[number % 3]
    return found
