"""The vertices of a mesh, by large steps."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from torch.nn.utils import parametrize

import torch_radbp as rb
from benchmarks.headline.unknown import Variable

SMOOTHNESS = 25.0  # as in Mitsuba's tutorial on shapes


class Vertices(NamedTuple):
    """The positions of a mesh's vertices, from where they are in the scene."""

    name: str  # of the mesh
    rate: float  # of Adam with one step size for all entries

    def ours(self, scene: rb.Scene) -> OurVertices:
        return OurVertices(self, scene)

    def mitsubas(self, mi, parameters) -> MitsubasVertices:
        return MitsubasVertices(self, mi, parameters)


class OurVertices(Variable):
    """`rb.optim.LargeSteps` as a parametrisation."""

    def __init__(self, unknown: Vertices, scene: rb.Scene):
        self.mesh = getattr(scene, unknown.name)
        self.mesh.vertex_positions.requires_grad_()
        steps = rb.optim.LargeSteps(self.mesh.faces, self.mesh.vertex_positions, SMOOTHNESS)
        parametrize.register_parametrization(self.mesh, "vertex_positions", steps)
        self.optimizer = rb.optim.AdamUniform([self.mesh.parametrizations.vertex_positions.original], lr=unknown.rate)

    def found(self) -> np.ndarray:
        return self.mesh.vertex_positions.detach().numpy().copy()


class MitsubasVertices(Variable):
    """`mi.ad.LargeSteps`; needs cholespy."""

    def __init__(self, unknown: Vertices, mi, parameters):
        self.parameters, self.target = parameters, f"{unknown.name}.vertex_positions"
        self.steps = mi.ad.LargeSteps(parameters[self.target], parameters[f"{unknown.name}.faces"], SMOOTHNESS)
        self.optimizer = mi.ad.Adam(lr=unknown.rate, uniform=True)
        self.optimizer["smooth"] = self.steps.to_differential(parameters[self.target])
        self.apply()

    def apply(self) -> None:
        self.parameters[self.target] = self.steps.from_differential(self.optimizer["smooth"])

    def found(self) -> np.ndarray:
        return np.array(self.steps.from_differential(self.optimizer["smooth"])).reshape(-1, 3)
