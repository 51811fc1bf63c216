"""The order of edges in a tree, by position."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.scene.tables.light_tree import halved

GROUP = 8  # edges below each of the last nodes


class EdgeSlots(NamedTuple):
    """The edges of a scene in the order of a tree, with the vertices of their triangles; (S,) int32 each."""

    edge: Tensor  # -1: none
    vertices: tuple[Tensor, ...]  # the edge's a and b, and the vertices opposite
    instance: Tensor | None  # instance as in a hit; None: the scene has none


def slots_of(body: Tensor, points: Tensor) -> Tensor:
    """The edge in each slot of a tree, (S,) int32, S a power of 2; -1: an empty slot.

    Each body has a node of its own, with a power of 2 of slots, the largest first. In it edges are ordered by median splits
    along the axis on which they lie farthest apart.

    Args:
        body: (E,) int32, the body of each edge.
        points: (E, 3) a point on each edge, world.
    """
    bodies, count = body.unique(return_counts=True)
    room = torch.pow(2, torch.ceil(torch.log2(count.double())).long()).clamp_min(GROUP)
    slots = torch.full((1 << (int(room.sum()) - 1).bit_length(),), -1, dtype=torch.int32, device=points.device)
    start = 0
    for one in room.argsort(descending=True, stable=True).tolist():
        own = (body == bodies[one]).nonzero().squeeze(1)
        place, _ = halved(points[own])
        slots[start + place] = own.to(torch.int32)
        start += int(room[one])
    return slots
