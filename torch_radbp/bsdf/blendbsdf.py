"""A blend of two materials, in proportions that may vary over the surface."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torch_radbp.bsdf.number import NumberOf
from torch_radbp.interface.bsdf import Kind, LobeChoice, Values, chance_of_lobe, either, on_horizon_unless
from torch_radbp.plugin import BSDF, Texture, register
from torch_radbp.plugin.domain import FRACTION, Domain
from torch_radbp.sampling.sampler import LARGEST_NUMBER
from torch_radbp.tensors.differentiated import differentiated
from torch_radbp.tensors.vec import Vec3, where
from torch_radbp.texture.bitmap import reader_of
from torch_radbp.texture.rgb import as_texture

LEAST_CHANCE = 0.02  # of either material: one of weight zero is still sampled, and the weight has its derivative
ROUNDING = 1e-6  # by which weights of 0 and 1 may be off when they are read from an image in float32


@dataclass(frozen=True)
class BlendKind(Kind):
    """A blend of two BSDFs. Parameter values: weight (a scalar, of the second), those of the first, those of the second.

    In a `LobeChoice`, `lobe` is 0 for the first BSDF and 1 for the second, and `parts` has the choice of each.
    """

    first: Kind
    second: Kind
    still: bool = False  # the weight is not differentiated: a material without weight is never sampled

    @property
    def delta(self) -> bool:
        return self.first.delta or self.second.delta

    @property
    def smooth(self) -> bool:
        return self.first.smooth or self.second.smooth

    @property
    def discrete(self) -> bool:
        return True

    @property
    def oriented(self) -> bool:
        return self.first.oriented or self.second.oriented

    @property
    def transmits(self) -> bool:
        return self.first.transmits or self.second.transmits

    @property
    def straight(self) -> bool:
        return self.first.straight or self.second.straight

    @property
    def jumps(self) -> bool:
        return self.first.jumps or self.second.jumps

    @property
    def ends(self) -> bool:
        return self.first.ends or self.second.ends

    @property
    def slots(self) -> int:
        return 1 + self.first.slots + self.second.slots

    @property
    def steering(self) -> tuple[int, ...]:
        return self.numbers(self.first.steering, self.second.steering)

    @property
    def bending(self) -> tuple[int, ...]:
        return self.numbers(*(kind.bending if kind.delta or self.follows else () for kind in (self.first, self.second)))

    @property
    def follows(self) -> bool:
        """True if sampling="hybrid" differentiates directions sampled from both BSDFs, whose densities are summed."""
        return all(kind.follows or not kind.smooth for kind in (self.first, self.second)) and self.smooth

    def numbers(self, of_first: tuple[int, ...], of_second: tuple[int, ...]) -> tuple[int, ...]:
        """Renumbers the parameters of the two nested BSDFs as parameters of the blend."""
        return *(1 + k for k in of_first), *(1 + self.first.slots + k for k in of_second)

    def parts(self, values: Values) -> tuple[Values, Values]:
        """Splits the parameter values into those of the first and of the second BSDF."""
        end = 1 + self.first.slots
        return values[1:end], values[end:]

    def chance_of_second(self, weight: Tensor) -> Tensor:
        """The probability of sampling the second BSDF: its weight, within `LEAST_CHANCE` of 0 and 1.

        If the weight is `still` (not differentiated), it is 0 or 1 where the weight is: a BSDF without weight is not
        sampled. Surfaces may move all the same: where a weight in [0, 1] has one of these values, its derivative by the
        position is zero. Outside of [0, 1] both BSDFs have a weight, one of them a negative one, and both are sampled.
        """
        chance = weight.clamp(LEAST_CHANCE, 1.0 - LEAST_CHANCE)
        if not self.still:
            return chance
        return torch.where(weight.abs() < ROUNDING, 0.0, torch.where((weight - 1.0).abs() < ROUNDING, 1.0, chance))

    def diffuse_reflectance(self, values: Values, wi: Vec3) -> Vec3:
        weight, (of_first, of_second) = values[0].x, self.parts(values)
        return (self.first.diffuse_reflectance(of_first, wi) * (1.0 - weight)
                + self.second.diffuse_reflectance(of_second, wi) * weight)

    def eval_pdf(self, values: Values, wi: Vec3, wo: Vec3, fixed_lobes: bool = False) -> tuple[Vec3, Tensor]:
        weight, (of_first, of_second) = values[0].x, self.parts(values)
        chance = chance_of_lobe(self.chance_of_second(weight), fixed_lobes)
        first, first_pdf = self.first.eval_pdf(of_first, wi, wo, fixed_lobes)
        second, second_pdf = self.second.eval_pdf(of_second, wi, wo, fixed_lobes)
        return first * (1.0 - weight) + second * weight, first_pdf * (1.0 - chance) + second_pdf * chance

    def choose(self, values: Values, wi: Vec3, choice: Tensor, u: Tensor, v: Tensor) -> LobeChoice:
        chance = self.chance_of_second(values[0].x.detach())
        rest = (((choice - chance) / positive_or_one(1.0 - chance)).clamp(0.0, LARGEST_NUMBER),
                (choice / positive_or_one(chance)).clamp_max(LARGEST_NUMBER))
        first, second = (kind.choose(part, wi, number, u, v)
                         for kind, part, number in zip((self.first, self.second), self.parts(values), rest))
        picked = choice < chance
        probability = torch.where(picked, chance * second.probability, (1.0 - chance) * first.probability)
        delta = torch.where(picked, second.is_delta(self.second), first.is_delta(self.first))
        return LobeChoice(picked.to(chance.dtype), probability, delta, (first, second))

    def sample(self, values: Values, wi: Vec3, choice: LobeChoice, u: Tensor, v: Tensor) -> Vec3:
        first, second = (own_sample(kind, part, wi, part_choice, u, v)
                         for kind, part, part_choice in zip((self.first, self.second), self.parts(values), choice.parts))
        return where(choice.lobe > 0, second, first)

    def chance_by_direction(self, values: Values, wi: Vec3, wo: Vec3, choice: LobeChoice) -> Tensor | None:
        first, second = (kind.chance_by_direction(part, wi, wo, part_choice)
                         for kind, part, part_choice in zip((self.first, self.second), self.parts(values), choice.parts))
        return either(choice.lobe > 0, second, first)

    def specular(self, values: Values, wi: Vec3, choice: LobeChoice) -> Vec3:
        weight, none = values[0].x, Vec3.full(wi.z, 0.0)
        first, second = (kind.specular(part, wi, part_choice) if kind.delta else none
                         for kind, part, part_choice in zip((self.first, self.second), self.parts(values), choice.parts))
        return where(choice.lobe > 0, second * weight, first * (1.0 - weight))

    def spread(self, values: Values, wi: Vec3, choice: LobeChoice) -> Tensor | None:
        first, second = (kind.spread(part, wi, part_choice)
                         for kind, part, part_choice in zip((self.first, self.second), self.parts(values), choice.parts))
        return either(choice.lobe > 0, second, first)

    def null_transmission(self, values: Values, wi: Vec3) -> tuple[Vec3, Tensor]:
        weight, chance = values[0].x, self.chance_of_second(values[0].x.detach())
        (first, first_chance), (second, second_chance) = (
            kind.null_transmission(part, wi) for kind, part in zip((self.first, self.second), self.parts(values)))
        return first * (1.0 - weight) + second * weight, first_chance * (1.0 - chance) + second_chance * chance

    def chooses_null(self, choice: LobeChoice) -> Tensor:
        first, second = (kind.chooses_null(part) for kind, part in zip((self.first, self.second), choice.parts))
        return torch.where(choice.lobe > 0, second, first)


def own_sample(kind: Kind, values: Values, wi: Vec3, choice: LobeChoice, u: Tensor, v: Tensor) -> Vec3:
    """A direction sampled by one of several BSDFs; on the horizon where that has density zero, whatever the others have."""
    wo = kind.sample(values, wi, choice, u, v)
    if not kind.smooth:
        return wo
    return on_horizon_unless((kind.pdf(values, wi, wo).detach() > 0) | choice.is_delta(kind), wo)


def positive_or_one(chance: Tensor) -> Tensor:
    """A divisor without zeros: the probability, or 1 where it is 0."""
    return torch.where(chance > 0, chance, 1.0)


def is_still(weight: Texture) -> bool:
    """True if a texture's values are certainly not differentiated; mesh attributes may be, unknown to the material."""
    return not reader_of(weight).attributes and not any(map(differentiated, weight.sources()))


@register("bsdf", "blendbsdf")
class BlendBSDF(BSDF):
    """A mixture of two materials, each of any kind: `bsdf_0` where the weight is 0, `bsdf_1` where it is 1.

    Parameters: `weight`, a texture in [0, 1]. Derivatives: with respect to the weight's texels, and to the parameters of
    both materials. Each is sampled with the probability of its weight, but at least 0.02. Where the weight is 0 or 1, one is
    not sampled at all, unless derivatives with respect to the weight are asked for, which need both, or a `mesh_attribute`
    gives it: less noise of the same image. Weights a little outside, where an optimizer may step, continue the mixture
    linearly.

    What a blend scatters is exactly the mixture of what its materials scatter, ideal reflection and refraction included.
    Mitsuba 3.9.1 differs: where one material is smooth and the other reflects or refracts ideally, its image is some percent
    darker than the mixture of its own images.

    Args:
        weight: of the second material, in [0, 1]. Of a constant colour the mean is used, of a colour bitmap the luminance.
        bsdf: the two materials, in order.

    Raises:
        ValueError: unless there are two materials, or if a weight is out of range.
    """

    def __init__(self, *, weight: Texture | float, bsdf: list[BSDF]):
        super().__init__()
        if len(bsdf) != 2:
            raise ValueError(f"blendbsdf takes two BSDFs, got {[part.type for part in bsdf]}")
        self.weight = as_texture(self, "weight", weight)
        self.weight_number = (NumberOf(self, "weight"),)  # a tuple, so that it is no submodule
        for number, part in enumerate(bsdf):
            self.add_module(f"bsdf_{number}", part)

    def domains(self) -> dict[str, Domain]:
        return {"weight": FRACTION}

    @property
    def bsdf(self) -> list[BSDF]:
        """The two nested BSDFs, in order."""
        return [self.bsdf_0, self.bsdf_1]

    def kind(self) -> Kind:
        """The functions that evaluate and sample this BSDF."""
        return BlendKind(self.bsdf_0.kind(), self.bsdf_1.kind(), is_still(self.weight))

    def textures(self) -> tuple[Texture, ...]:
        """The textures of this BSDF's parameters, in the order in which its functions take them."""
        return *self.weight_number, *self.bsdf_0.textures(), *self.bsdf_1.textures()
