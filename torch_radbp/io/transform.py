"""The 4 x 4 matrices of the transform elements of a scene: world from local, float64, column vectors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def translate(offset: Sequence[float]) -> np.ndarray:
    """Moves by `offset` (3,)."""
    matrix = np.eye(4)
    matrix[:3, 3] = offset
    return matrix


def scale(factors: Sequence[float]) -> np.ndarray:
    """Scales along the axes by `factors` (3,)."""
    return np.diag([*factors, 1.0])


def rotate(axis: Sequence[float], angle: float) -> np.ndarray:
    """Turns counter-clockwise by `angle` degrees about `axis` (3,), of any length.

    Mitsuba 3.9 expects an axis of length one without checking and shears with any other; here it is normalised.

    Raises:
        ValueError: if the axis is zero.

    Reference: Rodrigues' formula.
    """
    length = np.linalg.norm(axis)
    if length == 0:
        raise ValueError("the rotation axis must not be zero")
    x, y, z = np.asarray(axis, dtype=np.float64) / length
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    radians = np.deg2rad(angle)
    matrix = np.eye(4)
    matrix[:3, :3] += np.sin(radians) * cross + (1 - np.cos(radians)) * cross @ cross
    return matrix


def look_at(origin: Sequence[float], target: Sequence[float], up: Sequence[float] | None = None) -> np.ndarray:
    """A frame at `origin` whose +z looks at `target`, with +y as close to `up` as possible and +x to the left.

    Without `up` (or with zero) any perpendicular direction is taken, the same as Mitsuba's.

    Raises:
        ValueError: if origin and target coincide or `up` is parallel to the line between them.
    """
    origin = np.asarray(origin, dtype=np.float64)
    forward = _unit(np.asarray(target, dtype=np.float64) - origin, "origin and target must differ")
    up = _perpendicular(forward) if up is None or not np.any(up) else np.asarray(up, dtype=np.float64)
    left = _unit(np.cross(_unit(up, "up must not be zero"), forward), "up must not be parallel to the line of sight")
    matrix = np.eye(4)
    matrix[:3] = np.column_stack([left, np.cross(forward, left), forward, origin])
    return matrix


def affine(values: Sequence[float]) -> np.ndarray:
    """A matrix from its 9 (linear part) or 16 entries, row by row.

    Raises:
        ValueError: on any other number of entries.
    """
    if len(values) not in (9, 16):
        raise ValueError(f"a matrix has 9 or 16 numbers, got {len(values)}")
    size = 3 if len(values) == 9 else 4
    matrix = np.eye(4)
    matrix[:size, :size] = np.reshape(values, (size, size))
    return matrix


def _unit(vector: np.ndarray, complaint: str) -> np.ndarray:
    length = np.linalg.norm(vector)
    if length < 1e-12:
        raise ValueError(complaint)
    return vector / length


def _perpendicular(n: np.ndarray) -> np.ndarray:
    """The first tangent of Duff et al. 2017, "Building an Orthonormal Basis, Revisited"."""
    sign = np.copysign(1.0, n[2])
    a = -1.0 / (sign + n[2])
    return np.array([1.0 + sign * n[0] ** 2 * a, sign * n[0] * n[1] * a, -sign * n[0]])
