"""A medium whose extinction varies in space, such as smoke and clouds.

Rays fly through it from tentative collision to tentative collision, as dense as a bound of the extinction in the cell of a
coarse grid around them. One is real with the probability of extinction over bound; else the ray goes on. The bound is that
of the cell, so that empty ones are passed in one step. Light that does not scatter on its way, as that of lamps, loses the
least extinction of a cell in closed form, and only the rest at tentative collisions.

Where flights are sampled by more extinction than there is (`floor`), they count by the quotient. That floor is higher for
paths whose samples are of the derivative alone: what light an empty cell would scatter only those know that scatter there.
With colours the extinction of one of them, chosen at random, decides, and flights are weighted against the chance that any
of them would have had.

References: Woodcock 1965 (tentative collisions); Novak, Selle and Jarosz 2014, "Residual Ratio Tracking" (what is left);
Miller, Georgiev and Jarosz 2019, "A Null-Scattering Path Integral Formulation of Light Transport" (colours); Pharr, Jakob
and Humphreys 2023, "Physically Based Rendering", section 14.2.2 (the coarse grid).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import torch
from torch import Tensor

from torch_radbp.interface.medium import EmissionCandidate, MediumKind, Tracking, colour_chosen
from torch_radbp.interface.phase import PhaseKind
from torch_radbp.interface.volume import VolumeKind
from torch_radbp.medium.coarse_grid import CoarseGrid, cell_of, coarse_grid, distance_to_next_cell
from torch_radbp.phase.isotropic import Isotropic
from torch_radbp.plugin import Medium, Phase, Texture, Volume, finite, register
from torch_radbp.plugin.domain import AMOUNT, FRACTION, NUMBER, Domain
from torch_radbp.sampling.sampler import next_number
from torch_radbp.tensors.differentiated import any_differentiated
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.record import selected
from torch_radbp.tensors.vec import TINY, Ray, Vec3, dot, where
from torch_radbp.volume.constvolume import as_volume

STEPS = 4  # that are taken at a time
# The least optical thickness across the medium by which flights are sampled, of the image and of derivatives by extinction.
THINNEST, THINNEST_OF_DERIVATIVES = 0.05, 0.4


class HeterogeneousTable(NamedTuple):
    """The parameters of one heterogeneous medium as compiled code reads them; volumes attached, bounds detached."""

    sigma_t: Any  # of its volume
    albedo: Any  # of its volume
    scale: Tensor  # (1,)
    phase: Any
    grid: CoarseGrid  # bounds of the extinction, detached
    floor: Tensor  # (1,) the least extinction by which flights are sampled, detached
    floor_of_derivatives: Tensor  # (1,) the same where derivatives have samples of their own
    emission: Any = None  # of its volume


@dataclass(frozen=True)
class HeterogeneousKind(MediumKind):
    """A medium whose extinction and albedo are read from volumes at every point."""

    scatters: ClassVar[bool] = True
    heterogeneous: ClassVar[bool] = True
    sigma_t: VolumeKind
    albedo: VolumeKind
    phase_function: PhaseKind

    def sampled_for_derivatives(self, table: HeterogeneousTable, extent: Tensor, of_image: bool) -> HeterogeneousTable:
        return table if of_image else table._replace(floor=table.floor_of_derivatives)

    def extinction(self, table: HeterogeneousTable, p: Vec3, wi: Vec3) -> Vec3:
        area = self.phase_function.projected_area(table.phase, p, wi)
        scale = only(table.scale, p.x)
        return self.sigma_t.eval(table.sigma_t, p) * (scale if area is None else scale * area)

    def scattering(self, table: HeterogeneousTable, p: Vec3, wi: Vec3) -> Vec3:
        return self.extinction(table, p, wi) * self.albedo.eval(table.albedo, p)

    def phase(self, table: HeterogeneousTable, p: Vec3, wi: Vec3, wo: Vec3) -> tuple[Tensor, Tensor]:
        return self.phase_function.eval_pdf(table.phase, p, wi, wo)

    def sample_phase(self, table: HeterogeneousTable, p: Vec3, wi: Vec3, u: Tensor, v: Tensor) -> Vec3:
        return self.phase_function.sample(table.phase, p, wi, u, v)

    def enter(self, table: HeterogeneousTable, ray: Ray, segment: Tensor) -> tuple[Tensor, Tensor]:
        low, high = lookup(table.grid.low, index(segment)), lookup(table.grid.high, index(segment))
        first, last = torch.zeros_like(segment), segment
        for o, d, a, b in zip(ray.o, ray.d, low, high):
            # A ray along a face is inside or outside all the way.
            inverse = 1.0 / torch.where(d.abs() > TINY, d, TINY)
            lower, upper = (a - o) * inverse, (b - o) * inverse
            near, far = torch.where(inverse > 0, lower, upper), torch.where(inverse > 0, upper, lower)
            # Not by `maximum`, whose tangents are differences: those along a face are huge.
            first, last = torch.where(near > first, near, first), torch.where(far < last, far, last)
        return first, last

    def track(self, table: HeterogeneousTable, ray: Ray, segment: Tensor, v: Tensor, tracking: Tracking,
              flies: bool) -> Tracking:
        first, last = self.enter(table, ray, segment)
        for _ in range(STEPS):
            before, tracking = tracking, self.step(table, ray, last, v, tracking, flies)
            if before.emission is not None and self.emission is not None:
                tracking = with_emission(tracking, before, first, last)
        return tracking

    def step(self, table: HeterogeneousTable, ray: Ray, last: Tensor, v: Tensor, tracking: Tracking,
             flies: bool) -> Tracking:
        """Follows rays to the next tentative collision or cell of the coarse grid; `last`: distances to where they leave."""
        start, end, left, beyond, seed, running, _ = tracking
        cell, scale, floor = cell_of(table.grid, ray, start), only(table.scale, last), only(table.floor, last)
        # Above what flights are sampled by, so that tentative collisions may be passed wherever light passes.
        bound = torch.maximum(lookup(table.grid.bound, cell) * scale, 2.0 * floor)
        # Light that goes straight on loses in closed form what it loses everywhere in the cell; not where a place is picked
        # at which it is looked at what is emitted, since that counts on what is left to be the same all along a step.
        straight = not flies and tracking.emission is None
        control = lookup(table.grid.least, cell) * scale if straight else torch.zeros_like(bound)
        seed, u = next_number(seed, last.dtype)
        collision = start - torch.log1p(-u) / (bound - control)
        border = start + distance_to_next_cell(table.grid, ray, start)
        collides, t = running & (collision < torch.minimum(border, last)), torch.minimum(collision, border)
        sigma = self.extinction(table, ray.o + ray.d * t, ray.d)
        seed, u = next_number(seed, last.dtype)
        if flies:
            # Is it real? The extinction of the colour that decides says with which probability.
            decides = sigma.map(lambda each: torch.minimum(torch.maximum(each, floor), bound))
            chance = colour_chosen(decides, v)
            real = collides & (u * bound < chance)
            # All colours count by their probabilities over that of what has happened.
            over = 1.0 / torch.where(bound - chance > 0, bound - chance, 1.0)
            left = where(collides & ~real, left * sigma.map(lambda each: (bound - each) * over), left)
            change = where(real, decides, decides.map(lambda each: (bound - each) * over))
            beyond, end = where(collides, beyond * change, beyond), torch.where(real, t, end)
        else:
            real = torch.zeros_like(running)
            rest = sigma.map(lambda each: (bound - each) / (bound - control))
            through = torch.exp(-control * (torch.minimum(t, last) - start))
            left = where(running, where(collides, left * rest, left) * through, left)
        t, seed = torch.where(running, t, tracking.t), torch.where(running, seed, tracking.seed)
        return tracking._replace(t=t, end=end, left=left, beyond=beyond, seed=seed, running=running & ~real & (t < last))


def with_emission(tracking: Tracking, before: Tracking, first: Tensor, last: Tensor) -> Tracking:
    """Resamples the point at which emission is evaluated: it moves to the latest step with that step's share as probability.

    Transmittance is the same all along a step, so that the point has that before it. Args: rays after and before the step,
    and the distances at which they enter and leave the medium.
    """
    emission = before.emission
    assert emission is not None
    seed, u = next_number(tracking.seed, last.dtype)
    reached = torch.minimum(tracking.t, last)
    along = u * (reached - first)
    here = before.running & (along < reached - before.t)
    place = EmissionCandidate(before.t + along, before.left, before.beyond)
    return tracking._replace(seed=torch.where(before.running, seed, tracking.seed), emission=selected(here, place, emission))


@register("medium", "heterogeneous")
class Heterogeneous(Medium):
    """A medium that absorbs and scatters light differently from point to point, such as smoke.

    Parameters: those of `sigma_t`, `albedo` and `emission`, `scale`, and those of the phase function. Derivatives: with
    respect to all of them, also where extinction, albedo or emission are 0. It fills the box in the world around the grid of
    `sigma_t`; outside of that there is nothing, and what is inside of the box, but not of the grid, reads the nearest
    values. A constant `sigma_t` fills the unit cube [0, 1]^3 under its `to_world`, as in Mitsuba 3.9.1.

    Args:
        albedo: the share of the extinction that is scattered, in [0, 1].
        sigma_t: extinction, by colour or of all alike, 1 / length.
        scale: a factor of `sigma_t`.
        sample_emitters: whether light is looked for from vertices in the medium; must be true.
        phase_function: the directions of scattered light; `isotropic` by default.
        emission: radiance that is emitted per unit of length in the box, by colour or of all alike, whatever the extinction
            is. None: nothing is emitted.

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
        self.albedo, self.sigma_t = as_volume(self, "albedo", albedo), as_volume(self, "sigma_t", sigma_t)
        self.freeze("scale", finite("scale", scale, ()).to(torch.get_default_dtype()))
        self.phase_function = Isotropic() if phase_function is None else phase_function
        self.emission = None if emission is None else as_volume(self, "emission", emission)

    def domains(self) -> dict[str, Domain]:
        return {"albedo": FRACTION, "sigma_t": AMOUNT._replace(floor=0.0), "scale": NUMBER._replace(low=0.0, floor=0.0),
                "emission": AMOUNT._replace(floor=0.0)}

    def kind(self) -> HeterogeneousKind:
        emission = None if self.emission is None else self.emission.kind()
        return HeterogeneousKind(self.sigma_t.kind(), self.albedo.kind(), self.phase_function.kind(), emission=emission)

    def row(self) -> HeterogeneousTable:
        sigma_t, albedo = self.sigma_t.table(), self.albedo.table()
        for name, volume in (("albedo", self.albedo), ("sigma_t", self.sigma_t)):
            if not volume.entries():  # else they are checked as parameters
                with torch.no_grad():
                    self.domains()[name].check(name, volume.samples())
        grid = coarse_grid(self.sigma_t)  # type: ignore[arg-type]
        across = grid.high - grid.low
        diagonal = dot(across, across).sqrt()
        largest, least = self.phase_function.extreme_areas()
        grid = grid._replace(bound=grid.bound * largest, least=grid.least * least)
        thinnest = THINNEST_OF_DERIVATIVES if any_differentiated(sigma_t) else THINNEST
        return HeterogeneousTable(sigma_t, albedo, self.scale, self.phase_function.row(), grid,
                                  THINNEST / diagonal, thinnest / diagonal,
                                  None if self.emission is None else self.emission.table())


def index(like: Tensor) -> Tensor:
    """(N,) int32 zeros, the index of the only row of a table for every lane."""
    return torch.zeros_like(like, dtype=torch.int32)


def only(column: Tensor, like: Tensor) -> Tensor:
    """The only entry of a column, repeated for every lane."""
    return lookup(column, index(like))
