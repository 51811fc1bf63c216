"""A volume as a picture: slices through its middle along the three axes, and below them its sums."""

import torch
from torch import Tensor
from torch.nn.functional import pad

GAP = 1  # cells between two parts, white


def volume_picture(values: Tensor, reference: Tensor) -> Tensor:
    """The six parts of a volume: from left, seen along x, y and z; above, slices through the middle; below, sums.

    Seen along x and along z, y points upwards, seen along y, z does.

    Args:
        values: (Z, Y, X, C), C 1 or 3.
        reference: another volume, whose largest value, and largest sums, are white; such as the true one.

    Returns:
        (H, W, C) in [0, 1], linear.
    """
    side = max(values.shape[:3])
    rows = []
    for part in (middle, torch.mean):
        most = max(float(part(reference, axis).max()) for axis in range(3))
        seen = [part(values, axis) / (most or 1.0) for axis in (2, 1, 0)]
        seen[0] = seen[0].transpose(0, 1)  # (Y, Z, C): y upwards, as along z
        rows.append(torch.cat([framed(each.flip(0).clamp(0, 1), side) for each in seen], 1)[:, :-GAP])
    return torch.cat(rows)[:-GAP]


def middle(values: Tensor, axis: int) -> Tensor:
    """The slice through the middle across an axis."""
    return values.select(axis, values.shape[axis] // 2)


def framed(part: Tensor, side: int) -> Tensor:
    """A part (H, W, C) in the middle of a black square, with a white gap to the right and below."""
    height, width = part.shape[:2]
    left, above = (side - width) // 2, (side - height) // 2
    square = pad(part, (0, 0, left, side - width - left, above, side - height - above))
    return pad(square, (0, 0, 0, GAP, 0, GAP), value=1.0)
