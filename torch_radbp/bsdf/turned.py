"""Materials with perturbed shading normals, by a normal map or a bump map.

With n the turned normal in the frame of the surface, all functions of the nested kind are called with directions in the
frame around n. Two things are as in Mitsuba:

* A normal that faces away from the viewer would make the surface black. It is turned about the surface's own normal by half
  a turn (Schuessler et al. 2017), unless `flip_invalid_normals` is off. Where that happens the BSDF jumps.
* Light that lies above one horizon and below the other is lost. Towards the surface's own horizon the BSDF fades by

      2 / (1 + sqrt(1 + min(tan^2(n) / 8, 1) tan^2(wo)))

  (Conty Estevez et al. 2019, equation 4), unless `use_shadowing_function` is off. Then it jumps there.

Reference: Schuessler et al. 2017, "Microfacet-based Normal Mapping for Robust Monte Carlo Path Tracing"; Conty Estevez,
Lecocq and Stein 2019, "A Microfacet-Based Shadowing Function to Solve the Bump Terminator Problem".
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from torch_radbp.interface.bsdf import Kind, LobeChoice, Values, on_horizon_unless
from torch_radbp.tensors.vec import Frame, Vec3, dot, where

SHORTEST = 1e-8  # squared length of a normal; one that is shorter counts as not turned
FLATTEST = 1e-12  # squared cosine in a tangent


@dataclass(frozen=True)
class TurnedKind(Kind):
    """A kind with perturbed shading normals. Values: `normal_values` many for the normal, those of the nested kind."""

    nested: Kind
    flip: bool
    shadowing: bool

    normal_values: ClassVar[int]

    turns_normals: ClassVar[bool] = True
    reciprocal: ClassVar[bool] = False  # light is weighted by the cosine to the perturbed normal

    @property
    def delta(self) -> bool:
        return self.nested.delta

    @property
    def smooth(self) -> bool:
        return self.nested.smooth

    @property
    def discrete(self) -> bool:
        return self.nested.discrete

    @property
    def oriented(self) -> bool:
        return True

    @property
    def transmits(self) -> bool:
        return self.nested.transmits

    @property
    def straight(self) -> bool:
        return self.nested.straight

    @property
    def jumps(self) -> bool:
        return self.nested.jumps

    @property
    def ends(self) -> bool:
        return self.nested.ends

    @property
    def slots(self) -> int:
        return self.normal_values + self.nested.slots

    @property
    def steering(self) -> tuple[int, ...]:
        return *range(self.normal_values), *(self.normal_values + k for k in self.nested.steering)

    @property
    def bending(self) -> tuple[int, ...]:
        if not (self.delta or self.follows):
            return ()
        return *range(self.normal_values), *(self.normal_values + k for k in self.nested.bending)

    @property
    def follows(self) -> bool:
        return self.nested.follows

    @abstractmethod
    def normal(self, values: Values) -> Vec3:
        """The perturbed normal in the frame of the surface, of any length; attached."""

    def frame(self, values: Values, wi: Vec3) -> Frame:
        """The frame around the perturbed normal, in coordinates of the surface's frame; attached."""
        one, n = torch.ones_like(wi.z), self.normal(values)
        if self.flip:
            sign = 1.0 - 2.0 * (wi.z * dot(wi, n) <= 0).to(wi.z.dtype)
            n = Vec3(n.x * sign, n.y * sign, n.z)
        squared = dot(n, n)
        turned = squared > SHORTEST
        n = n * torch.rsqrt(torch.where(turned, squared, 1.0))
        none = torch.zeros_like(one)
        return Frame.along(where(turned, n, Vec3(none, none, one)), Vec3(one, none, none))

    def shading_normal(self, values: Values, wi: Vec3) -> Vec3:
        return self.frame(values, wi).n

    def diffuse_reflectance(self, values: Values, wi: Vec3) -> Vec3:
        return self.nested.diffuse_reflectance(values[self.normal_values:], self.frame(values, wi).to_local(wi))

    def passes(self, frame: Frame, wo: Vec3, turned: Vec3) -> Tensor:
        """The share of light that is kept, in [0, 1]: 0 if it crosses only one of the two horizons."""
        kept = (wo.z * turned.z > 0).to(wo.z.dtype)
        if not self.shadowing:
            return kept
        steep = (0.125 * squared_tangent(frame.n)).clamp_max(1.0)
        return kept * (2.0 / (1.0 + torch.sqrt(1.0 + steep * squared_tangent(wo))))

    def eval_pdf(self, values: Values, wi: Vec3, wo: Vec3, fixed_lobes: bool = False) -> tuple[Vec3, Tensor]:
        frame = self.frame(values, wi)
        turned = frame.to_local(wo)
        value, pdf = self.nested.eval_pdf(values[self.normal_values:], frame.to_local(wi), turned, fixed_lobes)
        return value * self.passes(frame, wo, turned), pdf * (wo.z * turned.z > 0).to(pdf.dtype)

    def choose(self, values: Values, wi: Vec3, choice: Tensor | None, u: Tensor, v: Tensor) -> LobeChoice:
        return self.nested.choose(values[self.normal_values:], self.frame(values, wi).to_local(wi).detach(), choice, u, v)

    def sample(self, values: Values, wi: Vec3, choice: LobeChoice, u: Tensor, v: Tensor) -> Vec3:
        frame = self.frame(values, wi)
        turned = self.nested.sample(values[self.normal_values:], frame.to_local(wi), choice, u, v)
        wo = frame.to_world(turned)
        return on_horizon_unless(wo.z * turned.z > 0, wo)

    def chance_by_direction(self, values: Values, wi: Vec3, wo: Vec3, choice: LobeChoice) -> Tensor | None:
        frame = self.frame(values, wi)
        return self.nested.chance_by_direction(values[self.normal_values:], frame.to_local(wi), frame.to_local(wo), choice)

    def specular(self, values: Values, wi: Vec3, choice: LobeChoice) -> Vec3:
        frame = self.frame(values, wi)
        local, number = frame.to_local(wi), torch.full_like(wi.z, 0.5)  # directions of delta lobes depend on no number
        turned = self.nested.sample(values[self.normal_values:], local, choice, number, number)
        light = self.nested.specular(values[self.normal_values:], local, choice)
        return light * self.passes(frame, frame.to_world(turned), turned)

    def compression(self, values: Values, wi: Vec3, choice: LobeChoice) -> Tensor | None:
        frame = self.frame(values, wi)
        return self.nested.compression(values[self.normal_values:], frame.to_local(wi), choice)

    def null_transmission(self, values: Values, wi: Vec3) -> tuple[Vec3, Tensor]:
        frame = self.frame(values, wi)
        turned = frame.to_local(wi)
        light, chance = self.nested.null_transmission(values[self.normal_values:], turned)
        return light * self.passes(frame, -wi, -turned), chance

    def chooses_null(self, choice: LobeChoice) -> Tensor:
        return self.nested.chooses_null(choice)


def squared_tangent(w: Vec3) -> Tensor:
    """The squared tangent of the angle between the unit vector `w` and the normal."""
    cosine2 = (w.z * w.z).clamp_min(FLATTEST)
    return ((1.0 - cosine2) / cosine2).clamp_min(0.0)
