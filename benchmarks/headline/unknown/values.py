"""Numbers that are optimised as they are: colours, texels, radiances."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch

import torch_radbp as rb
from benchmarks.headline.unknown import Variable


class Values(NamedTuple):
    """A parameter of the scene by the name that both renderers have for it."""

    name: str
    start: float
    rate: float  # Adam's
    most: float = 1e6
    padding: int = 0  # columns that Mitsuba's environment maps have more, at either side

    def ours(self, scene: rb.Scene) -> OurValues:
        return OurValues(self, scene)

    def mitsubas(self, mi, parameters) -> MitsubasValues:
        return MitsubasValues(self, mi, parameters)


class OurValues(Variable):
    """The parameter itself, optimised by torch."""

    def __init__(self, unknown: Values, scene: rb.Scene):
        self.parameter, self.most = scene.get_parameter(unknown.name), unknown.most
        self.parameter.data.fill_(unknown.start)
        self.parameter.requires_grad_()
        self.optimizer = torch.optim.Adam([self.parameter], lr=unknown.rate)

    def clamp(self) -> None:
        self.parameter.data.clamp_(0, self.most)

    def found(self) -> np.ndarray:
        return self.parameter.detach().numpy().copy()


class MitsubasValues(Variable):
    """The same in Mitsuba."""

    def __init__(self, unknown: Values, mi, parameters):
        import drjit as dr

        self.unknown, self.parameters, self.clip = unknown, parameters, dr.clip
        self.optimizer = mi.ad.Adam(lr=unknown.rate)
        self.optimizer[unknown.name] = dr.detach(parameters[unknown.name]) * 0 + unknown.start
        self.apply()

    def apply(self) -> None:
        self.parameters[self.unknown.name] = self.optimizer[self.unknown.name]

    def clamp(self) -> None:
        name = self.unknown.name
        self.optimizer[name] = self.clip(self.optimizer[name], 0, self.unknown.most)

    def found(self) -> np.ndarray:
        found, padding = np.array(self.optimizer[self.unknown.name]), self.unknown.padding
        return found[:, padding:-padding] if padding else found.reshape(-1) if found.size == 3 else found
