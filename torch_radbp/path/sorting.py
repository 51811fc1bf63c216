"""What rays meet, and so in which queue their lanes are."""

from __future__ import annotations

from torch import Tensor

from torch_radbp.jit.order import chosen, nothing
from torch_radbp.path.camera_hit import camera_hit
from torch_radbp.path.event import Ends, events_of
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.lanes import put_rows
from torch_radbp.path.queues import ImageLanes, Queue, appearance_met, one_queue, queues_by, shines, side_met
from torch_radbp.path.state import Flight
from torch_radbp.raycast.protocol import Hit
from torch_radbp.tensors.vec import Ray


def first_hit(integrand: Integrand, ray: Ray, depth: int) -> Hit:
    """The closest hits of rays at a bounce; of camera rays, the closest visible ones."""
    if depth > 0:
        return integrand.caster.intersect(ray)
    return camera_hit(integrand.caster, integrand.proposal, ray, integrand.clipping, integrand.settings.hide_emitters)


def queued(integrand: Integrand, ray: Ray, hit: Hit, last: bool, image_lanes: ImageLanes | None = None,
           flight: Flight | None = None) -> tuple[Tensor | None, Tensor, tuple[Queue, ...]]:
    """Sorts rays with hits into queues by what they meet.

    Args:
        ray, hit: (N,).
        last: whether this is the last bounce, where only emission counts.
        image_lanes: lanes that count in the image alone; None: there are none.
        flight: (N,) how far paths come in media, see `Arrival`.

    Returns:
        (N,) bool, the front of a surface is met (None: sides do not differ); the lanes in the order of queues; the queues.
    """
    if last:
        return None, *one_queue(Ends.LAST_BOUNCE, integrand.part(Ends.LAST_BOUNCE).call(shines, hit, image_lanes, flight))
    number, front = appearances_met(integrand, ray, hit, image_lanes, flight)
    return front, *queues_by(number, events_of(integrand.proposal.layout, last), image_lanes is not None)


def appearances_met(integrand: Integrand, ray: Ray, hit: Hit, image_lanes: ImageLanes | None = None,
                    flight: Flight | None = None) -> tuple[Tensor, Tensor | None]:
    """The queue numbers of rays with hits, (N,) int32, and (N,) bool, whether they meet the front of a surface; None: sides
    do not differ. Args as for `queued`."""
    part = integrand.part(Ends.SURROUNDINGS)
    number, differs = part.call(appearance_met, hit, integrand.no_appearance, image_lanes, flight)
    front = None if differs is None else nothing(differs)
    if differs is not None and len(lanes := chosen(differs)):
        put_rows((number, front), lanes, part.call(side_met, ray, hit, lanes, integrand.no_appearance, image_lanes))
    return number, front

