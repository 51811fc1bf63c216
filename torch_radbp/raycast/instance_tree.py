"""A complete binary tree over the boxes of instances, built by plain torch, so that no device is asked anything.

Node k has the children 2 k and 2 k + 1, and all leaves are on the lowest level: so the way back from a node is in its
number, and who walks the tree needs a bit for each level in the place of a stack. Boxes are halved at the median along the
axis on which their centres are spread the most; where they are no power of two, some leaves are empty, at most one of two
neighbours.

Reference: Binder and Keller 2016, "Efficient stackless hierarchy traversal on GPUs with backtracking in constant time".
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

EMPTY = 3e38  # the lower corner of an empty box, whose upper corner is its negative


class InstanceTree(NamedTuple):
    """A tree over I boxes with L leaves, the least power of two that is not less than I."""

    nodes: Tensor  # (2 L, 2, 3) the lower and the upper corner of each node; 1 is the root, the leaves begin at L
    order: Tensor  # (L,) int64, the box of each leaf; -1: it is empty


def instance_tree(low: Tensor, high: Tensor) -> InstanceTree:
    """Builds a complete binary tree over the bounding boxes of instances.

    Args:
        low, high: (I, 3) corners of the boxes.
    """
    order = leaves_of_boxes(low + high)
    has_box, box = (order >= 0)[:, None], order.clamp_min(0)
    levels = [(torch.where(has_box, low[box], EMPTY), torch.where(has_box, high[box], -EMPTY))]
    while len(levels[-1][0]) > 1:
        lower, upper = (corners.unflatten(0, (-1, 2)) for corners in levels[-1])
        levels.append((lower.amin(1), upper.amax(1)))
    none = torch.zeros(1, 2, 3, dtype=low.dtype, device=low.device)
    return InstanceTree(torch.cat([none, *(torch.stack(corners, 1) for corners in reversed(levels))]), order)


def leaves_of_boxes(centre: Tensor) -> Tensor:
    """The box of each leaf of a tree over boxes, (L,) int64; -1: the leaf is empty.

    Args:
        centre: (I, 3) of the boxes, whatever their unit.
    """
    leaves = 1 << (len(centre) - 1).bit_length()
    order = torch.nn.functional.pad(torch.arange(len(centre), device=centre.device), (0, leaves - len(centre)), value=-1)
    order, boxes = order[None], torch.full((1, 1), len(centre), device=centre.device)  # of each node of a level
    while order.shape[1] > 1:
        has_box, points = (order >= 0)[:, :, None], centre[order.clamp_min(0)]
        spread = torch.where(has_box, points, -torch.inf).amax(1) - torch.where(has_box, points, torch.inf).amin(1)
        axis = spread.argmax(1).view(-1, 1, 1).expand(-1, order.shape[1], 1)
        along = torch.where(has_box, points, torch.inf).gather(2, axis).squeeze(2)
        order = order.gather(1, along.argsort(dim=1, stable=True))  # empty leaves come last
        half, first = order.shape[1] // 2, (boxes + 1) // 2
        place = torch.arange(half, device=centre.device).expand(len(order), -1)
        halves = [torch.where(place < first, order[:, :half], -1), order.gather(1, first + place)]
        order, boxes = torch.stack(halves, 1).flatten(0, 1), torch.stack([first, boxes - first], 1).flatten(0, 1)
    return order.flatten()
