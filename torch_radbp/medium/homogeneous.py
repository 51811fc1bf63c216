"""A medium that is the same everywhere.

Where rays meet nothing, and there is hardly any extinction, what little is scattered comes from anywhere along them: as much
from each solid angle under which a lamp sees them. Some of the samples of derivatives end there after distances t of the
density l / (t + l)^2, with l the extent of the scene, which falls no faster than light does.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import torch
from torch import Tensor

from torch_radbp.interface.medium import MediumKind, colour_chosen
from torch_radbp.interface.phase import PhaseKind
from torch_radbp.phase.isotropic import Isotropic
from torch_radbp.plugin import Medium, Phase, Texture, Volume, finite, register
from torch_radbp.plugin.domain import AMOUNT, FRACTION, NUMBER, Domain
from torch_radbp.tensors.differentiated import any_differentiated
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.vec import TINY, Ray, Vec3, where
from torch_radbp.volume.constvolume import as_constant, as_volume

THINNEST = 0.05  # the least optical thickness of a way by which distances are sampled
LONGEST = 1e9  # ways beyond it have no end
THINNEST_OF_EMISSION = 1e-3  # the same by which places are sampled at which it is looked at what is emitted
SPREAD = 0.5  # of the samples of derivatives by the extinction


class HomogeneousTable(NamedTuple):
    """The parameters of one homogeneous medium, as compiled code reads them: tensors of one entry, attached."""

    sigma_t: Vec3  # extinction, 1 / length
    albedo: Vec3  # the share of it that is scattered
    phase: Any  # numbers of the phase function
    spread: Tensor  # (1,) the share of flights that are spread over ways without end, if nothing is scattered; detached
    extent: Tensor  # (1,) of the scene, by which they are; 0: none are
    emission: Any = None  # of its volume


@dataclass(frozen=True)
class HomogeneousKind(MediumKind):
    """A medium of constant extinction, with the transmittance exp(-sigma_t t) of Beer's law."""

    scatters: ClassVar[bool] = True
    phase_function: PhaseKind

    def transmittance(self, table: HomogeneousTable, ray: Ray, distance: Tensor) -> Vec3:
        return self.extinction(table, ray.o, ray.d).map(lambda sigma: torch.exp(-sigma * distance))

    def sample_flight(self, table: HomogeneousTable, ray: Ray, way: Tensor, u: Tensor, v: Tensor) -> Tensor:
        # The exponential distribution of one of the three colours; but first those that are spread.
        sigma = self.extinction(table, ray.o, ray.d)
        share, extent = colour_chosen(self.spread(table, sigma, way), v), everywhere(table.extent, way)
        first, rest = u / share.clamp_min(TINY), (u - share).clamp_min(0.0) / (1.0 - share)
        distance = -torch.log1p(-rest) / colour_chosen(at_least(sigma, way), v)
        return torch.where(u < share, extent * first / (1.0 - first).clamp_min(TINY), distance)

    def flight_pdf(self, table: HomogeneousTable, ray: Ray, way: Tensor, distance: Tensor) -> tuple[Vec3, Vec3]:
        sigma = self.extinction(table, ray.o, ray.d)
        share, extent = self.spread(table, sigma, way), everywhere(table.extent, way)
        sigma, far = at_least(sigma, way), 1.0 / (extent + distance).clamp_min(TINY)
        through = sigma.map(lambda each: torch.exp(-each * distance)) * share.map(lambda each: 1.0 - each)
        farther = through + share * (extent * far)
        # As a rate, so that images, of which no flights are spread, stay as they were to the last bit.
        density = sigma * through + share * (extent * far * far)
        rate = density * farther.map(lambda each: 1.0 / each.clamp_min(TINY))
        return where(extent > 0, rate, sigma) * farther, farther

    def sample_emission(self, table: HomogeneousTable, ray: Ray, way: Tensor, u: Tensor, v: Tensor) -> tuple[Tensor, Vec3]:
        # The exponential distribution again, of what is lost on the way: all places count alike, if there is one colour.
        sigma = at_least(self.extinction(table, ray.o, ray.d), way, THINNEST_OF_EMISSION)
        lost = sigma.map(lambda each: -torch.expm1(-each * way))
        distance = torch.minimum(-torch.log1p(-u * colour_chosen(lost, v)) / colour_chosen(sigma, v), way)
        return distance, Vec3(*(each * torch.exp(-each * distance) / all_of_it for each, all_of_it in zip(sigma, lost)))

    def spread(self, table: HomogeneousTable, sigma: Vec3, way: Tensor) -> Vec3:
        """The probability, for each colour, that a flight's distance is drawn from the wide density l / (t + l)^2, (N,)."""
        share, extent = everywhere(table.spread, way), everywhere(table.extent, way)
        return sigma.map(lambda each: torch.where((way > LONGEST) & (extent > 0), share * torch.exp(-each * extent), 0.0))

    def sampled_for_derivatives(self, table: HomogeneousTable, extent: Tensor, of_image: bool) -> HomogeneousTable:
        return table._replace(extent=extent.to(table.extent).expand_as(table.extent))

    def extinction(self, table: HomogeneousTable, p: Vec3, wi: Vec3) -> Vec3:
        sigma, area = everywhere(table.sigma_t, p.x), self.phase_function.projected_area(table.phase, p, wi)
        return sigma if area is None else sigma * area

    def scattering(self, table: HomogeneousTable, p: Vec3, wi: Vec3) -> Vec3:
        return self.extinction(table, p, wi) * everywhere(table.albedo, p.x)

    def phase(self, table: HomogeneousTable, p: Vec3, wi: Vec3, wo: Vec3) -> tuple[Tensor, Tensor]:
        return self.phase_function.eval_pdf(table.phase, p, wi, wo)

    def sample_phase(self, table: HomogeneousTable, p: Vec3, wi: Vec3, u: Tensor, v: Tensor) -> Vec3:
        return self.phase_function.sample(table.phase, p, wi, u, v)


@register("medium", "homogeneous")
class Homogeneous(Medium):
    """A medium that absorbs and scatters light everywhere alike, such as fog.

    Parameters: `sigma_t`, `albedo`, `scale`, and those of the phase function and of `emission`. Derivatives: with respect to
    all of them, also where the albedo, the extinction or the emission is 0. The distances at which paths scatter are sampled
    by one of the three colours, and weighted against all.

    Args:
        albedo: the share of the extinction that is scattered, in [0, 1].
        sigma_t: extinction, by colour, 1 / length.
        scale: a factor of `sigma_t`.
        sample_emitters: whether light is looked for from vertices in the medium; must be true.
        phase_function: the directions of scattered light; `isotropic` by default.
        emission: radiance that is emitted per unit of length, by colour or of all alike, which may vary in space; whatever
            the extinction is, which must not be 0 where rays meet nothing. None: nothing is emitted.

    Raises:
        ValueError: if a value is out of range.
    """

    def __init__(self, *, albedo: Volume | Texture | float = 0.75, sigma_t: Volume | Texture | float = 1.0,
                 scale: float = 1.0, sample_emitters: bool = True, phase_function: Phase | None = None,
                 emission: Volume | Texture | float | None = None):
        super().__init__()
        if not sample_emitters:
            raise ValueError("sample_emitters must be true: Renderer(nee=False) turns next-event estimation off everywhere")
        self.sample_emitters = True
        self.albedo, self.sigma_t = as_constant(self, "albedo", albedo), as_constant(self, "sigma_t", sigma_t)
        self.freeze("scale", finite("scale", scale, ()).to(torch.get_default_dtype()))
        self.phase_function = Isotropic() if phase_function is None else phase_function
        self.emission = None if emission is None else as_volume(self, "emission", emission)
        if not self.phase_function.even_area():
            raise ValueError(f"{self.phase_function.type} of homogeneous must be the same everywhere, since the extinction "
                             "depends on it; take a heterogeneous medium")

    def domains(self) -> dict[str, Domain]:
        return {"albedo": FRACTION, "sigma_t": AMOUNT._replace(floor=0.0),
                "scale": NUMBER._replace(low=0.0, floor=0.0), "emission": AMOUNT._replace(floor=0.0)}

    def kind(self) -> HomogeneousKind:
        emission = None if self.emission is None else self.emission.kind()
        return HomogeneousKind(self.phase_function.kind(), emission=emission)

    def row(self) -> HomogeneousTable:
        sigma_t = (self.sigma_t.colour() * self.scale).map(not_below_zero)
        spread = SPREAD if any_differentiated(sigma_t) else 0.0
        return HomogeneousTable(sigma_t, self.albedo.colour(), self.phase_function.row(), self.scale.new_tensor(spread),
                                torch.zeros_like(self.scale), None if self.emission is None else self.emission.table())


def not_below_zero(sigma: Tensor) -> Tensor:
    """The extinction, with negative values (after an optimiser's step) replaced by 0, but with their derivative."""
    return sigma + (sigma.detach().clamp_min(0.0) - sigma.detach())


def at_least(sigma: Vec3, way: Tensor, thinnest: float = THINNEST) -> Vec3:
    """The extinction by which distances are sampled, bounded from below so that some flights always end before the next
    surface; these have nearly all of the derivative where the extinction is 0."""
    return sigma.map(lambda each: torch.maximum(each, thinnest / way.clamp_min(TINY)))


def everywhere(row: Any, like: Tensor) -> Any:
    """The values of a table's only row, repeated for every lane."""
    return lookup(row, torch.zeros_like(like, dtype=torch.int32))
