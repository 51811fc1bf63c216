"""Poses as recipes see them: a scene's (4, 4) matrix, turned about its own origin and moved.

A pose is recovered as six numbers, a rotation vector w and a translation t, from its initial matrix M. With c the origin
of M, its last column, the matrix is

    P(w, t) = se3(0, c + t) se3(w, 0) se3(0, -c) M

so that a rotation leaves the origin of the object (or the camera) where it is, and scale and shear stay as they are. The
optimiser's own numbers may be of a rotation about another place c, a pivot. With the middle of what a camera looks at as the
pivot, the rotation turns the view and the translation shifts it; with the camera's own origin both shift it, and one
that scales each number by itself, as Adam does, is slow to tell them apart. For the same reason they are then along the own
axes of M, so that the distance, which hardly shows in an image, is a number by itself; and the unit of translations is the
distance of c, so that a step shifts the image by about as large an angle as a step of the rotation is.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor, nn

from torch_radbp.pose import se3
from torch_radbp.tensors.differentiated import moving_with

COMPONENTS = tuple(f"{kind}[{axis}]" for kind in ("rotation", "translation") for axis in "xyz")


def moved(matrix: Tensor, rotation_vector: Tensor, translation: Tensor, pivot: Tensor | None = None) -> Tensor:
    """Computes P(w, t) of the module's docstring.

    Args:
        matrix: (4, 4) affine.
        rotation_vector: (3,) radians, in world axes; attached.
        translation: (3,) in world units; attached.
        pivot: (3,) c, in world space; None: the origin of the matrix.

    Returns:
        (4, 4), attached to the first three.
    """
    turn = se3(rotation_vector, torch.zeros_like(translation))[:3, :3]
    origin = matrix[:3, 3] if pivot is None else pivot + turn @ (matrix[:3, 3] - pivot)
    upper = torch.cat([turn @ matrix[:3, :3], (origin + translation)[:, None]], 1)
    return torch.cat([upper, matrix[3:]], 0)


class Rigid(nn.Module):
    """Maps a (2, 3) tensor, rotation vector and translation, to the initial matrix moved by them.

    Args:
        initial: (4, 4).
        pivot: the three coordinates of c. Both vectors are then along the axes of `initial`, or the orthogonal ones that are
            nearest to them, and translations in units of the distance of its origin from c, unless that is 0. None: the
            origin of `initial`, axes and units of the world.
    """

    def __init__(self, initial: Tensor, pivot: list[float] | None = None):
        super().__init__()
        self.register_buffer("initial", initial.detach().clone())
        self.register_buffer("pivot", None if pivot is None else initial.new_tensor(pivot))
        distance = 1.0 if pivot is None else (self.initial[:3, 3] - self.pivot).norm().item() or 1.0
        self.register_buffer("axes", torch.eye(3).to(initial) if pivot is None else own_axes(self.initial))
        self.register_buffer("units", initial.new_tensor([[1.0], [distance]]))

    def forward(self, raw: Tensor) -> Tensor:
        units, axes = moving_with(raw, (self.units, self.axes))
        rotation, translation = units * raw @ axes.T
        return moved(self.initial, rotation, translation, self.pivot)

    def right_inverse(self, value: Tensor) -> Tensor:
        return motion_between(self.initial, value, self.pivot) @ self.axes / self.units


def own_axes(matrix: Tensor) -> Tensor:
    """Computes the orthogonal (3, 3) matrix that is nearest to that of a (4, 4) affine one; its columns are the axes."""
    left, _, right = torch.linalg.svd(matrix[:3, :3])
    return left @ right


def motion_between(matrix: Tensor, other: Tensor, pivot: Tensor | None = None) -> Tensor:
    """Computes the (2, 3) rotation vector, of an angle of at most pi, and translation that move `matrix` to `other`."""
    rotation = other[:3, :3] @ torch.linalg.inv(matrix[:3, :3])
    origin = matrix[:3, 3] if pivot is None else pivot + rotation @ (matrix[:3, 3] - pivot)
    return torch.stack([rotation_vector(rotation), other[:3, 3] - origin])


def rotation_vector(rotation: Tensor) -> Tensor:
    """Computes axis times angle, (3,) radians, of a (3, 3) rotation; at an angle of pi either of the two signs.

    By way of the unit quaternion (w, x, y, z), whose largest component is found first and divides the others: the
    antisymmetric part of the matrix alone tells angles near pi badly, and the axis at pi not at all.

    Reference: Shepperd 1978, "Quaternion from rotation matrix".
    """
    diagonal, trace = rotation.diagonal(), rotation.trace()
    squares = 0.25 * torch.cat([1 + trace[None], 1 - trace + 2 * diagonal])  # of w, x, y, z
    lower = torch.stack([rotation[2, 1], rotation[0, 2], rotation[1, 0]])
    upper = torch.stack([rotation[1, 2], rotation[2, 0], rotation[0, 1]])
    w_times_axis = 0.25 * (lower - upper)  # (wx, wy, wz)
    yz, zx, xy = (0.25 * (lower + upper)).unbind()
    x2, y2, z2 = squares[1:].unbind()
    products = torch.stack([  # of the quaternion with itself, one row per component
        torch.cat([squares[:1], w_times_axis]),
        torch.stack([w_times_axis[0], x2, xy, zx]),
        torch.stack([w_times_axis[1], xy, y2, yz]),
        torch.stack([w_times_axis[2], zx, yz, z2]),
    ])
    quaternion = torch.nn.functional.normalize(products[squares.argmax()], dim=0)
    quaternion = torch.where(quaternion[0] < 0, -quaternion, quaternion)
    half_sine = quaternion[1:].norm()
    scale = 2 * torch.atan2(half_sine, quaternion[0]) / half_sine if half_sine > 0 else 2.0
    return quaternion[1:] * scale


class PoseError(NamedTuple):
    """Distance of two poses: angle in degrees, distance of their origins in world units."""

    angle: float
    distance: float

    @classmethod
    def between(cls, pose: Tensor, truth: Tensor) -> "PoseError":
        """Compares two (4, 4) matrices that differ by a rigid motion."""
        rotation, translation = motion_between(truth.double(), pose.double())
        return cls(math.degrees(rotation.norm().item()), translation.norm().item())


def components(matrix: Tensor, other: Tensor) -> dict[str, float]:
    """Returns the six numbers of `motion_between` by name; rotations in degrees."""
    rotation, translation = motion_between(matrix.double(), other.double())
    return dict(zip(COMPONENTS, [*torch.rad2deg(rotation).tolist(), *translation.tolist()]))
