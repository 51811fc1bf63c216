"""Queues of lanes: after the rays of a bounce are cast, paths are sorted by the appearance of what they meet."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.jit.order import partition
from torch_radbp.lookup import lookup
from torch_radbp.raycast.protocol import Hit
from torch_radbp.scene.interaction import is_in_front
from torch_radbp.scene.tensors import SceneTensors
from torch_radbp.vec import Ray


class Queue(NamedTuple):
    """Lanes that go through the same functions: a part of `Step.order`."""

    appearance: int | None  # of what they meet, a number of `Layout.appearances`; None: only what is emitted counts
    first: int
    last: int  # the place after its last lane


NOTHING = Queue(None, 0, 0)  # of no lanes


def queues_by(number: Tensor, appearances: int, surround: bool) -> tuple[Tensor, tuple[Queue, ...]]:
    """`Step.order` and `Step.queues`.

    Args:
        number: (N,) int32, the appearance that each lane meets; `appearances` where it meets none.
        appearances: how many there are.
        surround: whether lanes that meet none count.
    """
    order, counts = partition(number, appearances + 1)
    queues, first = [], 0
    for appearance, count in enumerate(counts):
        if count and (appearance < appearances or surround):
            queues.append(Queue(appearance if appearance < appearances else None, first, first + count))
            first += count
    return order[:first], tuple(queues) or (NOTHING,)


def appearance_met(scene: SceneTensors, ray: Ray, hit: Hit, nothing: Tensor, sides_differ: bool
                   ) -> tuple[Tensor, Tensor | None]:
    """The number of the appearance that each ray meets, (N,) int32, and `Step.front`.

    Args:
        scene: detached; any part of it.
        ray, hit: (N,).
        nothing: () int32, the number where there is none.
        sides_differ: whether the two sides of a surface may have different ones.
    """
    row, front = lookup(scene.triangles.material, hit.prim.clamp_min(0)), None
    if sides_differ:
        front = is_in_front(scene, ray, hit)
        row = row + (~front).to(row.dtype) * scene.materials.count
    return torch.where(hit.prim >= 0, lookup(scene.materials.appearance, row), nothing), front


def shines(scene: SceneTensors, hit: Hit) -> Tensor:
    """(N,) bool: rays meet a light, on a surface or around the scene; `scene`: any part."""
    met = hit.prim >= 0
    lit = met & (lookup(scene.triangles.emitter, hit.prim.clamp_min(0)) >= 0)
    return lit | ~met if scene.layout.surround else lit
