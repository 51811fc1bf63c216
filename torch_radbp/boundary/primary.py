"""What the jumps of an image add to its derivative: the boundary term of primary visibility.

Where the radiance L jumps along a curve of the film, and the curve moves by v, a pixel that counts points of the film by h
changes by

    dI = integral of h (L_behind - L_ahead) v . n dl

along the curve, whose normal n points ahead. Places on the edges of the outline are sampled, L is estimated on either side
by a path through a point close by, and v follows the attached ends of the edge and the attached camera. The place on an edge
stays where it is on the edge: sliding along it changes nothing.

The result is an image of zeros with that derivative, backward and forward.

Reference: Li, Aittala, Durand and Lehtinen 2018, "Differentiable Monte Carlo Ray Tracing through Edge Sampling", section 4.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from torch_radbp.adjoint.function import RenderCall, integrand_of, started
from torch_radbp.adjoint.workers import in_turns
from torch_radbp.boundary.outline import Outline
from torch_radbp.boundary.places import FILM_U, FILM_V, Places, beside, camera_sample, places_in_view
from torch_radbp.differentiated import any_differentiated, detached, primal
from torch_radbp.integrand import Integrand
from torch_radbp.path_state import PathState
from torch_radbp.raycast.protocol import Hit
from torch_radbp.sampling.sampler import CAMERA_COUNTER, bounce_key, fine_unit, random_bits
from torch_radbp.vec import dot, rows
from torch_radbp.wavefront import first_hit, trace

NEARER = 1e-3  # share of the distance to an edge by which a surface that hides it is nearer, and one behind it farther
GRAZING = 2e-2  # the same of a surface that turns away at a silhouette: its depth changes with the root of what it is off
BLOCK = 1 << 15  # places that are traced together

Evaluate = Callable[[Integrand, PathState, Hit], tuple[Tensor, ...]]


def moves(call: RenderCall) -> bool:
    """True if a vertex, an instance or a camera has derivatives."""
    instances = call.scene.triangles.instances
    return any_differentiated((call.scene.triangles.vertices.p, instances and (instances.linear, instances.origin),
                               [view.camera.lens for view in call.views]))


def image_jumps(call: RenderCall, outlines: list[Outline | None]) -> Tensor:
    """(B, 3, H, W) zeros whose derivative is what jumps contribute to the image; `outlines`: of each view."""
    def radiance(integrand: Integrand, start: PathState, hit: Hit) -> tuple[Tensor, ...]:
        return tuple(trace(integrand, start, hit=hit))

    return jumps_of_views(call, outlines, 3, radiance)


def jumps_of_views(call: RenderCall, outlines: list[Outline | None], channels: int, evaluate: Evaluate) -> Tensor:
    """(B, C, H, W) zeros with the derivative of jumps in C channels, which `evaluate` gives for camera paths, detached."""
    return torch.stack([jumps_of_view(call, number, outline, channels, evaluate)
                        for number, outline in enumerate(outlines)])


def jumps_of_view(call: RenderCall, number: int, outline: Outline | None, channels: int, evaluate: Evaluate) -> Tensor:
    """(C, H, W) of view `number`; the rest as for `jumps_of_views`."""
    view = call.views[number]
    image = torch.zeros(channels, view.height * view.width, dtype=call.scene.dtype, device=call.scene.device)
    shape = channels, view.height, view.width
    if outline is None:
        return image.view(shape)
    with torch.no_grad():
        still = call._replace(scene=detached(call.scene), views=[detached(view) for view in call.views])
        places = places_in_view(still, number, outline)
        found = strengths(still, number, places, channels, evaluate)
    if found is None:
        return image.view(shape)
    kept, pixel, strength = found
    places = rows(places, kept)
    film = view.camera.film
    a, b = (outline.vertices(call.scene, index[places.edge]).map(torch.Tensor.double)
            for index in (outline.edges.a, outline.edges.b))
    seen = view.camera.kind.project(view.camera.lens, a + (b - a) * places.along, places.aperture)
    moved = ((seen.x - primal(seen.x)) * film.size_x * places.normal.x
             + (seen.y - primal(seen.y)) * film.size_y * places.normal.y)
    return image.index_add(1, pixel, (strength * moved).to(image.dtype)).view(shape)


def strengths(call: RenderCall, number: int, places: Places, channels: int,
              evaluate: Evaluate) -> tuple[Tensor, Tensor, Tensor] | None:
    """What the places of which the camera sees the jump add to pixels, for each pixel that the edge moves along its normal.

    Returns:
        The places, (K,), their pixels, (K,), row-major, and (C, K) the differences of what is seen behind and ahead of the
        edge, times what the place counts in the pixel; None: no place counts.
    """
    view = call.views[number]
    numbers = bounce_key(places.key, CAMERA_COUNTER)
    u, v = (fine_unit(random_bits(numbers, dimension)) for dimension in (FILM_U, FILM_V))
    column, row, counts = view.camera.film.receiver(places.film, u, v)
    counted = (counts != 0).nonzero().squeeze(1)
    if not len(counted):
        return None
    blocks = counted.split(min(BLOCK, -(-len(counted) // call.workers)))

    def work(share: range) -> list[tuple[Tensor, Tensor]]:
        return [differences(call, number, rows(places, blocks[block]), evaluate) for block in share]

    shares = in_turns(len(blocks), call.workers, work)
    parts = [shares[block % len(shares)][block // len(shares)] for block in range(len(blocks))]
    kept = torch.cat([block[own] for block, (own, _) in zip(blocks, parts)])
    if not len(kept):
        return None
    return kept, (row * view.width + column)[kept], torch.cat([jump for _, jump in parts], 1) * counts[kept]


def differences(call: RenderCall, number: int, places: Places, evaluate: Evaluate) -> tuple[Tensor, Tensor]:
    """The places that nothing hides, (K,), and what is seen behind less what is seen ahead of the edge, (C, K) float64."""
    view = call.views[number]
    integrand = integrand_of(call, call.make_integrand(call.scene), call.chunks[0]._replace(sensor=number))
    sides = [camera_sample(call, view, film, places.aperture, places.key) for film in beside(view, places)]
    hits = [first_hit(integrand, side.ray, 0) for side in sides]
    distances = [dot(places.p - side.ray.o, side.ray.d) for side in sides]
    shown = [past(hit, distance * (1.0 - NEARER)) for hit, distance in zip(hits, distances)]
    here = [shown[side] & ~past(hits[side], distances[side] * (1.0 + NEARER)) for side in (0, 1)]
    turning = [past(hit, distance * (1.0 - GRAZING)) & ~past(hit, distance * (1.0 + GRAZING))
               for hit, distance in zip(hits, distances)]
    ends = (shown[0] & turning[1]) | (shown[1] & turning[0])
    seen = torch.where(places.silhouette, ends, here[0] & here[1])
    seen = (seen & ((places.normal.x != 0) | (places.normal.y != 0))).nonzero().squeeze(1)
    values = []
    for side, hit in zip(sides, hits):
        side = rows(side, seen)
        found = evaluate(integrand, started(call, side), rows(hit, seen))
        values.append(torch.stack([value if side.weight is None else value * side.weight for value in found]).double())
    return seen, values[0] - values[1]


def past(hit: Hit, distance: Tensor) -> Tensor:
    """True where nothing is hit up to some distance, (N,) bool."""
    return (hit.prim < 0) | (hit.t > distance)


