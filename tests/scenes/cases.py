"""Tiny scenes that the tests of the tracer share, and which of their parameters have derivatives."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import torch

import torch_radbp as rb
from tests.scenes.description import SKY, diffuse, load, rectangle, rgb, sensor, texels
from torch_radbp.io.values.transform import rotate, scale, translate


def furnace(reflectance=(0.3, 0.6, 0.9), emission=(1.0, 0.5, 0.25), dtype: torch.dtype = torch.float64,
            size: int = 4) -> rb.Scene:
    """A closed box around the camera whose walls emit and reflect the same everywhere."""
    walls = {"type": "cube", "flip_normals": True, "bsdf": diffuse(*reflectance),
             "emitter": {"type": "area", "radiance": rgb(*emission)}}
    scene = load(dtype, sensor=sensor(size, (0.1, 0.2, -0.3), (0.3, 0.1, 1), 60), walls=walls)
    # Loading rounds to float32; closed forms are to hold for the numbers as they are written.
    scene.get_parameter("walls.bsdf.reflectance.value").copy_(torch.tensor(reflectance, dtype=dtype))
    scene.get_parameter("walls.emitter.radiance.value").copy_(torch.tensor(emission, dtype=dtype))
    return scene


def cornell(dtype: torch.dtype = torch.float64, size: int = 8, sensors: dict[str, Any] | None = None) -> rb.Scene:
    """A room that is open at the front, with coloured side walls, a lamp and a box."""
    white = {"type": "ref", "id": "white"}
    return load(
        dtype, **({"sensor": sensor(size)} if sensors is None else sensors),
        white=diffuse(0.73, 0.71, 0.68), green=diffuse(0.11, 0.44, 0.09), red=diffuse(0.57, 0.04, 0.05),
        floor=rectangle((0, -1, 0), angle=-90, bsdf=white), ceiling=rectangle((0, 1, 0), angle=90, bsdf=white),
        back=rectangle((0, 0, -1), bsdf=white),
        left=rectangle((-1, 0, 0), axis=(0, 1, 0), angle=90, bsdf={"type": "ref", "id": "red"}),
        right=rectangle((1, 0, 0), axis=(0, 1, 0), angle=-90, bsdf={"type": "ref", "id": "green"}),
        box={"type": "cube", "to_world": translate((0.3, -0.65, 0.1)) @ rotate((0, 1, 0), 25) @ scale((0.3, 0.35, 0.3)),
             "bsdf": white},
        light=rectangle((0.1, 0.97, 0), 0.4, angle=90, bsdf=diffuse(0.2, 0.3, 0.4),
                        emitter={"type": "area", "radiance": rgb(9, 7, 4)}))


def textured(wrap_mode: str = "repeat", filter_type: str = "bilinear", dtype: torch.dtype = torch.float64) -> rb.Scene:
    """A floor with a bitmap whose coordinates leave the unit square, a wall, and a lamp."""
    to_uv = translate((-0.7, -0.3, 0)) @ scale((2.6, 2.1, 1))
    bitmap = {"type": "bitmap", "data": texels(4, 5), "wrap_mode": wrap_mode, "filter_type": filter_type, "to_uv": to_uv}
    return load(
        dtype, sensor=sensor(8, (0, 1.2, 3), (0, -0.1, 0), 45),
        floor=rectangle((0, -0.5, 0), 1.3, angle=-90, bsdf={"type": "diffuse", "reflectance": bitmap}),
        wall=rectangle((0, 0.3, -1), bsdf=diffuse(0.6, 0.5, 0.4)),
        light=rectangle((0, 1.5, 0.5), 0.5, angle=90, emitter={"type": "area", "radiance": rgb(6, 7, 8)}))


def two_sided(dtype: torch.dtype = torch.float64) -> rb.Scene:
    """Sheets with two materials, seen from the front and from behind, under a sky."""
    faces = {"type": "twosided", "front": {"type": "diffuse", "reflectance": {"type": "bitmap", "data": texels(3, 2, 5)}},
             "behind": diffuse(0.8, 0.3, 0.1)}
    return load(
        dtype, sensor=sensor(8, (0.3, 0.8, 3.5), (0, 0, 0), 45), faces=faces,
        front=rectangle((-0.6, 0.1, 0), 0.6, (0, 1, 0), 25, bsdf={"type": "ref", "id": "faces"}),
        reversed=rectangle((0.7, 0.1, 0.2), 0.6, (0, 1, 0), 160, bsdf={"type": "ref", "id": "faces"}),
        floor=rectangle((0, -0.6, 0), 1.5, angle=-90, bsdf={"type": "twosided", "same": diffuse(0.5, 0.6, 0.7)}),
        sky=SKY)


def textured_lamp(dtype: torch.dtype = torch.float64) -> rb.Scene:
    """A lamp with a bitmap, in view and above a floor, under a dim sky."""
    radiance = {"type": "bitmap", "data": 8 * texels(3, 4, 7)}
    return load(
        dtype, sensor=sensor(8, (0, 0.5, 3.5), (0, 0, 0), 45),
        floor=rectangle((0, -0.6, 0), 1.3, angle=-90, bsdf=diffuse(0.5, 0.6, 0.7)),
        lamp=rectangle((0, 0.4, -0.8), 0.7, (1, 0, 0), 30, bsdf=diffuse(0.3, 0.2, 0.4),
                       emitter={"type": "area", "radiance": radiance}),
        sky={"type": "constant", "radiance": rgb(0.2, 0.1, 0.3)})


def sky_and_points(dtype: torch.dtype = torch.float64) -> rb.Scene:
    """A box on a floor under a sky and two point lights."""
    return load(
        dtype, sensor=sensor(8, (0, 1, 3.5), (0, 0, 0), 45),
        floor=rectangle((0, -0.5, 0), 1.5, angle=-90, bsdf=diffuse(0.5, 0.6, 0.7)),
        box={"type": "cube", "to_world": translate((0, -0.2, 0)) @ rotate((0, 1, 0), 30) @ scale((0.3, 0.3, 0.3)),
             "bsdf": diffuse(0.8, 0.4, 0.2)},
        sky={"type": "constant", "radiance": rgb(0.3, 0.4, 0.6)},
        lamp={"type": "point", "position": [1.0, 1.5, 1.0], "intensity": rgb(3, 2, 1)},
        spark={"type": "point", "position": [-1.2, 0.8, 0.4], "intensity": rgb(0.5, 1, 2)})


class Case(NamedTuple):
    """A scene and all its parameters that have derivatives."""

    build: Callable[..., rb.Scene]
    arguments: dict[str, Any]
    parameters: tuple[str, ...]

    def scene(self, dtype: torch.dtype = torch.float64) -> rb.Scene:
        return self.build(dtype=dtype, **self.arguments)


CASES = {
    "cornell": Case(cornell, {}, ("white.reflectance.value", "green.reflectance.value", "red.reflectance.value",
                                  "light.bsdf.reflectance.value", "light.emitter.radiance.value")),
    **{f"{wrap_mode}_{filter_type}": Case(
        textured, {"wrap_mode": wrap_mode, "filter_type": filter_type},
        ("floor.bsdf.reflectance.data", "wall.bsdf.reflectance.value", "light.emitter.radiance.value"))
       for wrap_mode in ("repeat", "mirror", "clamp") for filter_type in ("bilinear", "nearest", "trilinear")},
    "two_sided": Case(two_sided, {}, ("faces.brdf_0.reflectance.data", "faces.brdf_1.reflectance.value",
                                      "floor.bsdf.brdf_0.reflectance.value", "sky.radiance.value")),
    "textured_lamp": Case(textured_lamp, {}, ("floor.bsdf.reflectance.value", "lamp.bsdf.reflectance.value",
                                              "lamp.emitter.radiance.data", "sky.radiance.value")),
    "sky_and_points": Case(sky_and_points, {}, ("floor.bsdf.reflectance.value", "box.bsdf.reflectance.value",
                                                "sky.radiance.value", "lamp.intensity.value", "spark.intensity.value")),
}


