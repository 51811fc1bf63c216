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
FAR = 1e10  # the distance of what is a direction
BLOCK = 1 << 14  # pairs of points and edges that are examined together, by operations of torch
LOOKS = 128  # edges that an eye looks at, at most
EVEN = 0.2  # share of them that is drawn evenly, the others where some of the eyes have found something
SHARE_OF_PILOTS, FEWEST_PILOTS = 4, 8  # one pair of these for so many of all; and of eyes at least
SALT = 0x510E527F  # tells the random numbers by which they are drawn from others


class Eyes(NamedTuple):
    """M points that look at edges, or directions towards such; detached."""

    place: Vec3  # (M,) float64
    w: Tensor  # (M,) 1; 0: `place` is a direction towards the eye
    axis: Vec3  # (M,) of length l <= 1: directions at the cosine c from it count in proportion to 1 - l + l max(c, 0)
    behind: Tensor  # (M,) how much those count, instead of 0, in which c is negative; times -c


class Pairing(NamedTuple):
    """Which edges each eye looks at: pairs of both, those of an eye together."""

    extent: Tensor  # () of the scene, float64
    looks: Tensor  # () int32, how many edges an eye looks at
    edge: Tensor  # (P,) int32, of each pair
    times: Tensor  # (E,) float64, how many edges each stands for: 1 over how often an eye looks at it in the mean

    def __call__(self, pair: Tensor) -> tuple[Tensor, Tensor]:
        """Edges and eyes of pairs, (N,) int32."""
        return lookup(self.edge, pair), torch.div(pair, self.looks, rounding_mode="floor")


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


def angle_seen(geometry: Geometry, outline: Outline, eyes: Eyes, pairing: Pairing, pair: Tensor) -> Tensor:
    """The angles under which edges are seen that are silhouettes, 0 for others; times what counts of them; (N,) float64.

    From a direction lengths across it are seen instead, as shares of the extent.

    Args:
        geometry: of the scene, detached.
        outline: its edges.
        eyes: look at them.
        pairing: of both.
        pair: (N,) int32, numbers of pairs.
    """
    edge, eye = pairing(pair)
    eye = rows(eyes, eye)
    edges, instance = rows((outline.edges, outline.instance), edge)
    a, b, *opposite = in_world(geometry, (edges.a, edges.b, *edges.opposite), instance)
    from_a, from_b = (end * eye.w - eye.place for end in (a, b))
    to_a, to_b, across = normalize(from_a), normalize(from_b), cross(b - a, eye.place)
    apart = to_a - to_b
    # Between the ends of an edge no direction lies farther on either side than they do.
    faced = [torch.maximum(c, -eye.behind * c) for c in (dot(eye.axis, to_a), dot(eye.axis, to_b))]
    counts = 1.0 - torch.sqrt(dot(eye.axis, eye.axis)).clamp_max(1.0) + torch.maximum(*faced).clamp_min(0.0)
    seen = torch.where(eye.w > 0.0, torch.sqrt(dot(apart, apart)), torch.sqrt(dot(across, across)) / pairing.extent)
    return torch.where(is_silhouette(a, b, opposite, from_a), seen * counts * lookup(pairing.times, edge), 0.0)


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
    pair, along, times = picked(lot, place, fine_unit(random_bits(bounce_key(key, CAMERA_COUNTER), ALONG)))
    edge, eye = pairing(pair.to(torch.int32))
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
    times = times * lookup(pairing.times, edge)
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
        examined: pairs of eyes and edges, at most, by which is found where edges are that count.
    """
    def seen(eyes: Eyes, weight: Tensor, pairing: Pairing) -> Tensor:
        pairs = torch.arange(len(pairing.edge), dtype=torch.int32, device=weight.device)
        together = len(pairs) if hasattr(stages.angle_seen, "fused") else BLOCK
        found = torch.cat([stages.angle_seen(geometry, outline, eyes, pairing, block) for block in pairs.split(together)])
        return found.view(len(weight), -1) * weight[:, None]

    extent, size, own = extent_of(geometry).clamp_min(TINY), len(outline.crease), len(weight)
    if size <= LOOKS:
        pairing = paired(extent, torch.arange(size, device=extent.device).expand(own, size), extent.new_ones(size))
    else:
        pilots = max(LOOKS, examined // SHARE_OF_PILOTS)
        some = torch.arange(min(own, max(FEWEST_PILOTS, pilots // size)), device=extent.device)
        neighbours = -(-size * len(some) // pilots)  # of whom one is looked at
        first = torch.arange(0, size, neighbours, device=extent.device)
        edge = (first + (hash32(some.to(torch.int32) + seed.seed) & 0x7FFFFFFF)[:, None] % neighbours).clamp_max(size - 1)
        pilot = some * (own // len(some))
        importance = seen(rows(eyes, pilot), weight[pilot], paired(extent, edge, extent.new_ones(size))).sum(0)
        pairing = drawn(extent, importance.repeat_interleave(neighbours)[:size], own, seed)
    angles = seen(eyes, weight, pairing).flatten()
    total = running_sum(angles)
    if not float(total[-1]) > 0.0:
        return None
    return stages.edge_passed(geometry, outline, eyes, lot_of(angles, count, total), seed, pairing,
                              torch.arange(count, dtype=torch.int32, device=extent.device))


def eyes_at_most(outline: Outline, examined: int) -> int:
    """How many eyes can look at edges, if so many pairs are examined."""
    return examined // min(len(outline.crease), LOOKS)


def drawn(extent: Tensor, importance: Tensor, eyes: int, seed: SampleKey) -> Pairing:
    """`LOOKS` edges for each eye, by chance, at equal distances in a sum of how important they are; `importance`: (E,)."""
    share = EVEN / len(importance) + importance * ((1.0 - EVEN) / importance.sum().clamp_min(TINY))
    total = running_sum(share)
    start = numbers(seed, torch.arange(eyes, dtype=torch.int32, device=extent.device), SALT, extent.dtype)
    place = torch.arange(LOOKS, device=extent.device) + start[:, None]
    edge = torch.searchsorted(total, place * (total[-1] / LOOKS), right=True).clamp_max(len(share) - 1)
    return paired(extent, edge, total[-1] / (LOOKS * share))


def paired(extent: Tensor, edge: Tensor, times: Tensor) -> Pairing:
    """Each eye with edges, (M, looks)."""
    looks = torch.full((), edge.shape[1], dtype=torch.int32, device=extent.device)
    return Pairing(extent, looks, edge.to(torch.int32).flatten(), times)


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
