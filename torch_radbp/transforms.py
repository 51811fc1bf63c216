"""Affine transforms, as attributes of plugins, and of points and normals."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.plugin import finite
from torch_radbp.plugin.domain import POSE
from torch_radbp.tensors.asked_later import presumed
from torch_radbp.tensors.differentiated import moving_with


def transform(name: str, matrix: Tensor | None) -> Tensor:
    """Checks a (4, 4) transform given for an attribute; the identity for None. `Plugin.freeze` checks that it is a pose.

    Raises:
        ValueError: if it has another shape, or is not finite.
    """
    dtype = torch.get_default_dtype()
    return torch.eye(4, dtype=dtype) if matrix is None else finite(name, matrix, (4, 4)).to(dtype)


def affine(name: str, matrix: Tensor | None) -> Tensor:
    """Checks an affine transform given for an attribute that does not become a parameter itself; the identity for None.

    Raises:
        ValueError: if it has another shape, is not finite, not affine, or cannot be inverted.
    """
    matrix = transform(name, matrix)
    POSE.check(name, matrix)
    return matrix


def transform_points(matrix: Tensor, points: Tensor) -> Tensor:
    """Transforms (V, 3) points by an affine (4, 4) matrix.

    Sums instead of a matrix product: that would be rounded to bfloat16 by a backward pass under `torch.autocast`, and by
    `torch.set_float32_matmul_precision("medium")`.
    """
    matrix, (x, y, z) = moving_with((matrix, points), (matrix, points.unbind(1)))
    rows = (row.unbind() for row in matrix[:3].unbind())
    return torch.stack([a * x + b * y + c * z + d for a, b, c, d in rows], 1)


def matrix_inverse(matrix: Tensor) -> Tensor:
    """The inverse of matrices (..., N, N) known to be invertible, attached; no check makes the host wait."""
    return torch.linalg.inv_ex(matrix).inverse


def transform_normals(matrix: Tensor, normals: Tensor) -> Tensor:
    """Transforms (V, 3) normals by an affine (4, 4) matrix, and normalises them."""
    inverse = matrix_inverse(matrix[:3, :3].double()).to(matrix.dtype)  # in float64, which autocast leaves alone
    inverse, (x, y, z) = moving_with((inverse, normals), (inverse, normals.unbind(1)))
    columns = (column.unbind() for column in inverse.unbind(1))
    return torch.nn.functional.normalize(torch.stack([a * x + b * y + c * z for a, b, c in columns], 1), dim=1)


def mirrors(matrix: Tensor) -> bool:
    """True if an affine (4, 4) matrix mirrors, that is, has a negative determinant."""
    return presumed(torch.linalg.det(matrix.detach()[:3, :3]) < 0, False)
