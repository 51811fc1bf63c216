"""Matrices of a scene's transform elements, 4 x 4: world from local, float64, column vectors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def translate(offset: Sequence[float]) -> np.ndarray:
    """The translation by `offset` (3,)."""
    matrix = np.eye(4)
    matrix[:3, 3] = offset
    return matrix


def scale(factors: Sequence[float]) -> np.ndarray:
    """The scaling along the axes by `factors` (3,)."""
    return np.diag([*factors, 1.0])


def rotate(axis: Sequence[float], angle: float) -> np.ndarray:
    """The counter-clockwise rotation by `angle` degrees about `axis` (3,), of any length.

    Raises:
        ValueError: if the axis is zero.
    """
    length = np.linalg.norm(axis)
    if length == 0:
        raise ValueError("the rotation axis must not be zero")
    return rotate_unchecked(np.asarray(axis, dtype=np.float64) / length, angle)


def rotate_unchecked(axis: Sequence[float], angle: float) -> np.ndarray:
    """The rotation about an axis of length one; another axis is not normalised, and the matrix scales and shears.

    Reference: Rodrigues' formula, in the form in which Mitsuba 3.9 has it.
    """
    x, y, z = axis
    cosine, sine = np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))
    matrix = np.eye(4)
    matrix[:3, :3] = (cosine * np.eye(3) + sine * np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
                      + (1 - cosine) * np.outer(axis, axis))
    return matrix


def affine_matrix(values: Sequence[float]) -> np.ndarray:
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
