"""Priors of smooth, piecewise constant, or piecewise linear maps and grids."""

from __future__ import annotations

from itertools import combinations_with_replacement

import torch
from torch import Tensor

from torch_radbp.plugin import positive


def total_variation(values: Tensor, epsilon: float = 1e-3, wrap_rows: bool = False, wrap_columns: bool = False) -> Tensor:
    """The mean length of the differences between a texel and its neighbours to the right and below, channels together.

    Few large jumps cost no more than many small ones, so that maps become piecewise constant and keep their edges. Lengths
    are sqrt(difference^2 + epsilon^2) - epsilon, which are smooth at 0. `kornia.losses.total_variation` is that of images
    (C, H, W), a sum, with each direction and channel by itself.

    Args:
        values: (H, W, C), such as `data` of a bitmap or an environment; attached.
        epsilon: differences below count by their squares; in units of the map.
        wrap_rows, wrap_columns: whether the last row, or column, is the neighbour of the first: both of a bitmap that
            repeats, columns alone of an environment.

    Returns:
        A scalar, in units of the map.

    Raises:
        ValueError: for another shape, or if epsilon is not positive.

    Reference: Rudin, Osher and Fatemi 1992, "Nonlinear Total Variation Based Noise Removal Algorithms".
    """
    down, right = _differences(values, wrap_rows, wrap_columns)
    least = positive("epsilon", epsilon)
    square = down.square().sum(-1) + right.square().sum(-1)
    return ((square + least**2).sqrt() - least).mean()


def smoothness(values: Tensor, wrap_rows: bool = False, wrap_columns: bool = False) -> Tensor:
    """The mean squared difference between a texel and its next neighbours to the right and below, summed over channels.

    Large jumps cost most, so that maps become smooth and lose their edges; for light from all around, and at the beginning.

    Args:
        values: (H, W, C), such as `data` of a bitmap or an environment; attached.
        wrap_rows, wrap_columns: as of `total_variation`.

    Returns:
        A scalar, in squared units of the map.

    Raises:
        ValueError: for another shape.
    """
    down, right = _differences(values, wrap_rows, wrap_columns)
    return (down.square() + right.square()).sum(-1).mean()


def bending(values: Tensor, epsilon: float = 1e-3) -> Tensor:
    """The mean length of the second differences of a map or a grid, channels together: that of the Hessian (Frobenius norm).

    Slopes cost nothing, and a sharp bend no more than many slight ones, so that what images leave open becomes piecewise
    linear, without the steps that total variation makes of slopes: for smoke, heights, light. Lengths are
    sqrt(difference^2 + epsilon^2) - epsilon, which are smooth at 0.

    Args:
        values: (H, W, C), or (Z, Y, X, C) such as `data` of a gridvolume, at least 3 along each axis; attached.
        epsilon: second differences below count by their squares; in units of the map.

    Returns:
        A scalar, in units of the map.

    Raises:
        ValueError: for another shape, or if epsilon is not positive.

    References: Lysaker, Lundervold and Tai 2003, "Noise Removal Using Fourth-Order Partial Differential Equation with
    Applications to Medical Magnetic Resonance Images in Space and Time"; Lefkimmiatis, Bourquard and Unser 2012,
    "Hessian-Based Norm Regularization for Image Restoration With Biomedical Applications".
    """
    axes = values.shape[:-1]
    if not values.is_floating_point() or len(axes) not in (2, 3) or min(axes) < 3 or values.numel() == 0:
        raise ValueError(f"values must be floats of shape (H, W, C) or (Z, Y, X, C), at least 3 along each axis but the "
                         f"last, got {values.dtype} of {tuple(values.shape)}")
    least, square = positive("epsilon", epsilon), values.new_zeros(())
    for first, second in combinations_with_replacement(range(len(axes)), 2):
        difference = values.diff(dim=first).diff(dim=second)
        # Texels that have a difference along every axis.
        for axis, size in enumerate(axes):
            difference = difference.narrow(axis, (difference.shape[axis] - size + 2) // 2, size - 2)
        square = square + (1 if first == second else 2) * difference.square().sum(-1)
    return ((square + least**2).sqrt() - least).mean()


def _differences(values: Tensor, wrap_rows: bool, wrap_columns: bool) -> tuple[Tensor, Tensor]:
    """(H, W, C) differences from each texel to the one below, and to the one on the right; 0 at a border without wrap."""
    if values.ndim != 3 or not values.is_floating_point() or values.numel() == 0:
        raise ValueError(f"values must be floats of shape (H, W, C), got {values.dtype} of {tuple(values.shape)}; of an "
                         f"image (C, H, W) take values.movedim(0, -1)")
    down, right = (torch.roll(values, -1, axis) - values for axis in (0, 1))
    if not wrap_rows:
        down = torch.cat([down[:-1], torch.zeros_like(down[-1:])])
    if not wrap_columns:
        right = torch.cat([right[:, :-1], torch.zeros_like(right[:, -1:])], 1)
    return down, right
