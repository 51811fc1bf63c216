"""The interface between materials and the tracer: scattering functions on structs of arrays, in the local frame.

A material has two parts. Its `Kind`, a hashable value that names the functions and their static options, is the same at
every surface point. The values of its `textures` vary, and are handed to the functions as one `Vec3` each (of a scalar only
`x` is used). Directions are unit vectors with z along the shading normal; `wi` points towards the viewer, `wo` along the
sampled ray or towards the light.

Sampling has two stages, because derivatives treat the discrete decision separately: `choose` decides between reflection and
transmission, with a probability that carries no derivative, and `sample` maps random numbers to a direction, attached.
For every kind

    F = eval / pdf                                                 detached: `pdf` without derivative
    F = eval / (pdf * choice.probability / probability)            attached: the density without the derivative of the
                                                                   choice, but with that of the direction
    F = specular / choice.probability                              ideal specular kinds, in either mode

Every function is smooth where the physics is, and values and derivatives are finite everywhere: at grazing angles, at total
internal reflection, at a roughness of zero, between equal indices of refraction.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import torch
from torch import Tensor

from torch_radbp.vec import Vec3

Values = tuple[Vec3, ...]


class Choice(NamedTuple):
    """The discrete decision at a vertex; detached."""

    transmits: Tensor  # (N,) 0 or 1, floating point
    probability: Tensor  # (N,) of what was decided


@dataclass(frozen=True)
class Kind(ABC):
    """The scattering functions of one kind of material; all tensors are (N,).

    The defaults are those of a material with one lobe, which only reflects.
    """

    delta: ClassVar[bool] = False  # ideal specular: only `sample` finds the directions into which it scatters
    discrete: ClassVar[bool] = False  # `choose` has a choice
    oriented: ClassVar[bool] = False  # anisotropic: turning the surface about its normal makes a difference

    @property
    def steering(self) -> tuple[int, ...]:
        """The numbers of those values on which sampled directions depend."""
        return ()

    @property
    def jumps(self) -> bool:
        """True if `eval_pdf` is discontinuous in the directions, which derivatives at fixed directions miss."""
        return False

    @property
    @abstractmethod
    def slots(self) -> int:
        """The number of values that the functions take."""

    @abstractmethod
    def eval_pdf(self, values: Values, wi: Vec3, wo: Vec3) -> tuple[Vec3, Tensor]:
        """BSDF times |cos(wo)|, for radiance, and the density of `sample` over solid angle, over all choices.

        Both attached; zero for ideal specular kinds.
        """

    def eval(self, values: Values, wi: Vec3, wo: Vec3) -> Vec3:
        """The first of `eval_pdf`."""
        return self.eval_pdf(values, wi, wo)[0]

    def pdf(self, values: Values, wi: Vec3, wo: Vec3) -> Tensor:
        """The second of `eval_pdf`."""
        return self.eval_pdf(values, wi, wo)[1]

    @abstractmethod
    def sample(self, values: Values, wi: Vec3, choice: Choice, u: Tensor, v: Tensor) -> Vec3:
        """A unit vector wo, attached to values and wi. `eval` and `pdf` are zero where it cannot be used."""

    def choose(self, values: Values, wi: Vec3, choice: Tensor | None, u: Tensor, v: Tensor) -> Choice:
        """Reflection or transmission, decided by the random number `choice`; `sample` will get the same u and v.

        `choice` may be None where the kind is not `discrete`.
        """
        return Choice(torch.zeros_like(wi.z), torch.ones_like(wi.z))

    def probability(self, values: Values, wi: Vec3, wo: Vec3, choice: Choice) -> Tensor:
        """`choice.probability` again, but attached; `wo` is the sampled direction."""
        return torch.ones_like(wi.z)

    def specular(self, values: Values, wi: Vec3, choice: Choice) -> Vec3:
        """Weight of the chosen lobe of an ideal specular kind, not divided by the choice's probability; attached."""
        raise TypeError(f"{type(self).__name__} scatters into all directions: use eval")


class DeltaKind(Kind):
    """Ideal specular scattering, into directions that no other sampling strategy finds."""

    delta: ClassVar[bool] = True

    def eval_pdf(self, values: Values, wi: Vec3, wo: Vec3) -> tuple[Vec3, Tensor]:
        return Vec3.full(wi.z, 0.0), torch.zeros_like(wi.z)

    @abstractmethod
    def specular(self, values: Values, wi: Vec3, choice: Choice) -> Vec3:
        """Weight of the chosen lobe, not divided by the choice's probability; attached."""


def above(w: Vec3) -> Vec3:
    """`w` mirrored to the side of the normal: a stand-in that keeps one-sided kinds finite where they are black."""
    return Vec3(w.x, w.y, w.z.abs())


def side_of(w: Vec3) -> Tensor:
    """1 on the side of the normal and on the horizon, -1 behind."""
    return 1.0 - 2.0 * (w.z < 0).to(w.z.dtype)


def reflects(wi: Vec3, wo: Vec3) -> Tensor:
    """1 where both directions lie on the side of the normal, else 0."""
    return ((wi.z > 0) & (wo.z > 0)).to(wo.z.dtype)
