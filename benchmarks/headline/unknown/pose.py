"""The pose of a shape as six numbers."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch.nn.utils import parametrize

import torch_radbp as rb
from benchmarks.headline.unknown import Variable
from torch_radbp.training.recovery.rigid import Rigid

Triple = tuple[float, float, float]


class Pose(NamedTuple):
    """A rotation vector about the origin of a shape, in radians, and a translation, both from where the shape belongs."""

    name: str  # of the shape
    rotation: Triple
    translation: Triple
    origin: Triple  # of the shape, where it belongs
    rate: float  # Adam's

    def ours(self, scene: rb.Scene) -> OurPose:
        return OurPose(self, scene)

    def mitsubas(self, mi, parameters) -> MitsubasPose:
        return MitsubasPose(self, mi, parameters)


class OurPose(Variable):
    """A parametrisation of `to_world`."""

    def __init__(self, unknown: Pose, scene: rb.Scene):
        shape = getattr(scene, unknown.name)
        shape.to_world.requires_grad_()
        parametrize.register_parametrization(shape, "to_world", Rigid(shape.to_world))
        self.motion = shape.parametrizations.to_world.original
        self.motion.data.copy_(torch.tensor([unknown.rotation, unknown.translation]))
        self.optimizer = torch.optim.Adam([self.motion], lr=unknown.rate)

    def found(self) -> np.ndarray:
        return self.motion.detach().numpy().copy()


class MitsubasPose(Variable):
    """The same by moving the vertices, as Mitsuba's tutorial on poses does."""

    def __init__(self, unknown: Pose, mi, parameters):
        import drjit as dr

        self.mi, self.dr, self.parameters, self.unknown = mi, dr, parameters, unknown
        self.vertices = dr.unravel(mi.Point3f, dr.detach(parameters[self.target]))
        dr.eval(self.vertices)
        self.optimizer = mi.ad.Adam(lr=unknown.rate)
        self.optimizer["rotation"] = mi.Vector3f(*unknown.rotation)
        self.optimizer["translation"] = mi.Vector3f(*unknown.translation)
        self.apply()

    @property
    def target(self) -> str:
        return f"{self.unknown.name}.vertex_positions"

    def apply(self) -> None:
        dr, motion = self.dr, self.mi.Transform4f()
        rotation, origin = self.optimizer["rotation"], self.mi.Vector3f(*self.unknown.origin)
        angle = dr.norm(rotation)
        motion = motion.translate(origin + self.optimizer["translation"]).rotate(rotation / angle, dr.rad2deg(angle))
        self.parameters[self.target] = dr.ravel(motion.translate(-origin) @ self.vertices)

    def found(self) -> np.ndarray:
        return np.stack([np.array(self.optimizer[part]).reshape(3) for part in ("rotation", "translation")])
