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
from torch_radbp.vec import Ray, rows


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


def appearance_met(scene: SceneTensors, hit: Hit, nothing: Tensor) -> tuple[Tensor, Tensor | None]:
    """The number of the appearance that each ray meets if it comes from the front, (N,) int32, and where it matters.

    Args:
        scene: detached; any part of it.
        hit: (N,).
        nothing: () int32, the number where there is none.

    Returns:
        Also (N,) bool, where that from behind is another; None: nowhere.
    """
    row, met = lookup(scene.triangles.material, hit.prim.clamp_min(0)), hit.prim >= 0
    differs = None if scene.materials.differs is None else met & lookup(scene.materials.differs, row)
    return torch.where(met, lookup(scene.materials.appearance, row), nothing), differs


def side_met(scene: SceneTensors, ray: Ray, hit: Hit, lanes: Tensor) -> tuple[Tensor, Tensor]:
    """The number of the appearance of the side that rays meet, (M,) int32, and whether that is the front, (M,) bool.

    Args:
        scene: detached; any part of it.
        ray, hit: (N,).
        lanes: (M,) int32, those that meet a surface.
    """
    ray, hit = rows((ray, hit), lanes)
    front = is_in_front(scene, ray, hit)
    row = lookup(scene.triangles.material, hit.prim)
    return lookup(scene.materials.appearance, row + (~front).to(row.dtype) * scene.materials.count), front


def shines(scene: SceneTensors, hit: Hit) -> Tensor:
    """(N,) bool: rays meet a light, on a surface or around the scene; `scene`: any part."""
    met = hit.prim >= 0
    lit = met & (lookup(scene.triangles.emitter, hit.prim.clamp_min(0)) >= 0)
    return lit | ~met if scene.layout.surround else lit
