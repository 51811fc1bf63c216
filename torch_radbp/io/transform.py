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
