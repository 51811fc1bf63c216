"""Derivatives of scenes in which rough surfaces reflect or bend light: the noisy ones."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import torch
from torch import Tensor

import torch_radbp as rb
from tests.scenes import cornell, diffuse, load, rectangle, sensor, texels
from tests.scenes.moving import SHIFT, TURN, rigid
from torch_radbp.io.values.transform import rotate, scale, translate


class NoisyDerivative(NamedTuple):
    """A derivative of a scene, in one direction of a parameter."""

    build: Callable[[], rb.Scene]
    name: str
    tangent: Callable[[Tensor], Tensor]


def sky() -> dict[str, Any]:
    return {"type": "envmap", "bitmap": texels(8, 16, 3)}


def painted_floor(height: float) -> dict[str, Any]:
    picture = {"type": "bitmap", "data": texels(8, 8, 1), "raw": True}
    return rectangle((0, height, 0), 4.0, (1, 0, 0), -90, bsdf={"type": "diffuse", "reflectance": picture})


def three_slabs(alpha: float) -> rb.Scene:
    """Slabs of rough glass one behind the other, before a painted lamp that fills the view."""
    slabs = {f"slab_{k}": {"type": "cube", "to_world": translate((0, 0, 0.9 - 0.7 * k)) @ rotate((0, 1, 0), 6 * k)
                           @ scale((3, 3, 0.1)), "bsdf": {"type": "ref", "id": "glass"}} for k in range(3)}
    picture = {"type": "bitmap", "data": 3 * texels(4, 4, 4), "raw": True}
    lamp = rectangle((0.2, -0.1, -2.3), 6.0, (0.3, 1, 0.41), 17, bsdf=diffuse(0.4, 0.5, 0.3),
                     emitter={"type": "area", "radiance": picture})
    return load(torch.float32, sensor=sensor(8, (0.3, 0.4, 3.5), fov=30), sky=sky(), lamp=lamp,
                glass={"type": "roughdielectric", "alpha": alpha}, **slabs)


def glass_ball(alpha: float) -> rb.Scene:
    """A ball of rough glass over a painted floor."""
    return load(torch.float32, sensor=sensor(8, (0.3, 1.2, 3.0), (0, 0.1, 0), 38), sky=sky(), floor=painted_floor(-0.6),
                glass={"type": "roughdielectric", "alpha": alpha}, ball={
                    "type": "sphere", "to_world": scale((0.6, 0.6, 0.6)), "bsdf": {"type": "ref", "id": "glass"}})


def metal_mesh(alpha: float) -> rb.Scene:
    """Waves of rough gold over a painted floor."""
    count = 12
    y, x = torch.meshgrid(torch.linspace(-1, 1, count), torch.linspace(-1, 1, count), indexing="ij")
    vertices = torch.stack([x, y, 0.15 * torch.sin(3 * x) * torch.cos(2.5 * y)], 2).reshape(-1, 3)
    first = (torch.arange(count - 1)[:, None] * count + torch.arange(count - 1)).reshape(-1, 1)
    faces = torch.cat([first + torch.tensor([0, 1, count]), first + torch.tensor([1, count + 1, count])])
    return load(torch.float32, sensor=sensor(8, (0.3, 0.4, 3.5), fov=30), sky=sky(), floor=painted_floor(-1.5),
                metal={"type": "roughconductor", "material": "Au", "alpha": alpha}, mesh={
                    "type": "mesh", "vertex_positions": vertices, "faces": faces, "recompute_normals": True,
                    "bsdf": {"type": "ref", "id": "metal"}})


def waves(vertices: Tensor) -> Tensor:
    """Moves vertices up and down."""
    return torch.stack([torch.zeros_like(vertices[:, 0])] * 2 + [torch.sin(2 * vertices[:, 0])], 1)


def derivatives(alpha: float) -> dict[str, NoisyDerivative]:
    """By name; roughness where something is rough."""
    one = torch.ones_like
    slabs, ball, metal = (lambda build=build: build(alpha) for build in (three_slabs, glass_ball, metal_mesh))
    return {
        "three slabs, index": NoisyDerivative(slabs, "glass.eta", one),
        "three slabs, roughness": NoisyDerivative(slabs, "glass.alpha.value", one),
        "three slabs, shift of one": NoisyDerivative(slabs, "slab_1.to_world", rigid(SHIFT)),
        "three slabs, turn of one": NoisyDerivative(slabs, "slab_1.to_world", rigid(TURN)),
        "glass ball, index": NoisyDerivative(ball, "glass.eta", one),
        "glass ball, roughness": NoisyDerivative(ball, "glass.alpha.value", one),
        "glass ball, shift": NoisyDerivative(ball, "ball.to_world", rigid(SHIFT)),
        "metal mesh, roughness": NoisyDerivative(metal, "metal.alpha.value", one),
        "metal mesh, vertices": NoisyDerivative(metal, "mesh.vertex_positions", waves),
        "Cornell box, colour": NoisyDerivative(lambda: cornell(torch.float32), "white.reflectance.value", one),
        "Cornell box, turn of a box": NoisyDerivative(lambda: cornell(torch.float32), "box.to_world", rigid(TURN)),
    }
