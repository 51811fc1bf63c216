"""The set-ups by which Mitsuba tests its projective integrators, written anew: what moves, samples, and thresholds.

Their meshes are our own: a ball of 5,120 triangles and a square of two. Facts are those of Mitsuba's
``src/integrators/tests/test_ad_integrators.py``: places, lamps, depths, samples, and how far off a derivative may be. A
derivative image may be off, relative to the reference or to 0.2 where that is less, by a mean and by a largest number; a
derivative of a loss, relative to that, by another.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import torch
from torch import Tensor

import torch_radbp as rb
from tests.scenes import load, look_at, rgb
from tests.scenes.endless import smooth_noise
from tests.scenes.meshes import icosphere
from torch_radbp.io.values.transform import rotate, scale, translate

IN_PLACE = torch.eye(4)
FLOOR_OF_ERROR = 0.2  # of the reference, below which errors are relative to this


class Bounds(NamedTuple):
    """How far off derivatives may be, relative."""

    mean: float  # over the numbers of a derivative image
    most: float  # of one of these
    backward: float  # of a loss


class SetUp(NamedTuple):
    """A scene, what moves in it, and how it is judged."""

    build: Callable[[], rb.Scene]
    names: tuple[str, ...]  # of the parameters that move
    direction: Callable[[Tensor], Tensor]  # from a parameter to its tangent
    bounds: Bounds
    max_depth: int = 2
    spp: int = 1024  # of a derivative image
    spp_backward: int = 256

    def tangents(self, scene: rb.Scene) -> dict[str, Tensor]:
        return {name: self.direction(scene.get_parameter(name).detach()) for name in self.names}


def sideways(vertices: Tensor) -> Tensor:
    """Along x."""
    return torch.tensor([1.0, 0.0, 0.0]).to(vertices).expand_as(vertices)


def growing(vertices: Tensor) -> Tensor:
    """Away from the origin."""
    return vertices.clone()


def to_the_side(pose: Tensor) -> Tensor:
    """Of a camera, along its own x."""
    tangent = torch.zeros_like(pose)
    tangent[:, 3] = pose[:, 0]
    return tangent


def view(size: int) -> dict[str, Any]:
    """The camera of all set-ups."""
    film = {"type": "hdrfilm", "width": size, "height": size, "sample_border": True,
            "rfilter": {"type": "gaussian", "stddev": 0.5}}
    return {"type": "perspective", "to_world": look_at((0, 0, 4), (0, 0, 0), (0, 1, 0)), "film": film}


def mesh(vertices: Tensor, faces: Tensor, pose, smooth: bool, **attributes: Any) -> dict[str, Any]:
    """A mesh whose vertices lie where a pose puts them, so that they move along the axes of the world."""
    pose = torch.as_tensor(pose, dtype=torch.float64)
    positions = vertices.double() @ pose[:3, :3].T + pose[:3, 3]
    return {"type": "mesh", "vertex_positions": positions.float(), "faces": faces, "recompute_normals": smooth} | attributes


def ball(pose=IN_PLACE, **attributes: Any) -> dict[str, Any]:
    """A smoothly shaded ball."""
    return mesh(*icosphere(4), pose, True, **attributes)


def square(pose=IN_PLACE, **attributes: Any) -> dict[str, Any]:
    """A flat square from -1 to 1 that faces along z."""
    corners = torch.tensor([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    texcoords = torch.tensor([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    return mesh(corners, torch.tensor([[0, 1, 2], [0, 2, 3]]), pose, False, vertex_texcoords=texcoords, **attributes)


def shining(radiance: float) -> dict[str, Any]:
    return {"type": "area", "radiance": rgb(radiance, radiance, radiance)}


def placed(size: int = 128, **objects: Any) -> Callable[[], rb.Scene]:
    """Called to build a scene of these objects."""
    return lambda: load(torch.float32, sensor=view(size), **objects)


SKY = {"type": "constant"}
WALL = {"type": "rectangle", "bsdf": {"type": "diffuse"}}
OCCLUDER = ball(translate((2, 0, 2)) @ scale((0.25, 0.25, 0.25)))
PICTURE = {"type": "bitmap", "data": smooth_noise(7, 0.0, 8.0, (64, 64), 1.2), "raw": True}
VERTICES = {name: (f"{name}.vertex_positions",) for name in ("ball", "square", "lamp", "occluder")}
SET_UPS = {
    "ball under a sky": SetUp(placed(ball=ball(), sky=SKY), VERTICES["ball"], sideways, Bounds(0.04, 0.6, 0.25)),
    "square under a sky": SetUp(placed(square=square(), sky=SKY), VERTICES["square"], sideways, Bounds(0.02, 0.5, 0.25)),
    "square lamp": SetUp(placed(lamp=square(translate((1.25, 0, 0)), emitter=shining(1.0))), VERTICES["lamp"], sideways,
                         Bounds(0.03, 1.0, 0.2)),
    "ball lamp": SetUp(placed(lamp=ball(translate((1.25, 0, 0)), emitter=shining(1.0))), VERTICES["lamp"], sideways,
                       Bounds(0.08, 2.0, 0.15)),
    "ball lamp that grows": SetUp(placed(lamp=ball(emitter=shining(1.0))), VERTICES["lamp"], growing, Bounds(0.08, 0.5, 0.1),
                                  3),
    "occluder": SetUp(placed(wall=WALL, occluder=OCCLUDER, lamp=ball(
        translate((4, 0, 4)) @ scale((0.05, 0.05, 0.05)), emitter=shining(1000.0))), VERTICES["occluder"], sideways,
        Bounds(0.02, 0.8, 0.25)),
    "receiver": SetUp(placed(square=square(), occluder=OCCLUDER, sky=SKY), VERTICES["square"], sideways,
                      Bounds(0.02, 0.5, 0.25), spp=4096),
    "textured plane": SetUp(placed(64, square=square(scale((2, 2, 2)), bsdf={"type": "diffuse", "reflectance": PICTURE}),
                                   sky=SKY), VERTICES["square"], sideways, Bounds(0.1, 56.0, 0.05)),
    "self shadowing": SetUp(placed(
        square=square(), occluder=square(translate((-1, 0, 0.5)) @ rotate((0, 1, 0), 90)),
        lamp={"type": "point", "position": [-4, 0, 6], "intensity": rgb(5, 0, 0)}, sky=SKY | {"radiance": 0.1}),
        VERTICES["square"] + VERTICES["occluder"], sideways, Bounds(0.06, 0.7, 0.35), 3),
    "ball over a glossy floor": SetUp(placed(
        32, floor={"type": "rectangle", "bsdf": {"type": "roughconductor", "alpha": 0.025},
                   "to_world": translate((0, 1.5, 0)) @ rotate((1, 0, 0), -45) @ scale((4, 4, 4))},
        ball=ball(translate((0.5, 2.0, 1.5)), bsdf={"type": "diffuse", "reflectance": rgb(1, 0.5, 0)}), sky=SKY),
        VERTICES["ball"], sideways, Bounds(0.25, 5.0, 0.2), 3, 2048),
    "camera": SetUp(placed(16, ball=ball(), sky=SKY), ("sensor.to_world",), to_the_side, Bounds(0.3, 1.6, 1.3)),
}


class Errors(NamedTuple):
    """How far off a derivative image is."""

    mean: float
    most: float

    @staticmethod
    def of(image: Tensor, reference: Tensor) -> Errors:
        off = (image - reference).abs() / reference.abs().clamp_min(FLOOR_OF_ERROR)
        return Errors(float(off.mean()), float(off.max()))


def difference(set_up: SetUp, step: float, spp: int, seed: int) -> Tensor:
    """(1, 3, H, W) central difference of images with the same samples."""
    scene, images = set_up.build(), []
    home = {name: scene.get_parameter(name).detach().clone() for name in set_up.names}
    tangents = set_up.tangents(scene)
    for side in (1, -1):
        for name, tangent in tangents.items():
            scene.get_parameter(name).data = home[name] + side * step * tangent
        with torch.no_grad():
            images.append(rb.render(scene, spp=spp, seed=seed, max_depth=set_up.max_depth))
    return (images[0] - images[1]) / (2 * step)
