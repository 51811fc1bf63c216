"""The interface between materials and the path tracer: scattering functions in the local shading frame.

A material has two parts. Its `Kind`, a hashable value that names the functions and their static options, is the same at
every surface point. The values of its `textures` vary, and are handed to the functions as one `Vec3` each (of a scalar only
`x` is used). Directions are unit vectors with z along the shading normal; `wi` points towards the viewer, `wo` along the
sampled ray or towards the light.

A kind has lobes. A *delta* lobe scatters into single directions, which only `sample` finds; the others are *smooth*.
Sampling has two stages, because derivatives treat the discrete decision separately: `choose` picks a lobe, with a
probability that carries no derivative, and `sample` maps random numbers to a direction of that lobe, attached. Smooth lobes
may overlap: the density of a direction is the sum over all of them, each times its probability. With
F = f |cos| / density,

    F = eval / pdf                              detached: `pdf` without derivative
    F = eval / pdf with `fixed_lobes`           attached: the density with the derivative of the direction, but without that
                                                of the lobes' probabilities
    F = specular / choice.probability           of a delta lobe, in either mode

Where a probability depends on the direction (as by the reflectance of a microfacet), an attached F is also multiplied by
`chance_by_direction` over its own value: the chance to get there moves with the direction, in the sum over lobes, too.

Every function is smooth where the physics is, and values and derivatives are finite everywhere: at grazing angles, at total
internal reflection, at a roughness of zero, between equal indices of refraction.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, NamedTuple

import torch
from torch import Tensor

from torch_radbp.tensors.differentiated import settled
from torch_radbp.tensors.vec import Vec3

SMALLEST_LEVEL = 1e-12  # squared length of a direction's horizontal part

Values = tuple[Vec3, ...]


class LobeChoice(NamedTuple):
    """The BSDF lobe chosen for sampling; detached."""

    lobe: Tensor  # (N,) number of the lobe, floating point; of glass 0 reflects and 1 transmits
    probability: Tensor  # (N,) of the choice
    delta: Tensor | None = None  # (N,) bool: it is a delta lobe; None: the kind has no other, or none at all
    parts: tuple[LobeChoice, ...] = ()  # the choices of the nested kinds

    def is_delta(self, kind: Kind) -> Tensor:
        """(N,) bool: the chosen lobe is a delta lobe; `kind`: the BSDF whose lobe it is."""
        return torch.full_like(self.lobe, kind.delta, dtype=torch.bool) if self.delta is None else self.delta


@dataclass(frozen=True)
class Kind(ABC):
    """The scattering functions of one kind of material; all tensors are (N,).

    The defaults are those of a material with one smooth lobe, which only reflects.
    """

    delta: ClassVar[bool] = False  # it has delta lobes
    smooth: ClassVar[bool] = True  # it has smooth lobes
    discrete: ClassVar[bool] = False  # it chooses among lobes by a random number
    oriented: ClassVar[bool] = False  # anisotropic: turning the surface about its normal makes a difference
    transmits: ClassVar[bool] = False  # light passes to the other side
    straight: ClassVar[bool] = False  # some of it in the direction in which it came (null scattering)
    invisible: ClassVar[bool] = False  # nothing else happens to light, so that paths through media need not stop there
    turns_normals: ClassVar[bool] = False  # it shades with other normals than the surface's
    # What `check_bsdf` holds a kind to, and the kinds that it holds; False: the model is not so.
    reciprocal: ClassVar[bool] = True  # f(wi, wo) / n_i^2 = f(wo, wi) / n_o^2 with the indices n of refraction on both sides
    conserves: ClassVar[bool] = True  # no more power leaves than arrives

    @property
    def steering(self) -> tuple[int, ...]:
        """The indices of the values on which sampled directions depend."""
        return ()

    @property
    def bending(self) -> tuple[int, ...]:
        """The indices of the values on which those sampled directions depend that sampling="hybrid" differentiates."""
        return self.steering if self.delta or self.follows else ()

    @property
    def follows(self) -> bool:
        """True if sampling="hybrid" differentiates sampled directions of the smooth lobes, as it does of delta lobes."""
        return False

    @property
    def jumps(self) -> bool:
        """True if `eval_pdf` is discontinuous in the directions, which derivatives at fixed directions miss."""
        return False

    @property
    def ends(self) -> bool:
        """True if `sample` misses directions where `eval_pdf` is not zero; then attached sampling is biased, too."""
        return False

    @property
    @abstractmethod
    def slots(self) -> int:
        """The number of values (textures) that the functions take."""

    @abstractmethod
    def eval_pdf(self, values: Values, wi: Vec3, wo: Vec3, fixed_lobes: bool = False) -> tuple[Vec3, Tensor]:
        """BSDF times |cos(wo)|, for radiance, and the solid-angle density of `sample`; both of all smooth lobes together.

        Both attached; with `fixed_lobes` the density carries no derivative of the probabilities of lobes, but by directions
        if there is a `chance_by_direction`.
        """

    def eval(self, values: Values, wi: Vec3, wo: Vec3) -> Vec3:
        """BSDF times |cos(wo)|, for radiance; the first result of `eval_pdf`."""
        return self.eval_pdf(values, wi, wo)[0]

    def pdf(self, values: Values, wi: Vec3, wo: Vec3) -> Tensor:
        """The solid-angle density of `sample`; the second result of `eval_pdf`."""
        return self.eval_pdf(values, wi, wo)[1]

    @abstractmethod
    def sample(self, values: Values, wi: Vec3, choice: LobeChoice, u: Tensor, v: Tensor) -> Vec3:
        """Samples a unit vector wo from the chosen lobe, attached. `eval` and `pdf` are zero where it is invalid."""

    def choose(self, values: Values, wi: Vec3, choice: Tensor | None, u: Tensor, v: Tensor) -> LobeChoice:
        """Chooses a lobe by the random number `choice`; `sample` will get the same u and v. Detached.

        `choice` may be None where the kind is not `discrete`.
        """
        return LobeChoice(torch.zeros_like(wi.z), torch.ones_like(wi.z))

    def chance_of_delta(self, values: Values, wi: Vec3) -> Tensor | None:
        """The probability p of delta lobes, if `choose` picks these exactly by the random numbers below p; detached.

        None if it picks them otherwise, or if there are no other lobes.
        """
        return None

    def chance_by_direction(self, values: Values, wi: Vec3, wo: Vec3, choice: LobeChoice) -> Tensor | None:
        """The probability of the chosen lobe as a function of the directions, to which it is attached; up to a factor.

        None if it does not vary with wo, or where that makes no difference because the lobe overlaps with no other. `values`
        are detached.
        """
        return None

    def specular(self, values: Values, wi: Vec3, choice: LobeChoice) -> Vec3:
        """The weight of the chosen delta lobe, not divided by its probability, attached; any number for smooth lobes."""
        raise TypeError(f"{type(self).__name__} has no delta lobe: use eval")

    def spread(self, values: Values, wi: Vec3, choice: LobeChoice) -> Tensor | None:
        """The solid angle of the directions wo over that of the wi from which they come, of the chosen delta lobe; attached.

        With the indices n of refraction on both sides, n_i^2 |cos wi| / (n_o^2 |cos wo|), and 1, or None, for mirrors.
        """
        return None

    def adjoint(self) -> Kind:
        """The scattering functions for paths that begin at lamps: wi points towards the lamp and wo towards the camera.

        It is another than this only if `sample` and its density, and with these `choose` and `specular`, differ; `eval` is
        still that of radiance, whose first direction points towards the camera.
        """
        nested = {name: part.adjoint() for name, part in vars(self).items() if isinstance(part, Kind)}
        return replace(self, **nested) if nested else self

    def null_transmission(self, values: Values, wi: Vec3) -> tuple[Vec3, Tensor]:
        """The share of light that passes straight, attached, and the probability that `choose` lets it pass so, detached."""
        return Vec3.full(wi.z, 0.0), torch.zeros_like(wi.z)

    def chooses_null(self, choice: LobeChoice) -> Tensor:
        """(N,) bool: the chosen lobe lets light pass straight through."""
        return torch.full_like(choice.lobe, self.invisible, dtype=torch.bool)

    def diffuse_reflectance(self, values: Values, wi: Vec3) -> Vec3:
        """The albedo of the material, as Mitsuba's AOV `albedo` has it; attached.

        By default that of the diffuse material which is as bright when seen from straight above.
        """
        none = torch.zeros_like(wi.z)
        return self.eval(values, Vec3(*wi), Vec3(none, none, torch.ones_like(none))) * math.pi

    def shading_normal(self, values: Values, wi: Vec3) -> Vec3:
        """The unit normal with which the material shades, in the local frame, if it `turns_normals`; attached."""
        raise TypeError(f"{type(self).__name__} turns no normals")


class DeltaKind(Kind):
    """A BSDF with delta lobes only: ideal specular scattering, which light sampling cannot find."""

    delta: ClassVar[bool] = True
    smooth: ClassVar[bool] = False

    def eval_pdf(self, values: Values, wi: Vec3, wo: Vec3, fixed_lobes: bool = False) -> tuple[Vec3, Tensor]:
        return Vec3.full(wi.z, 0.0), torch.zeros_like(wi.z)

    @abstractmethod
    def specular(self, values: Values, wi: Vec3, choice: LobeChoice) -> Vec3:
        """Weight of the chosen delta lobe, not divided by the choice's probability; attached."""


def choice_among(probabilities: Sequence[Tensor | float], choice: Tensor) -> LobeChoice:
    """Chooses among smooth lobes by a random number: number k with the k-th probability.

    Args:
        probabilities: of all lobes; their sum is 1. Detached.
        choice: (N,) in [0, 1).
    """
    lobe = end = torch.zeros_like(choice)
    for probability in probabilities[:-1]:
        end = end + probability
        lobe = lobe + (choice >= end).to(choice.dtype)
    return LobeChoice(lobe, sum((lobe == k).to(choice.dtype) * probability for k, probability in enumerate(probabilities)))


def on_horizon_unless(usable: Tensor, w: Vec3) -> Vec3:
    """`w` where `usable` (N,) bool, else the direction on the horizon with its azimuth, where every BSDF is zero."""
    fine, level = usable.to(w.z.dtype), w.x * w.x + w.y * w.y
    upright = (level < SMALLEST_LEVEL).to(w.z.dtype)  # has no azimuth
    scale = fine + (1.0 - fine) * (1.0 - upright) * torch.rsqrt(level.clamp_min(SMALLEST_LEVEL))
    return Vec3(w.x * scale + (1.0 - fine) * upright, w.y * scale, w.z * fine)


def chance_of_lobe(chance: Tensor, fixed_lobes: bool) -> Tensor:
    """The probability of a lobe as a factor of a density; detached if lobes are fixed."""
    return settled(chance) if fixed_lobes else chance


def values_for_choice(values: Values) -> Values:
    """Detaches the values by which lobes are chosen."""
    return tuple(value.map(settled) for value in values)


def either(condition: Tensor, first: Tensor | None, second: Tensor | None) -> Tensor | None:
    """Selects between two probabilities by a condition; None stands for 1, and the result is None if both are."""
    if first is None and second is None:
        return None
    return torch.where(condition, 1.0 if first is None else first, 1.0 if second is None else second)


def above(w: Vec3) -> Vec3:
    """`w` mirrored to the side of the normal, to keep one-sided BSDFs finite where they are black."""
    return Vec3(w.x, w.y, w.z.abs())


def side_of(w: Vec3) -> Tensor:
    """1 on the side of the normal and on the horizon, -1 behind."""
    return 1.0 - 2.0 * (w.z < 0).to(w.z.dtype)


def reflects(wi: Vec3, wo: Vec3) -> Tensor:
    """1 where both directions lie on the side of the normal, else 0."""
    return ((wi.z > 0) & (wo.z > 0)).to(wo.z.dtype)
