"""A one-sided material, or a pair of them, made two-sided."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from torch_radbp.interface.bsdf import Kind, LobeChoice, Values, either, side_of
from torch_radbp.plugin import BSDF, Texture, boolean, register
from torch_radbp.tensors.vec import Vec3, where


@dataclass(frozen=True)
class TwoSidedKind(Kind):
    """A two-sided BSDF. Parameter values: those of the BSDF in front, and those of the one behind if it differs.

    Used inside of other materials only: a surface whose material itself is two-sided has a row of the material table for
    each side, and its lanes meet one BSDF.
    """

    front: Kind
    back: Kind | None

    @property
    def sides(self) -> tuple[Kind, ...]:
        """The BSDF in front, and the one behind if it differs."""
        return (self.front,) if self.back is None else (self.front, self.back)

    @property
    def delta(self) -> bool:
        return any(side.delta for side in self.sides)

    @property
    def smooth(self) -> bool:
        return any(side.smooth for side in self.sides)

    @property
    def discrete(self) -> bool:
        return any(side.discrete for side in self.sides)

    @property
    def oriented(self) -> bool:
        return any(side.oriented for side in self.sides)

    @property
    def transmits(self) -> bool:
        return any(side.transmits for side in self.sides)

    @property
    def straight(self) -> bool:
        return any(side.straight for side in self.sides)

    @property
    def jumps(self) -> bool:
        return any(side.jumps for side in self.sides)

    @property
    def ends(self) -> bool:
        return any(side.ends for side in self.sides)

    @property
    def slots(self) -> int:
        return sum(side.slots for side in self.sides)

    @property
    def steering(self) -> tuple[int, ...]:
        return self.numbers([side.steering for side in self.sides])

    @property
    def bending(self) -> tuple[int, ...]:
        return self.numbers([side.bending if side.delta or self.follows else () for side in self.sides])

    @property
    def follows(self) -> bool:
        return all(side.follows or not side.smooth for side in self.sides) and self.smooth

    def numbers(self, of_sides: list[tuple[int, ...]]) -> tuple[int, ...]:
        """Renumbers the parameters of the sides' BSDFs as parameters of this one."""
        return *of_sides[0], *(self.front.slots + number for numbers in of_sides[1:] for number in numbers)

    def parts(self, values: Values) -> tuple[Values, ...]:
        """Splits the parameter values into those of each side."""
        return (values,) if self.back is None else (values[:self.front.slots], values[self.front.slots:])

    def diffuse_reflectance(self, values: Values, wi: Vec3) -> Vec3:
        side = side_of(wi)
        of_sides = [kind.diffuse_reflectance(side_values, mirrored(wi, side))
                    for kind, side_values in zip(self.sides, self.parts(values))]
        return where(side > 0, of_sides[0], of_sides[-1])

    def eval_pdf(self, values: Values, wi: Vec3, wo: Vec3, fixed_lobes: bool = False) -> tuple[Vec3, Tensor]:
        side = side_of(wi)
        of_sides = [kind.eval_pdf(side_values, mirrored(wi, side), mirrored(wo, side), fixed_lobes)
                    for kind, side_values in zip(self.sides, self.parts(values))]
        front = side > 0
        return where(front, of_sides[0][0], of_sides[-1][0]), torch.where(front, of_sides[0][1], of_sides[-1][1])

    def choose(self, values: Values, wi: Vec3, choice: Tensor | None, u: Tensor, v: Tensor) -> LobeChoice:
        side = side_of(wi)
        parts = tuple(kind.choose(side_values, mirrored(wi, side), choice, u, v)
                      for kind, side_values in zip(self.sides, self.parts(values)))
        front, delta = side > 0, [part.is_delta(kind) for kind, part in zip(self.sides, parts)]
        return LobeChoice(torch.where(front, parts[0].lobe, parts[-1].lobe),
                      torch.where(front, parts[0].probability, parts[-1].probability),
                      torch.where(front, delta[0], delta[-1]), parts)

    def chance_of_delta(self, values: Values, wi: Vec3) -> Tensor | None:
        side = side_of(wi)
        of_sides = [kind.chance_of_delta(side_values, mirrored(wi, side))
                    for kind, side_values in zip(self.sides, self.parts(values))]
        return None if any(chance is None for chance in of_sides) else torch.where(side > 0, of_sides[0], of_sides[-1])

    def sample(self, values: Values, wi: Vec3, choice: LobeChoice, u: Tensor, v: Tensor) -> Vec3:
        side = side_of(wi)
        of_sides = [kind.sample(side_values, mirrored(wi, side), part, u, v)
                    for kind, side_values, part in zip(self.sides, self.parts(values), choice.parts)]
        return mirrored(where(side > 0, of_sides[0], of_sides[-1]), side)

    def chance_by_direction(self, values: Values, wi: Vec3, wo: Vec3, choice: LobeChoice) -> Tensor | None:
        side = side_of(wi)
        of_sides = [kind.chance_by_direction(side_values, mirrored(wi, side), mirrored(wo, side), part)
                    for kind, side_values, part in zip(self.sides, self.parts(values), choice.parts)]
        return either(side > 0, of_sides[0], of_sides[-1])

    def specular(self, values: Values, wi: Vec3, choice: LobeChoice) -> Vec3:
        side, none = side_of(wi), Vec3.full(wi.z, 0.0)
        of_sides = [kind.specular(side_values, mirrored(wi, side), part) if kind.delta else none
                    for kind, side_values, part in zip(self.sides, self.parts(values), choice.parts)]
        return where(side > 0, of_sides[0], of_sides[-1])

    def spread(self, values: Values, wi: Vec3, choice: LobeChoice) -> Tensor | None:
        side = side_of(wi)
        of_sides = [kind.spread(side_values, mirrored(wi, side), part)
                    for kind, side_values, part in zip(self.sides, self.parts(values), choice.parts)]
        return either(side > 0, of_sides[0], of_sides[-1])


def mirrored(w: Vec3, side: Tensor) -> Vec3:
    """`w` if `side` is 1, mirrored at the surface's plane if it is -1."""
    return Vec3(w.x, w.y, w.z * side)


@register("bsdf", "twosided")
class TwoSided(BSDF):
    """Uses `brdf_0` on the side of the normal, and `brdf_1` or, without one, `brdf_0` again on the other.

    Args:
        brdf: one or two.
        allow_transmission: take those that let light through, too, each of which is seen from its front only.

    Raises:
        ValueError: unless one or two one-sided BSDFs are given.
    """

    def __init__(self, *, brdf: list[BSDF], allow_transmission: bool = False):
        super().__init__()
        self.allow_transmission = boolean("allow_transmission", allow_transmission)
        if not 1 <= len(brdf) <= 2 or any(isinstance(side, TwoSided) for side in brdf):
            raise ValueError(f"twosided takes one or two one-sided BSDFs, got {[side.type for side in brdf]}")
        for side in brdf:
            if side.kind().transmits and not self.allow_transmission:
                raise ValueError(f"twosided takes BSDFs that only reflect, got {side.type!r}, which has two sides already; "
                                 f"with allow_transmission both are its front")
        for number, side in enumerate(brdf):
            self.add_module(f"brdf_{number}", side)
        self.count = len(brdf)

    @property
    def brdf(self) -> list[BSDF]:
        """The one or two one-sided BSDFs that it was made of."""
        return [getattr(self, f"brdf_{number}") for number in range(self.count)]

    def sides(self) -> tuple[BSDF, BSDF]:
        """The BSDF in front and the one behind."""
        return self.brdf[0], self.brdf[-1]

    def kind(self) -> Kind:
        """The functions of both sides together, for a material that nests this one."""
        front, back = self.sides()
        return TwoSidedKind(front.kind(), None if back is front else back.kind())

    def textures(self) -> tuple[Texture, ...]:
        """The textures of this BSDF's parameters, in the order in which its functions take them."""
        return tuple(texture for side in self.brdf for texture in side.textures())
