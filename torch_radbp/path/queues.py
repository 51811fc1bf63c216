"""Queues of lanes: after the rays of a bounce are cast, paths are sorted by the appearance of what they meet."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.jit.order import chosen, partition
from torch_radbp.path.event import Ends, Event, Scatters
from torch_radbp.raycast.protocol import Hit
from torch_radbp.scene.interaction import is_in_front
from torch_radbp.scene.tensors import SceneTensors
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.vec import Ray, rows


class Queue(NamedTuple):
    """Lanes that go through the same functions: a part of `Step.order`."""

    event: Event  # what happens to them
    first: int
    last: int  # the place after its last lane
    differentiated: int  # the place after its last lane that the backward pass differentiates; such lanes come first


class ImageLanes(NamedTuple):
    """The lanes that the backward pass does not differentiate: those that have this place in their chunk, or a later one."""

    lane: Tensor  # (N,) int32, see `PathState`
    first: Tensor  # () int32


EMPTY = Queue(Ends.SURROUNDINGS, 0, 0, 0)  # of no lanes


def halved(number: Tensor, image_lanes: ImageLanes | None) -> Tensor:
    """(N,) int32, numbers of queues, each of which has two halves if some lanes are of the image alone: 2 n, and 2 n + 1 of
    these."""
    return number if image_lanes is None else 2 * number + (image_lanes.lane >= image_lanes.first).to(torch.int32)


def one_queue(event: Event, found: Tensor) -> tuple[Tensor, tuple[Queue, ...]]:
    """`Step.order` and `Step.queues` of some lanes, to all of which the same happens.

    Args:
        event: what happens.
        found: of `shines`.
    """
    if found.dtype == torch.bool:
        order = chosen(found)
        return order, (Queue(event, 0, len(order), len(order)),)
    order, (differentiated, others, *_) = partition(found, 4)
    count = differentiated + others
    return order[:count], (Queue(event, 0, count, differentiated),)


def queues_by(number: Tensor, appearances: int, surround: bool, halves: bool) -> tuple[Tensor, tuple[Queue, ...]]:
    """`Step.order` and `Step.queues`.

    Args:
        number: (N,) int32, the appearance that each lane meets, `appearances` where it meets none; as of `halved`.
        appearances: how many there are.
        surround: whether lanes that meet none count.
        halves: whether some lanes are of the image alone.
    """
    kinds = 2 if halves else 1  # of lanes, in each queue
    order, counts = partition(number, kinds * (appearances + 1))
    queues, first = [], 0
    for appearance in range(appearances + 1):
        differentiated, *others = counts[kinds * appearance:kinds * (appearance + 1)]
        last = first + differentiated + sum(others)
        if last > first and (appearance < appearances or surround):
            event = Scatters(appearance) if appearance < appearances else Ends.SURROUNDINGS
            queues.append(Queue(event, first, last, first + differentiated))
            first = last
    return order[:first], tuple(queues) or (EMPTY,)


def appearance_met(scene: SceneTensors, hit: Hit, nothing: Tensor,
                   image_lanes: ImageLanes | None) -> tuple[Tensor, Tensor | None]:
    """The number of the appearance that each ray meets if it comes from the front, (N,) int32, and where it matters.

    Args:
        scene: detached; any part of it.
        hit: (N,).
        nothing: () int32, the number where there is none.
        image_lanes: those of the image alone; None: there are none.

    Returns:
        Numbers as of `halved`. Also (N,) bool, where that from behind is another; None: nowhere.
    """
    row, met = lookup(scene.triangles.material, hit.prim.clamp_min(0)), hit.prim >= 0
    differs = None if scene.materials.differs is None else met & lookup(scene.materials.differs, row)
    return halved(torch.where(met, lookup(scene.materials.appearance, row), nothing), image_lanes), differs


def side_met(scene: SceneTensors, ray: Ray, hit: Hit, lanes: Tensor,
             image_lanes: ImageLanes | None) -> tuple[Tensor, Tensor]:
    """The number of the appearance of the side that rays meet, (M,) int32, and whether that is the front, (M,) bool.

    Args:
        scene: detached; any part of it.
        ray, hit: (N,).
        lanes: (M,) int32, those that meet a surface.
        image_lanes: as for `appearance_met`, (N,).
    """
    ray, hit = rows((ray, hit), lanes)
    front = is_in_front(scene, ray, hit)
    row = lookup(scene.triangles.material, hit.prim)
    number = lookup(scene.materials.appearance, row + (~front).to(row.dtype) * scene.materials.count)
    image_lanes = None if image_lanes is None else image_lanes._replace(lane=rows(image_lanes.lane, lanes))
    return halved(number, image_lanes), front


def shines(scene: SceneTensors, hit: Hit, image_lanes: ImageLanes | None) -> Tensor:
    """(N,) bool: rays meet a light, on a surface or around the scene. If some lanes are of the image alone, int32 instead: 0
    where they do, 1 in these lanes, at least 2 elsewhere.

    Args:
        scene: detached; any part of it.
        hit, image_lanes: as for `appearance_met`.
    """
    met = hit.prim >= 0
    lit = met & (lookup(scene.triangles.emitter, hit.prim.clamp_min(0)) >= 0)
    found = lit | ~met if scene.layout.surround else lit
    return found if image_lanes is None else halved((~found).to(torch.int32), image_lanes)
