"""Poses as recipes see them: a scene's (4, 4) matrix, turned about its own origin and moved.

A pose is recovered as six numbers, a rotation vector w and a translation t, from its initial matrix M. With c the origin
of M, its last column, the matrix is

    P(w, t) = se3(0, c + t) se3(w, 0) se3(0, -c) M

so that a rotation leaves the origin of the object (or the camera) where it is, and scale and shear stay as they are.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor, nn

from torch_radbp.pose import se3

COMPONENTS = tuple(f"{kind}[{axis}]" for kind in ("rotation", "translation") for axis in "xyz")


def moved(matrix: Tensor, rotation_vector: Tensor, translation: Tensor) -> Tensor:
    """P(w, t) of the module's docstring.

    Args:
        matrix: (4, 4) affine.
        rotation_vector: (3,) radians, in world axes; attached.
        translation: (3,) in world units; attached.

    Returns:
        (4, 4), attached to all three.
    """
    turned = se3(rotation_vector, torch.zeros_like(translation))[:3, :3] @ matrix[:3, :3]
    upper = torch.cat([turned, (matrix[:3, 3] + translation)[:, None]], 1)
    return torch.cat([upper, matrix[3:]], 0)


class Rigid(nn.Module):
    """Maps a (2, 3) tensor, rotation vector and translation, to the initial matrix moved by them."""

    def __init__(self, initial: Tensor):
        super().__init__()
        self.register_buffer("initial", initial.detach().clone())

    def forward(self, raw: Tensor) -> Tensor:
        return moved(self.initial, raw[0], raw[1])

    def right_inverse(self, value: Tensor) -> Tensor:
        return motion_between(self.initial, value)


def motion_between(matrix: Tensor, other: Tensor) -> Tensor:
    """The (2, 3) rotation vector, of an angle below pi, and translation that move `matrix` to `other`."""
    rotation = other[:3, :3] @ torch.linalg.inv(matrix[:3, :3])
    lower = torch.stack([rotation[2, 1], rotation[0, 2], rotation[1, 0]])
    upper = torch.stack([rotation[1, 2], rotation[2, 0], rotation[0, 1]])
    axis = 0.5 * (lower - upper)  # times the sine of the angle
    sine = axis.norm()
    angle = torch.atan2(sine, 0.5 * (rotation.trace() - 1))
    scale = angle / sine if sine > 0 else torch.ones_like(angle)
    return torch.stack([axis * scale, other[:3, 3] - matrix[:3, 3]])


class PoseError(NamedTuple):
    """How far two poses are apart: angle in degrees, distance of their origins in world units."""

    angle: float
    distance: float

    @classmethod
    def between(cls, pose: Tensor, truth: Tensor) -> "PoseError":
        """Compares two (4, 4) matrices that differ by a rigid motion."""
        rotation, translation = motion_between(truth.double(), pose.double())
        return cls(math.degrees(rotation.norm().item()), translation.norm().item())


def components(matrix: Tensor, other: Tensor) -> dict[str, float]:
    """The six numbers of `motion_between` by name; rotations in degrees."""
    rotation, translation = motion_between(matrix.double(), other.double())
    return dict(zip(COMPONENTS, [*torch.rad2deg(rotation).tolist(), *translation.tolist()]))
