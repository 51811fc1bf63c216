"""A mixture of two phase functions."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torch_radbp.interface.phase import PhaseFunction, PhaseKind
from torch_radbp.interface.volume import VolumeKind
from torch_radbp.plugin import Phase, Texture, Volume, register
from torch_radbp.plugin.domain import FRACTION, Domain
from torch_radbp.sampling.sampler import LARGEST_NUMBER
from torch_radbp.tensors.differentiated import settled
from torch_radbp.tensors.vec import Vec3, where
from torch_radbp.volume.constvolume import ConstVolume, as_volume

LEAST_CHANCE = 0.02  # of either: one of weight 0 is sampled, so that the weight has its derivative


class BlendTable(NamedTuple):
    """The parameters of a mixture of two phase functions, attached."""

    weight: Any  # table of a volume
    first: Any  # numbers of the two
    second: Any


@dataclass(frozen=True)
class BlendPhaseKind(PhaseKind):
    """The mixture (1 - w) p0 + w p1, whose weight w may vary in space and gives the probability of sampling p1."""

    weight: VolumeKind
    first: PhaseKind
    second: PhaseKind

    def share(self, table: BlendTable, p: Vec3) -> tuple[Tensor, Tensor]:
        """The weight, kept in [0, 1] with its derivative, and the probability by which the second is sampled."""
        weight = self.weight.eval(table.weight, p).x
        kept = weight + (weight.detach().clamp(0.0, 1.0) - weight.detach())
        return kept, weight.clamp(LEAST_CHANCE, 1.0 - LEAST_CHANCE)

    def eval_pdf(self, table: BlendTable, p: Vec3, wi: Vec3, wo: Vec3) -> tuple[Tensor, Tensor]:
        weight, chance = self.share(table, p)
        first, first_pdf = self.first.eval_pdf(table.first, p, wi, wo)
        second, second_pdf = self.second.eval_pdf(table.second, p, wi, wo)
        return first * (1.0 - weight) + second * weight, first_pdf * (1.0 - chance) + second_pdf * chance

    def sample(self, table: BlendTable, p: Vec3, wi: Vec3, u: Tensor, v: Tensor) -> Vec3:
        chance = settled(self.share(table, p)[1])
        is_second = u < chance
        rest = torch.where(is_second, u / chance, (u - chance) / (1.0 - chance)).clamp(0.0, LARGEST_NUMBER)
        return where(is_second, self.second.sample(table.second, p, wi, rest, v),
                     self.first.sample(table.first, p, wi, rest, v))

    def projected_area(self, table: BlendTable, p: Vec3, wi: Vec3) -> Tensor | None:
        areas = self.first.projected_area(table.first, p, wi), self.second.projected_area(table.second, p, wi)
        if areas == (None, None):
            return None
        first, second = (torch.ones_like(p.x) if area is None else area for area in areas)
        weight, _ = self.share(table, p)
        return first * (1.0 - weight) + second * weight


@register("phase", "blendphase")
class BlendPhase(PhaseFunction):
    """A mixture of two phase functions: `phase_0` where the weight is 0, `phase_1` where it is 1.

    Parameters: `weight`, a volume, and those of both phase functions. Derivatives: with respect to all of them.

    Args:
        weight: of the second one, in [0, 1]; a number, or a volume of one channel.
        phase: the two phase functions, in order.

    Raises:
        ValueError: unless there are two phase functions, or if a weight is out of range.
    """

    def __init__(self, *, weight: Volume | Texture | float, phase: list[Phase]):
        super().__init__()
        if len(phase) != 2:
            raise ValueError(f"blendphase takes two phase functions, got {[part.type for part in phase]}")
        self.weight = as_volume(self, "weight", weight)
        for number, part in enumerate(phase):
            self.add_module(f"phase_{number}", part)

    def domains(self) -> dict[str, Domain]:
        return {"weight": FRACTION}

    @property
    def phase(self) -> list[Phase]:
        """The two nested phase functions, in order."""
        return [self.phase_0, self.phase_1]

    def kind(self) -> BlendPhaseKind:
        return BlendPhaseKind(self.weight.kind(), self.phase_0.kind(), self.phase_1.kind())

    def row(self) -> BlendTable:
        return BlendTable(self.weight.table(), self.phase_0.row(), self.phase_1.row())

    def extreme_areas(self) -> tuple[Tensor | float, Tensor | float]:
        largest, least = zip(*(part.extreme_areas() for part in self.phase))
        return max(largest), min(least)

    def even_area(self) -> bool:
        same = all(isinstance(part.extreme_areas()[0], float) for part in self.phase)  # 1 of both
        return same or (isinstance(self.weight, ConstVolume) and all(part.even_area() for part in self.phase))
