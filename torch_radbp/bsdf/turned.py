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
from dataclasses import dataclass, replace
from typing import ClassVar

import torch
from torch import Tensor

from torch_radbp.interface.bsdf import Kind, LobeChoice, Values, on_horizon_unless
from torch_radbp.sampling.sampler import LARGEST_NUMBER
from torch_radbp.tensors.vec import Frame, Vec3, dot, masked, where

SHORTEST = 1e-8  # squared length of a normal; one that is shorter counts as not turned
FLATTEST = 1e-12  # squared cosine in a tangent
LEAST_CHANCE = 1e-3  # of a frame in which directions are drawn


@dataclass(frozen=True)
class TurnedKind(Kind):
    """A BSDF with a perturbed shading normal. Parameter values: `normal_values` for the normal, those of the nested BSDF."""

    nested: Kind
    flip: bool
    shadowing: bool
    from_lamps: bool = False  # it is the `adjoint`

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
        return self.nested.discrete or self.draws_frames

    @property
    def draws_frames(self) -> bool:
        """True if sampling first decides whether the sampled viewer sees the normal turned round: for paths from lamps."""
        return self.from_lamps and self.flip

    def adjoint(self) -> Kind:
        return replace(super().adjoint(), from_lamps=True)

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
        return self.frame_if(values, self.is_turned_round(values, wi))

    def is_turned_round(self, values: Values, wi: Vec3) -> Tensor | None:
        """(N,) bool: the normal faces away from the viewer `wi`, so it is turned round; None: it never is."""
        return wi.z * dot(wi, self.normal(values)) <= 0 if self.flip else None

    def frame_if(self, values: Values, turned_round: Tensor | None) -> Frame:
        """The frame around the perturbed normal, rotated by half a turn about the surface's own where `turned_round`."""
        n = self.normal(values)
        one = torch.ones_like(n.z)
        if turned_round is not None:
            sign = 1.0 - 2.0 * turned_round.to(n.z.dtype)
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
        """The shadowing factor in [0, 1], 0 between the horizons of both normals; `turned` is `wo` in `frame`."""
        kept = (wo.z * turned.z > 0).to(wo.z.dtype)
        if not self.shadowing:
            return kept
        steep = (0.125 * squared_tangent(frame.n)).clamp_max(1.0)
        return kept * (2.0 / (1.0 + torch.sqrt(1.0 + steep * squared_tangent(wo))))

    def eval_pdf(self, values: Values, wi: Vec3, wo: Vec3, fixed_lobes: bool = False) -> tuple[Vec3, Tensor]:
        frame = self.frame(values, wi)
        turned = frame.to_local(wo)
        value, pdf = self.nested.eval_pdf(values[self.normal_values:], frame.to_local(wi), turned, fixed_lobes)
        value = value * self.passes(frame, wo, turned)
        if not self.from_lamps:
            return value, pdf * (wo.z * turned.z > 0).to(pdf.dtype)
        turned_round = self.is_turned_round(values, wo)
        frame = self.frame_if(values, turned_round)
        pdf = self.nested.eval_pdf(values[self.normal_values:], frame.to_local(wi), frame.to_local(wo), fixed_lobes)[1]
        if turned_round is not None:
            pdf = pdf * chance_of_frame(self.chance_of_turned_round(values), turned_round)
        return value, pdf * (wo.z != 0).to(pdf.dtype)

    def chance_of_turned_round(self, values: Values) -> Tensor:
        """The probability with which paths from lamps sample viewers who see the normal turned round; detached."""
        return (0.5 * torch.sqrt(1.0 - self.frame_if(values, None).n.z.detach() ** 2)).clamp(LEAST_CHANCE, 0.5)

    def drawn_frame(self, values: Values, wi: Vec3, choice: LobeChoice) -> tuple[Frame, LobeChoice]:
        """The frame in which a direction is sampled, and the lobe choice of the nested BSDF."""
        if not self.draws_frames:
            return self.frame(values, wi), choice
        return self.frame_if(values, choice.lobe > 0), choice.parts[0]

    def choose(self, values: Values, wi: Vec3, choice: Tensor | None, u: Tensor, v: Tensor) -> LobeChoice:
        own_values = values[self.normal_values:]
        if not self.draws_frames:
            return self.nested.choose(own_values, self.frame(values, wi).to_local(wi).detach(), choice, u, v)
        chance = self.chance_of_turned_round(values)
        turned_round, number = picked_with(chance, choice)
        own = self.nested.choose(own_values, self.frame_if(values, turned_round).to_local(wi).detach(), number, u, v)
        return LobeChoice(turned_round.to(chance.dtype), own.probability * chance_of_frame(chance, turned_round), own.delta,
                          (own,))

    def chance_of_delta(self, values: Values, wi: Vec3) -> Tensor | None:
        if self.draws_frames:
            return None
        return self.nested.chance_of_delta(values[self.normal_values:], self.frame(values, wi).to_local(wi).detach())

    def sample(self, values: Values, wi: Vec3, choice: LobeChoice, u: Tensor, v: Tensor) -> Vec3:
        frame, own = self.drawn_frame(values, wi, choice)
        turned = self.nested.sample(values[self.normal_values:], frame.to_local(wi), own, u, v)
        wo = frame.to_world(turned)
        if not self.from_lamps:
            return on_horizon_unless(wo.z * turned.z > 0, wo)
        usable = turned.z != 0
        if self.flip:  # of delta lobes `specular` says whether the viewer sees the normal so
            usable = usable & ((self.is_turned_round(values, wo) == (choice.lobe > 0)) | own.is_delta(self.nested))
        return on_horizon_unless(usable, wo)

    def chance_by_direction(self, values: Values, wi: Vec3, wo: Vec3, choice: LobeChoice) -> Tensor | None:
        frame, own = self.drawn_frame(values, wi, choice)
        return self.nested.chance_by_direction(values[self.normal_values:], frame.to_local(wi), frame.to_local(wo), own)

    def specular(self, values: Values, wi: Vec3, choice: LobeChoice) -> Vec3:
        frame, own = self.drawn_frame(values, wi, choice)
        local, number = frame.to_local(wi), torch.full_like(wi.z, 0.5)  # directions of delta lobes depend on no number
        turned = self.nested.sample(values[self.normal_values:], local, own, number, number)
        light = self.nested.specular(values[self.normal_values:], local, own)
        light = light * self.passes(frame, frame.to_world(turned), turned)
        if not self.draws_frames:
            return light
        return masked(self.is_turned_round(values, wi) == (choice.lobe > 0), light)

    def spread(self, values: Values, wi: Vec3, choice: LobeChoice) -> Tensor | None:
        frame, own = self.drawn_frame(values, wi, choice)
        return self.nested.spread(values[self.normal_values:], frame.to_local(wi), own)

    def null_transmission(self, values: Values, wi: Vec3) -> tuple[Vec3, Tensor]:
        nested, frame = values[self.normal_values:], self.frame(values, wi)
        turned = frame.to_local(wi)
        light, chance = self.nested.null_transmission(nested, turned)
        light = light * self.passes(frame, -wi, -turned)
        if not self.draws_frames:
            return light, chance
        # `choose` samples one of the two frames first, and may choose a lobe that lets light pass straight in either.
        chance_of_turned_round, yes = self.chance_of_turned_round(values), torch.ones_like(chance, dtype=torch.bool)
        for_turned, for_others = (self.nested.null_transmission(nested, self.frame_if(values, turned_round).to_local(wi))[1]
                                  for turned_round in (yes, ~yes))
        return light, for_others + chance_of_turned_round * (for_turned - for_others)

    def chooses_null(self, choice: LobeChoice) -> Tensor:
        return self.nested.chooses_null(choice.parts[0] if self.draws_frames else choice)


def chance_of_frame(chance: Tensor, turned_round: Tensor) -> Tensor:
    """The probability of the sampled `turned_round`, which is true with probability `chance`."""
    return torch.where(turned_round, chance, 1.0 - chance)


def picked_with(chance: Tensor, number: Tensor) -> tuple[Tensor, Tensor]:
    """True with probability `chance`, by a uniform random number, and a new uniform number made of its remainder."""
    picked = number < chance
    rest = torch.where(picked, number / chance, (number - chance) / (1.0 - chance))
    return picked, rest.clamp(0.0, LARGEST_NUMBER)


def squared_tangent(w: Vec3) -> Tensor:
    """The squared tangent of the angle between the unit vector `w` and the normal."""
    cosine2 = (w.z * w.z).clamp_min(FLATTEST)
    return ((1.0 - cosine2) / cosine2).clamp_min(0.0)
