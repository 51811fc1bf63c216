"""An invisible surface, which all light passes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from torch_radbp.interface.bsdf import DeltaKind, LobeChoice, Values
from torch_radbp.plugin import BSDF, Texture, register
from torch_radbp.tensors.vec import Vec3


@dataclass(frozen=True)
class NullKind(DeltaKind):
    """The BSDF of an invisible surface, without parameters."""

    transmits: ClassVar[bool] = True
    straight: ClassVar[bool] = True
    invisible: ClassVar[bool] = True

    @property
    def slots(self) -> int:
        return 0

    def sample(self, values: Values, wi: Vec3, choice: LobeChoice, u: Tensor, v: Tensor) -> Vec3:
        return -wi

    def specular(self, values: Values, wi: Vec3, choice: LobeChoice) -> Vec3:
        return Vec3.full(wi.z, 1.0)

    def null_transmission(self, values: Values, wi: Vec3) -> tuple[Vec3, Tensor]:
        return Vec3.full(wi.z, 1.0), torch.ones_like(wi.z)


@register("bsdf", "null")
class Null(BSDF):
    """Lets all light pass straight through. It has no parameters.

    As in Mitsuba's path tracer, passing is a bounce that counts towards `max_depth`, and next-event estimation does not
    look through: light behind it is found by paths that pass and happen to meet it. In a scene with media it is as in
    Mitsuba's `volpath`: passing counts nothing, and next-event estimation looks through.
    """

    def __init__(self) -> None:
        super().__init__()

    def kind(self) -> NullKind:
        """The functions that evaluate and sample this BSDF."""
        return NullKind()

    def textures(self) -> tuple[Texture, ...]:
        """The textures of this BSDF's parameters: none."""
        return ()
