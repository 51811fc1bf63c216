"""The boundary term of primary visibility: derivatives from discontinuities that the camera sees directly.

Where the radiance L jumps along a curve of the film, and the curve moves by v, a pixel that counts points of the film by h
changes by

    dI = integral of h (L_behind - L_ahead) v . n dl

along the curve, whose normal n points ahead. Each kind of curve is a term, one class in one file (`curve/film_term.py`),
that samples places on it. L is estimated on either side by a path through a point close by, and v follows the attached
vertices and the attached camera. The place on an edge stays where it is on the edge: sliding along it changes nothing.

Both paths have the same random numbers. So where a medium is before the curve they scatter in it at the same place or not at
all, and L differs by what is seen of the jump through it. Boundaries that rays pass straight hide nothing.

The result is an image of zeros with that derivative, backward and forward.

Reference: Li, Aittala, Durand and Lehtinen 2018, "Differentiable Monte Carlo Ray Tracing through Edge Sampling", section 4.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cache, partial
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.curve.edge_places import edge_weight
from torch_radbp.boundary.curve.film_term import FILM_TERMS, ExaminedView, lanes
from torch_radbp.boundary.curve.geometry import geometry_of
from torch_radbp.boundary.curve.moving import MOST_SHOWN
from torch_radbp.boundary.curve.outline import Jumps
from torch_radbp.boundary.curve.places import (
    FEWEST,
    LARGEST_SHARE,
    RIM,
    Places,
    place_counts,
    rays_beside,
    sight_of,
    taken_by,
)
from torch_radbp.boundary.curve.silhouette import Eye
from torch_radbp.boundary.curve.term import lines_slide
from torch_radbp.boundary.curve.terminators import lamps_of
from torch_radbp.boundary.eye.deposit import Deposit, image_of
from torch_radbp.boundary.eye.in_sight import PathsBeside, Sent, in_sight, on_boundary, paths_beside
from torch_radbp.boundary.eye.lit_sides import deposits_of_sides, light_from_lamps
from torch_radbp.boundary.eye.motion import JumpPlaces, moved_places
from torch_radbp.call.render_call import RenderCall, integrand_of, started
from torch_radbp.jit.order import chosen
from torch_radbp.path.event import Ends
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.sorting import first_hit
from torch_radbp.path.step import Onward
from torch_radbp.path.through_media import free_flights
from torch_radbp.path.trace import trace
from torch_radbp.scene.cache.common_work import Facts, once
from torch_radbp.tensors.differentiated import any_differentiated, detached
from torch_radbp.tensors.record import joined
from torch_radbp.tensors.vec import rows
from torch_radbp.threads.workers import in_turns

BYTES_OF_TRIANGLE = 48  # weights of its edges and their sums
BYTES_OF_PLACE = 640  # what is known of it, three rays and what they meet, two paths, and how it moves
LONG = 16  # times as long as the image is wide and high: curves of a cluttered view

Evaluate = Callable[[Integrand, Onward], tuple[Tensor, ...]]


class SeenByCamera(NamedTuple):
    """The quantities of camera paths, such as radiance or AOVs, whose discontinuities are differentiated."""

    turns: tuple[bool, ...]  # for each channel, whether the two sides of a surface differ
    evaluate: Evaluate  # computes the channels, detached
    is_radiance: bool = False


def moves(call: RenderCall) -> bool:
    """True if a vertex, shading normal, instance or camera is differentiated, or a texture line slides over its surface."""
    vertices, instances = call.scene.triangles.vertices, call.scene.triangles.instances
    poses = instances and (instances.linear, instances.origin), [view.camera.lens for view in call.views]
    return lines_slide(call) or any_differentiated((vertices.p, vertices.n, poses))


def bytes_of_jumps(call: RenderCall) -> int:
    """The memory in bytes for discontinuity curves and samples on them, for a large total length of curves."""
    triangles, paths = len(call.scene.triangles.material), call.spp * max(view.width * view.height for view in call.views)
    instances = call.scene.triangles.instances
    triangles += 0 if instances is None else min(MOST_SHOWN, triangles * len(instances.number))
    long = LONG * max(view.width + view.height for view in call.views)
    kinds = sum(term.most(call) for term in FILM_TERMS)
    places = min(paths // LARGEST_SHARE, long * call.spp) + kinds * FEWEST
    return triangles * BYTES_OF_TRIANGLE + taken_by(call.stages, places * BYTES_OF_PLACE * (1 + len(call.views)))


def image_jumps(call: RenderCall, jumps: list[Jumps | None]) -> Tensor:
    """(B, 3, H, W) zeros with the derivatives of the image's discontinuities; `jumps`: the curves of each view."""
    def radiance(integrand: Integrand, start: Onward) -> tuple[Tensor, ...]:
        return tuple(trace(integrand, start.paths, hit=start.hit, flight=start.flight))

    return jumps_of_views(call, jumps, SeenByCamera((True,) * 3, radiance, is_radiance=True))


def jumps_of_views(call: RenderCall, jumps: list[Jumps | None], seen: SeenByCamera) -> Tensor:
    """(B, C, H, W) zeros with the derivatives of discontinuities in C channels; `jumps`: the curves of each view."""
    still = call.still()
    search = JumpSearch(call, still, seen, cache(still.facts), cache(partial(lamps_of, still)))
    return torch.stack([jumps_of_view(search, number, own) for number, own in enumerate(jumps)])


class JumpSearch(NamedTuple):
    """A call in which something moves, with what its views share in the search for discontinuities."""

    call: RenderCall  # attached
    still: RenderCall  # without derivatives
    seen: SeenByCamera
    facts: Callable[[], Facts]  # of the call, see `once`
    lamps: Callable[[], tuple[Eye, ...]]  # of the scene


def jumps_of_view(search: JumpSearch, number: int, jumps: Jumps | None) -> Tensor:
    """(C, H, W) zeros with the derivatives of discontinuities in view `number`; `jumps`: the curves of the view."""
    call, still, seen, facts, lamps = search
    viewed = cache(lambda: examined(still, number, lamps(), seen))

    def find() -> JumpPlaces | None:
        places = [] if jumps is None else _places_of(still, number, viewed(), jumps)
        standing = integrand_of(still, still.integrand.standing(), number)
        return strengths(still, standing, viewed(), joined(places), seen) if places else None

    with torch.no_grad():
        found = once(("jumps in view", number), lambda: (facts(), detached(jumps), seen.turns), find) \
            if seen.is_radiance else find()
    deposits = []
    if found is not None:
        geometry = geometry_of(call.scene)._replace(lines=jumps.lines)
        moved = moved_places(call.stages, geometry, call.views[number].camera, found, call.adjoint.taped)
        deposits = [Deposit(rows(found.places.film, found.shown), found.strength, moved)]
        if call.camera_share is not None and seen.is_radiance:
            deposits += lit_sides(call, still, number, viewed(), found)
    return image_of(call, number, deposits, len(seen.turns))


def examined(still: RenderCall, number: int, lamps: tuple[Eye, ...], seen: SeenByCamera) -> ExaminedView:
    """The detached view `number`, prepared for sampling its discontinuity curves; `lamps`: of the scene."""
    with torch.no_grad():
        view = still.views[number]
        stages, sight = still.stages, sight_of(view, lamps)
        prepared = stages(edge_weight).taken(geometry=geometry_of(still.scene), sight=sight)
        rims = any(seen.turns) and still.scene.triangles.vertices.n is not None
        return ExaminedView(stages, *prepared, sight.camera, rims, view.clips)


def _places_of(call: RenderCall, number: int, viewed: ExaminedView, jumps: Jumps) -> list[Places]:
    """Samples points on all discontinuity curves of view `number`."""
    found = [curves for term in FILM_TERMS for curves in term.in_view(viewed, jumps)]
    counts = place_counts([curves.length for curves in found], call, call.views[number])
    return [curves.places(count) for curves, count in zip(found, counts)]


class InView(NamedTuple):
    """Samples on a view's discontinuity curves, prepared for stages."""

    places: Places
    table: Places | Any  # the same, prepared for the stages
    kinds: tuple[int, ...]  # kinds of moving curves inside of triangles among them
    through_media: bool  # rays pass boundaries on their way there


def strengths(call: RenderCall, integrand: Integrand, viewed: ExaminedView, places: Places,
              seen: SeenByCamera) -> JumpPlaces | None:
    """The visible samples on curves, and the jump of the quantities at each; None: there are none.

    Args:
        call: without derivatives.
        integrand: for the view.
        viewed: the view.
        places: the samples.
        seen: the quantities.
    """
    counted = chosen(places.counts)
    if not len(counted):
        return None
    # Two paths each, and as few blocks as may be: all threads share the loops of one, and wait for each other's Python else.
    most = max(FEWEST, max(wavefront.lanes for wavefront in call.wavefronts) // 2)
    blocks = counted.split(max(FEWEST, -(-len(counted) // -(-len(counted) // most))))

    through_media = seen.is_radiance and call.scene.layout.traces_segments
    found = InView(places, *viewed.stages(in_sight).taken(places=places), _kinds_of(places), through_media)

    def work(share: Iterable[int]) -> list[tuple[Tensor, Tensor]]:
        return [differences(call, integrand, viewed, found, blocks[block], seen) for block in share]

    shares = in_turns(len(blocks), call.workers, work)
    parts = [shares[block % len(shares)][block // len(shares)] for block in range(len(blocks))]
    shown = torch.cat([own for own, _ in parts])
    if not len(shown):
        return None
    return JumpPlaces(places, shown, tuple(torch.cat([jump for _, jump in parts], 1)), found.kinds)


def _kinds_of(places: Places) -> tuple[int, ...]:
    """The kinds of curves that move over triangles, among some samples."""
    counts = dict(enumerate(torch.bincount(places.kind).tolist()))
    return tuple(kind for term in FILM_TERMS for kind in term.kinds if counts.get(kind))


def sides_in_sight(call: RenderCall, integrand: Integrand, viewed: ExaminedView, found: InView,
                   indices: Tensor) -> tuple[PathsBeside, Tensor, Tensor]:
    """The paths on both sides of visible samples, (2 K,); the indices of these among `indices`, (K,) int32; and the weights
    of all M samples. Args as for `differences`."""
    stages, geometry, sight = viewed[:3]
    table, kinds = found.table, found.kinds
    sent = torch.full((), len(indices), dtype=torch.int32, device=indices.device)
    lane = lanes(3 * len(indices), indices)
    sample = stages(rays_beside)(sight, table, indices, sent, lane, call.scene.layout.traces_cones,
                                found.through_media)
    rays = Sent(sample, first_hit(integrand, sample.ray, 0))
    if found.through_media:
        rays = Sent(sample, *free_flights(integrand, started(call, sample), rays.hit, 0))
    times = stages(in_sight)(geometry, table, indices, rays, sent, lane[:len(indices)], kinds)
    if found.through_media:
        times = times * ~integrand.part(Ends.SURROUNDINGS).call(on_boundary, table, indices)
    clear = chosen(times != 0)
    counts = sent, torch.full_like(sent, len(clear))
    start = stages(paths_beside)(table, indices, rays, times, clear, counts, lanes(2 * len(clear), indices))
    return start, clear, times


def lit_sides(call: RenderCall, still: RenderCall, number: int, viewed: ExaminedView, found: JumpPlaces) -> list[Deposit]:
    """The deposits at samples `found` for light that paths from lamps bring to either side; `still`: `call`, detached."""
    with torch.no_grad():
        integrand = integrand_of(still, still.integrand, number)
        table = viewed.stages(in_sight).taken(places=found.places)
        places = InView(found.places, *table, found.kinds, through_media=False)
        start, clear, times = sides_in_sight(still, integrand, viewed, places, found.shown)
        light = light_from_lamps(still, number, start.sample, start.hit) * rows(times, clear).repeat(2)
    places = rows(found.places, rows(found.shown, clear))
    return deposits_of_sides(call, number, places, start.hit, light)


def differences(call: RenderCall, integrand: Integrand, viewed: ExaminedView, found: InView, indices: Tensor,
                seen: SeenByCamera) -> tuple[Tensor, Tensor]:
    """The visible samples among `indices`, (K,) int32, and image values behind less ahead of the curves, (C, K) float64."""
    start, clear, times = sides_in_sight(call, integrand, viewed, found, indices)
    values = seen.evaluate(integrand, Onward(started(call, start.sample), None, start.hit, flight=start.flight))
    weight = start.sample.weight
    values = torch.stack([value if weight is None else value * weight for value in values]).double()
    behind, ahead = values.view(len(values), 2, -1).unbind(1)
    shown, jump = rows(indices, clear), (behind - ahead) * rows(times, clear)
    if all(seen.turns):
        return shown, jump
    turns = torch.tensor(seen.turns, device=jump.device)
    return shown, jump * (turns[:, None] | (rows(found.places.kind, shown) != RIM))
