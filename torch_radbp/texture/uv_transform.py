"""The affine transform of surface coordinates before a texture is read."""

from __future__ import annotations

import functools
from collections.abc import Sequence

import torch
from torch import Tensor

from torch_radbp.plugin import finite
from torch_radbp.plugin.jump_lines import JumpLines
from torch_radbp.tensors.vec import Vec2, Vec3


def uv_matrix(to_uv: Tensor | None) -> Tensor:
    """(4, 4) the transform in torch's default dtype; only its 2D affine part counts. By default the identity."""
    matrix = torch.eye(4) if to_uv is None else finite("to_uv", to_uv, (4, 4))
    return matrix.to(torch.get_default_dtype())


def uv_rows(matrices: Sequence[Tensor | None], dtype: torch.dtype, device: torch.device) -> tuple[Vec3, Vec3]:
    """The rows of X transforms that give u and v, (X,) each, attached; None stands for the identity."""
    if all(matrix is None for matrix in matrices):
        one, zero = ones_and_zeros(len(matrices), dtype, device)
        # Tables that share memory are one table to what is compiled, and would be so in some scenes only.
        return Vec3(one.clone(), zero.clone(), zero.clone()), Vec3(zero.clone(), one.clone(), zero.clone())
    identity = torch.eye(4, dtype=dtype, device=device)
    stacked = torch.stack([identity if matrix is None else matrix.to(dtype=dtype, device=device) for matrix in matrices])
    return tuple(Vec3(*(stacked[:, row, column].contiguous() for column in (0, 1, 3))) for row in (0, 1))


@functools.lru_cache(maxsize=64)
def ones_and_zeros(count: int, dtype: torch.dtype, device: torch.device) -> tuple[Tensor, Tensor]:
    """`count` ones and as many zeros."""
    with torch.inference_mode(False):  # they are kept, for renderings that are differentiated
        return torch.ones(count, dtype=dtype, device=device), torch.zeros(count, dtype=dtype, device=device)


def jump_lines(to_uv: Tensor, cells: tuple[int, int], inside: bool = False) -> tuple[JumpLines, ...]:
    """The borders, as lines of discontinuity, of the cells into which the unit square of transformed uv is divided.

    Args:
        to_uv: (4, 4) the transform.
        cells: how many along u and along v.
        inside: only those inside of the unit square; else everywhere, as the pattern goes on.
    """
    rows = (to_uv[row, [0, 1, 3]].tolist() for row in (0, 1))
    return tuple(JumpLines(*(size * number for number in row), *((1, size - 1) if inside else ()))
                 for row, size in zip(rows, cells) if size > 1)


def transformed(to_u: Vec3, to_v: Vec3, uv: Vec2) -> Vec2:
    """Transforms surface coordinates, attached."""
    return Vec2(*(row.x * uv.x + row.y * uv.y + row.z for row in (to_u, to_v)))
