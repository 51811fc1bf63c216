"""What the jumps of an image add to its derivative: the boundary term of primary visibility.

Where the radiance L jumps along a curve of the film, and the curve moves by v, a pixel that counts points of the film by h
changes by

    dI = integral of h (L_behind - L_ahead) v . n dl

along the curve, whose normal n points ahead. Places on the edges of the outline, and on the curves inside of triangles that
`contour.py` finds, are sampled, L is estimated on either side by a path through a point close by, and v follows the attached
vertices and the attached camera. The place on an edge stays where it is on the edge: sliding along it changes nothing.

The result is an image of zeros with that derivative, backward and forward.

Reference: Li, Aittala, Durand and Lehtinen 2018, "Differentiable Monte Carlo Ray Tracing through Edge Sampling", section 4.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.contour import LEVELS, level_at, places_on_contours
from torch_radbp.boundary.edge_places import places_on_edges
from torch_radbp.boundary.outline import Jumps
from torch_radbp.boundary.places import (
    CREASE,
    FAR,
    NEAR,
    RIM,
    SILHOUETTE,
    Glued,
    Places,
    apart_at,
    beside,
    camera_sample,
)
from torch_radbp.differentiated import any_differentiated, primal
from torch_radbp.path.bounce import CameraSample
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.state import PathState
from torch_radbp.path.wavefront import first_hit, trace
from torch_radbp.raycast.protocol import Hit
from torch_radbp.record import joined
from torch_radbp.rendering.call.render_call import RenderCall, integrand_of, started
from torch_radbp.rendering.call.workers import in_turns
from torch_radbp.scene.interaction import is_in_front
from torch_radbp.vec import TINY, dot, rows

NEARER = 1e-3  # share of the distance to an edge by which a surface that hides it is nearer, and one behind it farther
SAME = 1e-5  # the same of surfaces that are one at a rim
ALONG_EDGE = 1e-3  # barycentric coordinate below which a rim runs along an edge, and may lie on the hidden side of it
GRAZING = 2e-2  # the same of a surface that turns away at a silhouette: its depth changes with the root of what it is off
USUAL = 3e-5  # share of the distance to a place, by which rays miss it, up to which this is so
MOST = 0.5  # all at most, where coordinates are large and rays lie farther off
BLOCK = 1 << 15  # places that are traced together

Evaluate = Callable[[Integrand, PathState, Hit], tuple[Tensor, ...]]


class Seen(NamedTuple):
    """What camera paths see that may jump."""

    turns: tuple[bool, ...]  # for each channel, whether it differs between the two sides of a surface
    evaluate: Evaluate  # gives the channels, detached


def moves(call: RenderCall) -> bool:
    """True if a vertex, a shading normal, an instance or a camera has derivatives."""
    vertices, instances = call.scene.triangles.vertices, call.scene.triangles.instances
    return any_differentiated((vertices.p, vertices.n, instances and (instances.linear, instances.origin),
                               [view.camera.lens for view in call.views]))


def image_jumps(call: RenderCall, jumps: list[Jumps | None]) -> Tensor:
    """(B, 3, H, W) zeros whose derivative is what jumps contribute to the image; `jumps`: of each view."""
    def radiance(integrand: Integrand, start: PathState, hit: Hit) -> tuple[Tensor, ...]:
        return tuple(trace(integrand, start, hit=hit))

    return jumps_of_views(call, jumps, Seen((True,) * 3, radiance))


def jumps_of_views(call: RenderCall, jumps: list[Jumps | None], seen: Seen) -> Tensor:
    """(B, C, H, W) zeros with the derivative of jumps in C channels."""
    return torch.stack([jumps_of_view(call, number, own, seen) for number, own in enumerate(jumps)])


def jumps_of_view(call: RenderCall, number: int, jumps: Jumps | None, seen: Seen) -> Tensor:
    """(C, H, W) of view `number`; the rest as for `jumps_of_views`."""
    view, channels = call.views[number], len(seen.turns)
    image = torch.zeros(channels, view.height * view.width, dtype=call.scene.dtype, device=call.scene.device)
    shape = channels, view.height, view.width
    with torch.no_grad():
        still = call.still()
        places = [] if jumps is None else places_of(still, number, jumps, any(seen.turns))
        found = strengths(still, number, joined(places), seen) if places else None
    if found is None:
        return image.view(shape)
    places, pixel, counts, strength = found
    amount = (strength * motion(call, number, places))[:, :, None] * counts
    return image.index_add(1, pixel.flatten(), amount.flatten(1).to(image.dtype)).view(shape)


def places_of(call: RenderCall, number: int, jumps: Jumps, rims: bool) -> list[Places]:
    """Places on all curves at which view `number` may jump; `rims`: those of shading normals are among them."""
    found = [] if jumps.outline is None else [places_on_edges(call, number, jumps.outline)]
    return found + ([] if jumps.faces is None else places_on_contours(call, number, jumps.faces, rims))


def motion(call: RenderCall, number: int, places: Places) -> Tensor:
    """(N,) zeros, attached: the areas of the film that pieces of curves sweep, pixels."""
    view, film = call.views[number], call.views[number].camera.film
    seen = view.camera.kind.project(view.camera.lens, places.at(call.scene), places.aperture)
    swept = ((seen.x - primal(seen.x)) * film.size_x * places.normal.x
             + (seen.y - primal(seen.y)) * film.size_y * places.normal.y)
    for kind in LEVELS:
        own = (places.kind == kind).nonzero().squeeze(1)
        if len(own):
            level = level_at(call.scene, view, rows(places, own), kind)
            swept = swept.index_add(0, own, places.drift[own] * (level - primal(level)))
    return swept


def strengths(call: RenderCall, number: int, places: Places, seen: Seen) -> tuple[Places, Tensor, Tensor, Tensor] | None:
    """What the places of which the camera sees the jump add to pixels, for each pixel that the curve moves along its normal.

    Returns:
        These K places; the pixels around each, row-major, and what it counts in them, (K, P); and (C, K) the differences of
        what is seen behind and ahead of the curve; None: no place counts.
    """
    pixel, counts = call.views[number].camera.film.around(places.film)
    counted = (counts != 0).any(1).nonzero().squeeze(1)
    if not len(counted):
        return None
    blocks = counted.split(min(BLOCK, -(-len(counted) // call.workers)))

    def work(share: Iterable[int]) -> list[tuple[Tensor, Tensor]]:
        return [differences(call, number, rows(places, blocks[block]), seen) for block in share]

    shares = in_turns(len(blocks), call.workers, work)
    parts = [shares[block % len(shares)][block // len(shares)] for block in range(len(blocks))]
    kept = torch.cat([block[own] for block, (own, _) in zip(blocks, parts)])
    if not len(kept):
        return None
    return rows(places, kept), pixel[kept], counts[kept], torch.cat([jump for _, jump in parts], 1)


def differences(call: RenderCall, number: int, places: Places, seen: Seen) -> tuple[Tensor, Tensor]:
    """The places that nothing hides, (K,), and what is seen behind less what is seen ahead of the curve, (C, K) float64."""
    view = call.views[number]
    integrand = integrand_of(call, call.make_integrand(call.scene), call.chunks[0]._replace(sensor=number))
    there, *sides = (camera_sample(call, view, film, places.aperture, places.key)
                     for film in (places.film, *beside(view, places)))
    straight, *hits = (first_hit(integrand, sample.ray, 0) for sample in (there, *sides))
    times = in_sight(integrand, places, (there, *sides), (straight, *hits))
    shown = times.nonzero().squeeze(1)
    values = []
    for side, hit, glued, own in zip(sides, hits, (places.behind, places.ahead), of_curve(places, times)):
        side = rows(side, shown)
        hit = rows(on_curve(places, there, glued, own, hit), shown)
        found = seen.evaluate(integrand, started(call, side), hit)
        values.append(torch.stack([value if side.weight is None else value * side.weight for value in found]).double())
    jump = (values[0] - values[1]) * times[shown]
    turns = torch.tensor(seen.turns, device=jump.device)
    return shown, jump * (turns[:, None] | (places.kind[shown] != RIM))


def in_sight(integrand: Integrand, places: Places, samples: tuple[CameraSample, ...], hits: tuple[Hit, ...]) -> Tensor:
    """(N,) 1 for places that nothing hides, by what the rays to them, behind and ahead of them hit; 0 for others; or -1.

    A ray to a place on a curve meets a triangle there, or passes by. Where an outline turns back and forth within less than
    rounding, it does not tell which of the pieces it meets, of which only one has a jump. Pieces that run back are known by
    their surface, which lies on the other side. They count as -1, so that one remains. Where coordinates are so large that
    rays miss places by more than `USUAL`, it does not tell triangles apart either, and what rays on either side meet counts.
    """
    distances = [dot(places.p - sample.ray.o, sample.ray.d) for sample in samples]
    off = [missed(places, distance).clamp_min(1.0) for distance in distances]
    near = [(NEARER * times).clamp_max(MOST) for times in off]
    shown = [past(hit, distance * (1.0 - share)) for hit, distance, share in zip(hits, distances, near)]
    here = [clear & ~past(hit, distance * (1.0 + share))
            for clear, hit, distance, share in zip(shown, hits, distances, near)]
    reach = [distance * (GRAZING * torch.sqrt(times)).clamp_max(MOST) + places.depth
             for distance, times in zip(distances, off)]
    turning = [past(hit, distance - most) & ~past(hit, distance + most)
               for hit, distance, most in zip(hits, distances, reach)]
    blurred = off[0] > 1.0
    own = [is_one_of(places, hit) & ~blurred for hit in hits]
    kind, ahead = places.kind, places.side > 0
    ends = ((kind == SILHOUETTE) | (kind == FAR)) & (own[0] | shown[0] | blurred)
    seen = ends & torch.where(ahead, shown[1] & turning[2], shown[2] & turning[1])
    turned = ends & ~seen & torch.where(ahead, shown[2] & turning[1], shown[1] & turning[2])
    seen |= (kind == CREASE) & (here[1] & here[2] | own[0]) | (kind == NEAR)
    seen |= (kind == RIM) & ~blurred & rim_in_sight(places, own, hits[0], distances[0])
    if bool((blurred & (kind == RIM)).any()):
        fronts = [is_in_front(integrand.scene, sample.ray, hit) for sample, hit in zip(samples[1:], hits[1:])]
        # Beyond a narrow band of the other side there is none: the silhouette has the whole jump.
        jumps = blurred & (kind == RIM) & turning[1] & turning[2] & (fronts[0] != fronts[1])
        seen |= jumps & (fronts[1] == ahead)
        turned |= jumps & (fronts[1] != ahead)
    return (seen.double() - turned.double()) * ((places.normal.x != 0) | (places.normal.y != 0))


def missed(places: Places, distance: Tensor) -> Tensor:
    """(N,) how far off places rays lie, in units of what is usual; `distance` (N,) of the places."""
    return apart_at(places, distance) / (USUAL * distance.clamp_min(TINY))


def rim_in_sight(places: Places, own: list[Tensor], hit: Hit, distance: Tensor) -> Tensor:
    """(N,) bool: nothing hides the places, if they are on rims.

    Args:
        own: of the rays to them, behind and ahead of them, whether they meet the triangle of the rim.
        hit, distance: of the ray to them, and how far they are.
    """
    inside = torch.minimum(torch.minimum(places.u, places.v), 1.0 - places.u - places.v) > ALONG_EDGE
    nearby, clear = own[1] | own[2], past(hit, distance * (1.0 - SAME))
    return (own[0] | clear & ~past(hit, distance * (1.0 + SAME))) & (inside | nearby) | clear & nearby


def is_one_of(places: Places, hit: Hit) -> Tensor:
    """(N,) bool: a triangle at the place was hit."""
    found = (hit.prim >= 0) & ((hit.prim == places.behind.prim) | (hit.prim == places.ahead.prim))
    return found if places.instance is None else found & (hit.instance == places.instance)


def of_curve(places: Places, times: Tensor) -> tuple[Tensor, Tensor]:
    """(N,) bool each: behind and ahead of a curve lies the surface that it is on, by what `in_sight` says."""
    both, outline = (places.kind == RIM) | (places.kind == CREASE), places.kind == SILHOUETTE
    ahead = (places.side > 0) == (times > 0)
    return both | outline & ~ahead, both | outline & ahead


def on_curve(places: Places, sample: CameraSample, glued: Glued, own: Tensor, hit: Hit) -> Hit:
    """What a ray beside a curve hits, but the place on the curve itself where it is known and on its `own` surface.

    Beside it another curve may lie, or the surface may end: what jumps there is counted there.
    """
    distance = dot(places.p - sample.ray.o, sample.ray.d)
    own = own & (glued.prim >= 0) & (missed(places, distance) <= 1.0)
    place = Hit(glued.prim, glued.u, glued.v, distance, places.instance)
    return Hit(*(None if there is None else torch.where(own, here.to(there.dtype), there)
                 for here, there in zip(place, hit)))


def past(hit: Hit, distance: Tensor) -> Tensor:
    """True where nothing is hit up to some distance, (N,) bool."""
    return (hit.prim < 0) | (hit.t > distance)


