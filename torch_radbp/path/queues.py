"""Queues of lanes: after a bounce's rays are cast, paths are sorted by what they meet."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.jit.order import chosen, partition
from torch_radbp.jit.recording.lane_count import LaneCount
from torch_radbp.path.event import Ends, Event
from torch_radbp.path.state import Flight
from torch_radbp.raycast.protocol import Hit
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.stage import stage
from torch_radbp.tensors.vec import Ray, rows
from torch_radbp.vertex.interaction import is_in_front


class Queue(NamedTuple):
    """Lanes with the same event, which run the same functions: a range of the order into which a step has put lanes."""

    event: Event  # what happens to them
    first: int | LaneCount
    last: int | LaneCount  # the place after its last lane
    image: bool = True  # the light that its lanes find counts in the image
    derivative: bool = True  # the backward pass differentiates its lanes


class ImageLanes(NamedTuple):
    """Which lanes count in the image alone and are not differentiated: those from a certain index in their chunk on."""

    lane: Tensor  # (N,) int32, see `PathState`
    first: Tensor  # () int32


EMPTY = Queue(Ends.SURROUNDINGS, 0, 0)  # of no lanes
ALL, APART = ((True, True),), ((False, True), (True, False))  # whether lanes are of the image, and of the derivative


def _numbered(appearance: Tensor, nothing: Tensor | int, image_lanes: ImageLanes | None) -> Tensor:
    """(N,) int32 queue numbers: by appearance, then lanes that hit nothing; lanes that count in the image alone have queues
    of their own.

    Args:
        appearance: (N,) int32; `nothing` where none is met.
        nothing: () int32, the number of events that scatter.
        image_lanes: lanes that count in the image alone; None: there are none.
    """
    if image_lanes is None:
        return appearance
    none, image = appearance == nothing, image_lanes.lane >= image_lanes.first
    return appearance + nothing * (none | image).to(torch.int32) + (none & image).to(torch.int32)


def one_queue(event: Event, found: Tensor) -> tuple[Tensor, tuple[Queue, ...]]:
    """The lanes that have an event, in order, and the queues that they form, where it is the same for all.

    Args:
        event: of all lanes.
        found: the result of `shines`.
    """
    if found.dtype == torch.bool:
        order = chosen(found)
        return order, (Queue(event, 0, len(order)),)
    order, counts = partition(found, 4)
    queues = in_turn([(event, kind) for kind in APART], counts)
    return order[:queues[-1].last], queues


def queues_by(number: Tensor, events: Sequence[Event], apart: bool) -> tuple[Tensor, tuple[Queue, ...]]:
    """Sorts lanes into queues by their numbers; returns the lanes in the order of queues, (K,) int32, and the queues.

    Args:
        number: (N,) int32, as from `appearance_met`.
        events: the possible ones, see `events_of`; lanes without any of these are left out.
        apart: whether some lanes count in the image alone.
    """
    kinds = APART if apart else ALL
    scattering, ending = ([event for event in events if event.scatters == on] for on in (True, False))
    order, counts = partition(number, len(kinds) * (len(scattering) + 1))
    queues = in_turn([(event, kind) for some in (scattering, ending) for kind in kinds for event in some], counts)
    return order[:queues[-1].last], queues


def in_turn(kinds: Sequence[tuple[Event, tuple[bool, bool]]], counts: Sequence[int]) -> tuple[Queue, ...]:
    """Consecutive queues of given sizes; empty ones are dropped, unless all are.

    Args:
        kinds: of each queue its event, and whether its lanes count in the image, and in the derivative.
        counts: the number of lanes of each.
    """
    queues, first = [], 0
    for (event, kind), count in zip(kinds, counts):
        if count:
            queues.append(Queue(event, first, first + count, *kind))
            first += count
    return tuple(queues) or (EMPTY,)


@stage("scene")
def appearance_met(scene: SceneTensors, hit: Hit, nothing: Tensor, image_lanes: ImageLanes | None,
                   flight: Flight | None = None) -> tuple[Tensor, Tensor | None]:
    """The queue number of each ray's event, (N,) int32, by the front of the surface hit; and where the back differs.

    Args:
        scene: detached; any part of it.
        hit: (N,).
        nothing: () int32, the number for rays that hit nothing.
        image_lanes: lanes that count in the image alone; None: there are none.
        flight: (N,) how far paths come in media, see `Arrival`.

    Returns:
        Numbers as of `_numbered`; and (N,) bool: the back has another appearance; None: nowhere.
    """
    row, met = lookup(scene.triangles.material, hit.prim.clamp_min(0)), hit.prim >= 0
    number = torch.where(met, lookup(scene.materials.appearance, row), nothing)
    if flight is not None:  # the ends of flights in media come behind the appearances, in the order of the media
        ends, scattering = flight.t < torch.inf, scene.layout.scattering_media
        for place, medium in enumerate(scattering):
            here = ends if flight.medium is None else ends & (flight.medium == medium)
            number = torch.where(here, nothing - (len(scattering) - place), number)
        met = met & ~ends
    differs = None if scene.materials.differs is None else met & lookup(scene.materials.differs, row)
    return _numbered(number, nothing, image_lanes), differs


@stage("scene", "ray", "hit", "image_lanes")
def side_met(scene: SceneTensors, ray: Ray, hit: Hit, lanes: Tensor, nothing: Tensor,
             image_lanes: ImageLanes | None) -> tuple[Tensor, Tensor]:
    """The queue number by the side of the surface that rays hit, (M,) int32, and whether that is the front, (M,) bool.

    Args:
        scene: detached; any part of it.
        ray, hit: (N,).
        lanes: (M,) int32, those that meet a surface.
        nothing, image_lanes: as for `appearance_met`, (N,).
    """
    ray, hit = rows((ray, hit), lanes)
    front = is_in_front(scene, ray, hit)
    row = lookup(scene.triangles.material, hit.prim)
    number = lookup(scene.materials.appearance, row + (~front).to(row.dtype) * scene.materials.count)
    image_lanes = None if image_lanes is None else image_lanes._replace(lane=rows(image_lanes.lane, lanes))
    return _numbered(number, nothing, image_lanes), front


@stage("scene")
def shines(scene: SceneTensors, hit: Hit, image_lanes: ImageLanes | None, flight: Flight | None = None) -> Tensor:
    """(N,) bool: rays see emission, of a surface, the environment or media; queue numbers, int32, if `image_lanes` are
    given.

    Args:
        scene: detached; any part of it.
        hit, image_lanes, flight: as for `appearance_met`.
    """
    met = hit.prim >= 0
    lit = met & (lookup(scene.triangles.emitter, hit.prim.clamp_min(0)) >= 0)
    found = lit | ~met if scene.layout.surround else lit
    if flight is not None and flight.emission is not None:
        found = found | (flight.emission.weight > 0)
    return found if image_lanes is None else _numbered((~found).to(torch.int32), 1, image_lanes)
