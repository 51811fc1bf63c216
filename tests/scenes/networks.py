"""Scenes with networks in the place of textures."""

from __future__ import annotations

import torch
from torch import nn

import torch_radbp as rb
from tests.scenes import diffuse, load, rectangle, rgb, sensor
from torch_radbp.io.values.transform import rotate, scale, translate

LAMP = {"type": "area", "radiance": rgb(6, 7, 8)}
WHITE = diffuse(0.6, 0.5, 0.4)


def mlp(inputs: int, outputs: int, seed: int = 0, width: int = 4) -> nn.Module:
    """A small network onto (0, 1)."""
    generator = torch.Generator().manual_seed(seed)
    module = nn.Sequential(nn.Linear(inputs, width), nn.Tanh(), nn.Linear(width, outputs), nn.Sigmoid())
    for parameter in module.parameters():
        parameter.data.normal_(generator=generator)
    return module


def textured(module: nn.Module, of: str = "uv") -> dict:
    return {"type": "diffuse", "reflectance": rb.NeuralTexture(module, of)}


def room(dtype: torch.dtype = torch.float64) -> rb.Scene:
    """Networks as colour and as roughness, of coordinates and of positions, two of them in one queue."""
    metal = {"type": "roughconductor", "alpha": rb.NeuralTexture(mlp(3, 1, 2), of="position"), "material": "Au"}
    return load(
        dtype, sensor=sensor(5, (0, 1.2, 3), (0, -0.1, 0), 45), floor=rectangle((0, -0.5, 0), 1.3, angle=-90, bsdf=textured(
            mlp(2, 3))), wall=rectangle((0, 0.3, -1), bsdf={"type": "diffuse", "reflectance": mlp(2, 1, 1)}),
        ball={"type": "sphere", "to_world": translate((0.2, -0.2, 0)) @ scale((0.3, 0.3, 0.3)), "bsdf": metal},
        box={"type": "cube", "to_world": translate((-0.6, -0.3, 0)) @ rotate((0, 1, 0), 30) @ scale((0.2, 0.2, 0.2)),
             "bsdf": textured(mlp(3, 3, 3), "position")},
        light=rectangle((0, 1.5, 0.5), 0.5, angle=90, emitter=LAMP))


class Function(nn.Module):
    """A module without parameters."""

    def __init__(self, function):
        super().__init__()
        self.function = function

    def forward(self, place):
        return self.function(place)


def bright(inputs: int, seed: int) -> nn.Module:
    return nn.Sequential(mlp(inputs, 3, seed), Function(lambda value: 5.0 * value))


def shining(radiance, kind: str = "area") -> dict:
    return {"type": kind, "radiance": radiance}


def lit_room(lamp=None, other=None, kind: str = "area", lamps: int = 0, dtype: torch.dtype = torch.float64) -> rb.Scene:
    """Two lamps, one seen directly, over a floor with a network and a metal ball; perhaps many lamps more."""
    lamp = rb.NeuralTexture(bright(2, 1)) if lamp is None else lamp
    other = rb.NeuralTexture(bright(3, 2), of="position") if other is None else other
    many = {f"small_{k}": rectangle((0.2 * k - 0.8, 1.4, 0.4), 0.05, angle=90, emitter=shining(rgb(2, 3, 4)))
            for k in range(lamps)}
    return load(
        dtype, sensor=sensor(5, (0, 0.7, 3.2), (0, 0.2, 0), 50),
        floor=rectangle((0, -0.5, 0), 1.5, angle=-90, bsdf=textured(mlp(2, 3, 3))),
        ball={"type": "sphere", "to_world": translate((0.3, -0.2, 0)) @ scale((0.3, 0.3, 0.3)),
              "bsdf": {"type": "roughconductor", "alpha": 0.3, "material": "Au"}},
        lamp=rectangle((-0.2, 0.5, -0.8), 0.4, bsdf=WHITE, emitter=shining(lamp, kind)),
        other=rectangle((0.4, 1.5, 0.3), 0.4, angle=90, bsdf=WHITE, emitter=shining(other)), **many)
