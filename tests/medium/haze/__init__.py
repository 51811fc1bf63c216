"""A medium that scatters, as a plugin of its own: nothing else in the package or the tests knows it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import torch
from torch import Tensor

from torch_radbp.medium.kind import Medium, MediumKind
from torch_radbp.plugin import Texture, register
from torch_radbp.plugin.domain import AMOUNT, FRACTION, NUMBER, Domain
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.vec import Frame, Ray, Vec3, dot
from torch_radbp.texture.rgb import as_texture


class HazeTable(NamedTuple):
    """One row, attached."""

    sigma_t: Vec3  # 1 / length
    albedo: Vec3
    g: Tensor  # mean cosine


def row(column, like: Tensor):
    """The entry of a column for every lane."""
    return lookup(column, torch.zeros_like(like, dtype=torch.int32))


@dataclass(frozen=True)
class HazeKind(MediumKind):
    """The same everywhere, with the phase function of Henyey and Greenstein (1941)."""

    scatters: ClassVar[bool] = True

    def transmittance(self, table: HazeTable, ray: Ray, distance: Tensor) -> Vec3:
        return row(table.sigma_t, distance).map(lambda sigma: torch.exp(-sigma * distance))

    def sample_flight(self, table: HazeTable, ray: Ray, u: Tensor, v: Tensor) -> Tensor:
        sigma = row(table.sigma_t, u)
        of_colour = torch.where(v * 3.0 < 1.0, sigma.x, torch.where(v * 3.0 < 2.0, sigma.y, sigma.z))
        return -torch.log1p(-u) / of_colour.clamp_min(1e-12)

    def flight_pdf(self, table: HazeTable, ray: Ray, distance: Tensor) -> tuple[Tensor, Tensor]:
        sigma, through = row(table.sigma_t, distance), self.transmittance(table, ray, distance)
        return dot(sigma, through) / 3.0, (through.x + through.y + through.z) / 3.0

    def scattering(self, table: HazeTable, p: Vec3) -> Vec3:
        return row(table.sigma_t, p.x) * row(table.albedo, p.x)

    def phase(self, table: HazeTable, p: Vec3, wi: Vec3, wo: Vec3) -> tuple[Tensor, Tensor]:
        g = row(table.g, p.x)
        temp = 1.0 + g * g + 2.0 * g * dot(wi, wo)
        value = (1.0 - g * g) / (4.0 * math.pi * temp * torch.sqrt(temp))
        return value, value

    def sample_phase(self, table: HazeTable, p: Vec3, wi: Vec3, u: Tensor, v: Tensor) -> Vec3:
        g = row(table.g, p.x)
        small = g.abs() < 1e-3
        by = torch.where(small, 1.0, g)
        squared = (1.0 - by * by) / (1.0 - by + 2.0 * by * u)
        cosine = torch.where(small, 2.0 * u - 1.0, (1.0 + by * by - squared * squared) / (2.0 * by)).clamp(-1.0, 1.0)
        sine, phi = torch.sqrt((1.0 - cosine * cosine).clamp_min(1e-24)), 2.0 * math.pi * v
        return Frame.of(-wi).to_world(Vec3(sine * torch.cos(phi), sine * torch.sin(phi), cosine))


@register("medium", "haze")
class Haze(Medium):
    """Absorbs and scatters, everywhere alike; fills the whole scene."""

    def __init__(self, *, sigma_t: Texture | float = 1.0, albedo: Texture | float = 0.75, g: float = 0.0):
        super().__init__()
        self.sigma_t, self.albedo = as_texture(self, "sigma_t", sigma_t), as_texture(self, "albedo", albedo)
        self.freeze("g", torch.as_tensor(g, dtype=torch.get_default_dtype()))

    def domains(self) -> dict[str, Domain]:
        return {"sigma_t": AMOUNT, "albedo": FRACTION, "g": NUMBER._replace(low=-0.99, high=0.99)}

    def kind(self) -> HazeKind:
        return HazeKind()

    def row(self) -> HazeTable:
        return HazeTable(Vec3.of(self.sigma_t.texels()[0, 0]), Vec3.of(self.albedo.texels()[0, 0]), self.g)
