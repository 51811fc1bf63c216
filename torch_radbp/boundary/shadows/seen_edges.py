"""Silhouettes as seen from points in the scene, and what lies beyond them."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.adjoint.bounce import vector_jacobian_product, zeros_unless
from torch_radbp.boundary.geometry import Between, Geometry, in_world, positions
from torch_radbp.boundary.outline import Outline
from torch_radbp.boundary.places import ALONG, NEIGHBOURS, Lot, lot_of, picked
from torch_radbp.boundary.shadows.pairing import Pairing, pairing_of
from torch_radbp.boundary.silhouette import is_silhouette
from torch_radbp.lookup import lookup
from torch_radbp.path.integrand import Integrand, Stages
from torch_radbp.raycast.protocol import Hit
from torch_radbp.rendering.call.view import View
from torch_radbp.sampling.running_sum import running_sum
from torch_radbp.sampling.sampler import (
    CAMERA_COUNTER,
    LaneKey,
    SampleKey,
    bounce_key,
    fine_unit,
    hash32,
    lane_key,
    random_bits,
    uniform,
)
from torch_radbp.vec import TINY, Ray, Vec2, Vec3, cross, crossing, dot, normalize, rows

BESIDE = 2e-5  # share of the scene's extent by which rays pass edges
BEFORE = 1e-3  # share of its length by which a ray ends before what it aims at
COPLANAR = 1e-9  # a cosine; what lies in the plane of an eye's surface hides nothing from it
FAR = 1e10  # the distance of what is a direction
BLOCK = 1 << 14  # pairs of points and edges that are examined together, by operations of torch
PAIR = 1  # the random number that picks a pair, beside `ALONG`


class Eyes(NamedTuple):
    """M points that look at edges, or directions towards such; detached."""

    place: Vec3  # (M,) float64
    w: Tensor  # (M,) 1; 0: `place` is a direction towards the eye
    n: Vec3  # (M,) unit normal of the surface that it lies on, 0: on none; directions count by their cosines,
    behind: Tensor  # (M,) behind the surface so many times less,
    even: Tensor  # (M,) and so much, whatever the cosine, but along the surface


class Passed(NamedTuple):
    """N places on edges as eyes see them, float64 but for integers."""

    edge: Tensor  # int32
    eye: Tensor  # int32
    along: Tensor  # share of the way from the edge's a to b
    times: Tensor  # how many edges, over their probability to be looked at, a place stands for
    p: Vec3  # the place
    outwards: Vec3  # unit, across the edge and the line of sight, to where something lies beyond
    back: Ray  # from right beside the edge to the eye
    onwards: Ray  # and away from it
    distance: Tensor  # of the eye, but for a little
    key: LaneKey  # of random numbers


def angle_seen(geometry: Geometry, outline: Outline, eyes: Eyes, weight: Tensor, pairing: Pairing, pair: Tensor) -> Tensor:
    """The angles under which edges are seen that are silhouettes, 0 for others; times what counts of them; (N,) float64.

    From a direction lengths across it are seen instead, as shares of the extent.

    Args:
        geometry: of the scene, detached.
        outline: its edges.
        eyes: look at them.
        weight: (M,) float64, how much each eye counts.
        pairing: of both.
        pair: (N,) int32, numbers of pairs.
    """
    edge, eye, exists, times = pairing(pair)
    eye, times = rows(eyes, eye), times * lookup(weight, eye)
    edges, instance = rows((outline.edges, outline.instance), edge)
    a, b, *opposite = in_world(geometry, (edges.a, edges.b, *edges.opposite), instance)
    from_a, from_b = (end * eye.w - eye.place for end in (a, b))
    to_a, to_b, across = normalize(from_a), normalize(from_b), cross(b - a, eye.place)
    apart = to_a - to_b
    # Between the ends of an edge no direction lies farther on either side than they do.
    faced = torch.maximum(*(torch.maximum(c, -eye.behind * c) for c in (dot(eye.n, to_a), dot(eye.n, to_b))))
    counts = torch.where(faced > COPLANAR, faced + eye.even, torch.where(dot(eye.n, eye.n) > 0.0, 0.0, 1.0))
    seen = torch.where(eye.w > 0.0, torch.sqrt(dot(apart, apart)), torch.sqrt(dot(across, across)) / pairing.extent)
    return torch.where(exists & is_silhouette(a, b, opposite, from_a), seen * counts * times, 0.0)


def edge_passed(geometry: Geometry, outline: Outline, eyes: Eyes, lot: Lot, seed: SampleKey,
                pairing: Pairing, place: Tensor) -> Passed:
    """Places on edges that are silhouettes, in proportion to the angles under which they are seen.

    Args:
        geometry, outline, eyes, pairing: as for `angle_seen`.
        lot: of the pairs.
        seed: of the random numbers.
        place: (N,) int32, numbers of the places.
    """
    key = lane_key(seed, torch.div(place, NEIGHBOURS, rounding_mode="floor"), place % NEIGHBOURS)
    numbers_of_place = bounce_key(key, CAMERA_COUNTER)
    pair, _, times = picked(lot, place, fine_unit(random_bits(numbers_of_place, PAIR)))
    along = fine_unit(random_bits(numbers_of_place, ALONG))  # what is left of the other is no longer well spread
    edge, eye, _, repeated = pairing(pair.to(torch.int32))
    edges, instance, share = rows((outline.edges, outline.instance, outline.share), edge)
    a, b, *opposite = in_world(geometry, (edges.a, edges.b, *edges.opposite), instance)
    own = rows(eyes, eye)
    p = a + (b - a) * along
    sight = normalize(p * own.w - own.place)
    across = normalize(cross(b - a, sight))
    inside = [dot(tip - a, across) for tip in opposite[:2]]
    deeper = torch.where(inside[0].abs() > inside[-1].abs(), inside[0], inside[-1])
    outwards = across * torch.where(deeper > 0.0, -1.0, 1.0)
    start = p + outwards * (BESIDE * pairing.extent)
    away = start * own.w - own.place
    length = torch.sqrt(dot(away, away)).clamp_min(TINY)
    d, dtype = away * (1.0 / length), geometry.triangles.n.x.dtype
    o, d = (part.map(lambda c: c.to(dtype)) for part in (start, d))
    distance = torch.where(own.w > 0.0, length * (1.0 - BEFORE), FAR).to(dtype)
    times = times * repeated
    return Passed(edge, eye, along, times if share is None else times / share, p, outwards, Ray(o, -d), Ray(o, d), distance,
                  key)


def places_seen(stages: Stages, geometry: Geometry, outline: Outline, eyes: Eyes, weight: Tensor, seed: SampleKey,
                count: int, examined: int) -> Passed | None:
    """So many places on edges that eyes see as silhouettes; None: they see none.

    Args:
        stages: of the call.
        geometry, outline, eyes: as for `angle_seen`.
        weight: (M,) float64, how much each eye counts.
        seed: of the random numbers.
        count: how many.
        examined: pairs of eyes and edges, about.
    """
    pairing = pairing_of(extent_of(geometry), outline.body, len(weight), seed, examined)
    pairs = torch.arange(len(pairing.body), dtype=torch.int32, device=weight.device)
    together = len(pairs) if hasattr(stages.angle_seen, "fused") else BLOCK
    angles = torch.cat([stages.angle_seen(geometry, outline, eyes, weight, pairing, block)
                        for block in pairs.split(together)])
    total = running_sum(angles)
    if not float(total[-1]) > 0.0:
        return None
    return stages.edge_passed(geometry, outline, eyes, lot_of(angles, count, total), seed, pairing,
                              torch.arange(count, dtype=torch.int32, device=weight.device))


def salted(view: View, salt: int) -> SampleKey:
    """Of random numbers of a view's derivative that have a salt of their own."""
    key = view.sample_keys[1]
    return SampleKey(hash32(key.seed ^ salt), key.shared)


def numbers(key: SampleKey, lane: Tensor, counter: int, dtype: torch.dtype) -> Tensor:
    """A uniform number in [0, 1) for each of some lanes, (N,) int32."""
    return uniform(bounce_key(LaneKey(hash32(lane + key.seed), torch.zeros_like(lane)), counter), 0, dtype)


def extent_of(geometry: Geometry) -> Tensor:
    """() float64, the longest side of the box around the vertices."""
    return torch.stack([part.max() - part.min() for part in geometry.triangles.vertices.p]).amax().double()


def beyond(integrand: Integrand, passed: Passed) -> tuple[Hit, Tensor]:
    """What lies beyond edges, right beside them, (N,); and (N,) bool, whether nothing hides the edges from the eyes."""
    free = ~integrand.caster.occluded(passed.back, passed.distance)
    return integrand.caster.intersect(passed.onwards), free


def point_of_edge(geometry: Geometry, outline: Outline, edge: Tensor, along: Tensor) -> Vec3:
    """Points of edges, (N,) world, attached; float64.

    Args:
        geometry: attached.
        outline: the edges.
        edge: (N,) int32, which.
        along: (N,) shares of the way from one end to the other.
    """
    a, b = in_world(geometry, rows((outline.edges.a, outline.edges.b), edge), rows(outline.instance, edge))
    return a + (b - a) * along


def corners_of(geometry: Geometry, hit: Hit) -> tuple[Vec3, Vec3, Vec3]:
    """The corners of the triangles that are hit, in the world, attached; float64. Of any where nothing is hit."""
    return positions(geometry, Between(*lookup(geometry.triangles.corners, hit.prim.clamp_min(0))), hit.instance)


def crossed_at(corners: tuple[Vec3, Vec3, Vec3], line: Ray) -> Vec2:
    """Where lines, (N,), meet the planes of triangles, barycentric coordinates there; attached."""
    volume, of_u, of_v = crossing(line, corners[0], corners[1] - corners[0], corners[2] - corners[0])
    volume = torch.where(volume != 0.0, volume, 1.0)
    return Vec2(of_u / volume, of_v / volume)


def pace(seen: Callable[[Tensor], Vec2], like: Tensor) -> tuple[Vec2, Vec2]:
    """Where places are that follow from the way along edges, and how fast they move along; (N,) each, detached.

    Args:
        seen: gives them, of (N,) steps from where they are, shares of the edges' lengths.
        like: (N,) float64.
    """
    def velocity(coordinate: int) -> tuple[Tensor, Tensor]:
        with torch.enable_grad():
            step = torch.zeros_like(like).requires_grad_()
            place = seen(step)[coordinate]
            found, = vector_jacobian_product([place], [step], [torch.ones_like(step)])
        return place.detach(), zeros_unless(found, step).detach()

    (x, across), (y, down) = velocity(0), velocity(1)
    return Vec2(x, y), Vec2(across, down)
