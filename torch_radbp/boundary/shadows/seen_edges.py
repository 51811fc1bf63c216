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
BLOCK = 1 << 14  # pairs of points and edges that are examined together


class Eyes(NamedTuple):
    """M points that look at edges, or directions towards such; detached."""

    place: Vec3  # (M,) float64
    w: Tensor  # (M,) 1; 0: `place` is a direction towards the eye


class Pairing(NamedTuple):
    """Which edges each eye looks at: one of so many that follow each other, chosen at random; () each."""

    extent: Tensor  # of the scene, float64
    looks: Tensor  # int32, how many edges an eye looks at
    stride: Tensor  # int32, of how many each is one
    edges: Tensor  # int32, how many there are
    seed: Tensor  # int32

    def __call__(self, pair: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Edges and eyes of pairs, (N,) int32, and whether there is such an edge, (N,) bool."""
        eye = torch.div(pair, self.looks, rounding_mode="floor")
        edge = (pair - eye * self.looks) * self.stride + (hash32(eye + self.seed) & 0x7FFFFFFF) % self.stride
        return torch.minimum(edge, self.edges - 1), eye, edge < self.edges


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
    """The angles under which edges are seen that are silhouettes, 0 for others; (N,) float64.

    From a direction lengths across it are seen instead, as shares of the extent.

    Args:
        geometry: of the scene, detached.
        outline: its edges.
        eyes: look at them.
        pairing: of both.
        pair: (N,) int32, numbers of pairs.
    """
    edge, eye, exists = pairing(pair)
    eye = rows(eyes, eye)
    edges, instance = rows((outline.edges, outline.instance), edge)
    a, b, *opposite = in_world(geometry, (edges.a, edges.b, *edges.opposite), instance)
    from_a, from_b = (end * eye.w - eye.place for end in (a, b))
    apart, across = normalize(from_a) - normalize(from_b), cross(b - a, eye.place)
    seen = torch.where(eye.w > 0.0, torch.sqrt(dot(apart, apart)), torch.sqrt(dot(across, across)) / pairing.extent)
    return torch.where(exists & is_silhouette(a, b, opposite, from_a), seen, 0.0)


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
    edge, eye, _ = pairing(pair.to(torch.int32))
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
    times = times * pairing.stride
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
        examined: pairs of eyes and edges, at most, of more edges some at random for each eye.
    """
    size, extent = len(outline.crease), extent_of(geometry).clamp_min(TINY)
    stride = -(-size * len(weight) // examined)
    looks = -(-size // stride)
    pairing = Pairing(extent, *(torch.full((), number, dtype=torch.int32, device=extent.device)
                                for number in (looks, stride, size)), seed.seed)
    pairs = torch.arange(looks * len(weight), dtype=torch.int32, device=extent.device)
    seen = torch.cat([stages.angle_seen(geometry, outline, eyes, pairing, block) for block in pairs.split(BLOCK)])
    seen = (seen.view(-1, looks) * weight[:, None]).flatten()
    total = running_sum(seen)
    if not float(total[-1]) > 0.0:
        return None
    return stages.edge_passed(geometry, outline, eyes, lot_of(seen, count, total), seed, pairing,
                              torch.arange(count, dtype=torch.int32, device=extent.device))


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
