"""Visibility of discontinuity curves, by rays to and beside their samples, and the paths that start there."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.curve.geometry import Between, Geometry, largest_coordinate, positions
from torch_radbp.boundary.curve.intersections import TOUCHING
from torch_radbp.boundary.curve.places import CREASE, FAR, NEAR, RIM, SILHOUETTE, TEXTURE, Glued, Places, apart_at
from torch_radbp.path.camera_rays import CameraSample
from torch_radbp.path.state import Flight
from torch_radbp.raycast.protocol import Hit
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.stage import stage
from torch_radbp.tensors.vec import TINY, Ray, Vec3, dot, rows, unit_normal
from torch_radbp.vertex.interaction import is_boundary, is_in_front

NEARER = 1e-3  # share of the distance to an edge from which on what is nearer hides it surely; what is less, by its plane
SAME = 1e-5  # the same of surfaces that are one at a rim
ALONG_EDGE = 1e-3  # barycentric coordinate below which a rim runs along an edge, and may lie on the hidden side of it
GRAZING = 2e-2  # the same of a surface that turns away at a silhouette: its depth changes with the root of what it is off
USUAL = 3e-5  # share of the distance to a place, by which rays miss it, up to which this is so
MOST = 0.5  # all at most, where coordinates are large and rays lie farther off


class Sent(NamedTuple):
    """Rays to K samples on curves, to points behind and to points ahead of them, concatenated, with their hits; (3 K,)."""

    sample: CameraSample
    hit: Hit
    flight: Flight | None = None  # through media up to there; see `Arrival`

    def of(self, way: int, count: Tensor, lane: Tensor) -> tuple[Ray, Hit]:
        """The rays to samples (`way` 0), behind (1) or ahead (2) of curves, with hits; of `count` samples those in
        `lane`."""
        return rows((self.sample.ray, self.hit), lane + count * way)


@stage("geometry", "places", "sent")
def in_sight(geometry: Geometry, places: Places, chosen: Tensor, sent: Sent, count: Tensor, lane: Tensor,
             kinds: tuple[int, ...]) -> Tensor:
    """(K,) float64 weights of samples on curves: 1 if visible, 0 if hidden, -1 on pieces that run back.

    A ray to a sample hits a triangle there, or passes by. Where an outline turns back and forth within rounding, the ray
    does not tell which piece it hits, of which only one has a jump. Pieces that run back have their surface on the other
    side; they count as -1, so that the sum is one. Where coordinates are so large that rays miss samples by more than
    `USUAL`, rays do not tell triangles apart either, and the hits on either side decide. What hides a sample just inside of
    another body is known by the plane of the triangle that the ray hits.

    Args:
        geometry: of the scene, detached.
        places: the samples, of which some are used.
        chosen: (K,) int32, the indices of the samples to use.
        sent: the rays to these.
        count: () int32, K.
        lane: (K,) int32, 0, 1, ..., K - 1.
        kinds: the kinds of curves that may be among the samples.
    """
    places = rows(places, chosen)
    rays, hits = zip(*(sent.of(way, count, lane) for way in range(3)))
    distances = [dot(places.p - ray.o, ray.d) for ray in rays]
    off = [missed(places, distance).clamp_min(1.0) for distance in distances]
    near = [(NEARER * times).clamp_max(MOST) for times in off]
    covered = [hides(geometry, ray, hit, places.p) for ray, hit in zip(rays, hits)]
    shown = [past(hit, distance * (1.0 - share)) & ~hidden
             for hit, distance, share, hidden in zip(hits, distances, near, covered)]
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
    jumps_ahead, jumps_behind = shown[1] & turning[2], shown[2] & turning[1]
    seen = ends & ((ahead & jumps_ahead) | (~ahead & jumps_behind))
    turned = ends & ~seen & ((ahead & jumps_behind) | (~ahead & jumps_ahead))
    seen = seen | (_goes_on(kind) & ((here[1] & here[2]) | own[0])) | (kind == NEAR)
    if RIM in kinds:
        seen = seen | ((kind == RIM) & ~blurred & rim_in_sight(places, own, hits[0], distances[0]) & ~covered[0])
        behind, before = (is_in_front(geometry, ray, hit) for ray, hit in zip(rays[1:], hits[1:]))
        # Beyond a narrow band of the other side there is none: the silhouette has the whole jump.
        jumps = blurred & (kind == RIM) & turning[1] & turning[2] & (behind ^ before)
        seen = seen | (jumps & ~(before ^ ahead))
        turned = turned | (jumps & (before ^ ahead))
    runs = (places.normal.x != 0) | (places.normal.y != 0)
    return torch.where(runs & seen, 1.0, torch.where(runs & turned, -1.0, torch.zeros_like(places.u)))


@stage("scene", "places")
def on_boundary(scene: SceneTensors, places: Places, chosen: Tensor) -> Tensor:
    """(K,) bool: samples at invisible boundaries of media, where light does not jump, but paths have other random numbers.
    Args as for `in_sight`; `scene`: any part of it, detached."""
    places = rows(places, chosen)
    return is_boundary(scene, places.behind.prim) | is_boundary(scene, places.ahead.prim)


class PathsBeside(NamedTuple):
    """Camera paths that start beside curves: K behind them, then K ahead of them; (2 K,)."""

    sample: CameraSample
    hit: Hit
    flight: Flight | None  # as of `Sent`


@stage("places", "chosen", "sent", "times", "shown")
def paths_beside(places: Places, chosen: Tensor, sent: Sent, times: Tensor, shown: Tensor, counts: tuple[Tensor, Tensor],
                 lane: Tensor) -> PathsBeside:
    """The camera paths that start right behind and right ahead of visible samples.

    A ray beside a curve may hit another curve, or pass a surface that ends there, which is counted elsewhere. So where the
    surface of the curve is known, the path begins at the sample itself; its flight through media is that of the first of
    the three rays that hit that surface.

    Args:
        places, chosen, sent: as for `in_sight`; (M,) chosen.
        times: (M,) the weights from `in_sight`.
        shown: (K,) int32, the indices of those of nonzero weight.
        counts: () int32 each, M and K.
        lane: (2 K,) int32, 0, 1, ..., 2 K - 1.
    """
    sent_to, count = counts
    is_ahead = lane >= count
    number = rows(shown, torch.where(is_ahead, lane - count, lane))
    own, times = rows(places, rows(chosen, number)), rows(times, number)
    beside = number + torch.where(is_ahead, 2 * sent_to, sent_to)
    sample, hit = rows((sent.sample, sent.hit), beside)
    both, outline = (own.kind == RIM) | _goes_on(own.kind), own.kind == SILHOUETTE
    lies_ahead = ~((own.side > 0) ^ (times > 0))
    glued = Glued(*(torch.where(is_ahead, there, here) for here, there in zip(own.behind, own.ahead)))
    straight = rows(sent.sample.ray, number)
    distance = dot(own.p - straight.o, straight.d)
    known = (both | (outline & ~(lies_ahead ^ is_ahead))) & (glued.prim >= 0) & (missed(own, distance) <= 1.0)
    place = Hit(glued.prim, glued.u, glued.v, distance, own.instance)
    hit = Hit(*(None if there is None else torch.where(known, here.to(there.dtype), there)
                for here, there in zip(place, hit)))
    if sent.flight is None:
        return PathsBeside(sample, hit, None)
    other = number + torch.where(is_ahead, sent_to, 2 * sent_to)
    return PathsBeside(sample, hit, rows(sent.flight, came_by(own, sent, known, (beside, number, other))))


def came_by(places: Places, sent: Sent, known: Tensor, rays: tuple[Tensor, ...]) -> Tensor:
    """(N,) int32, the ray whose flight through media each path takes: where it begins at the sample itself, the first ray
    that hit a triangle of the sample, else the first of all.

    Args:
        places: (N,) the samples.
        known: (N,) bool: paths begin at the samples themselves.
        rays: (N,) int32 each, indices of rays in `sent`.
    """
    found = rays[0]
    for ray in reversed(rays):
        found = torch.where(known & is_one_of(places, rows(sent.hit, ray)), ray, found)
    return found


def _goes_on(kind: Tensor) -> Tensor:
    """True for kinds of curves on both sides of which the same surface, or one that touches it, is seen; (N,) bool."""
    return (kind == CREASE) | (kind >= TEXTURE)


def missed(places: Places, distance: Tensor) -> Tensor:
    """(N,) the distance by which rounding may let rays miss samples, in units of the usual error of float32.

    Args:
        places: the samples.
        distance: (N,) their distances from the rays' origins.
    """
    return apart_at(places.p, distance) / (USUAL * distance.clamp_min(TINY))


def rim_in_sight(places: Places, own: list[Tensor], hit: Hit, distance: Tensor) -> Tensor:
    """(N,) bool: samples on rims that are visible.

    Args:
        own: for the rays to them, behind and ahead of them, whether they hit the triangle of the rim.
        hit, distance: of the ray to them, and their distance.
    """
    inside = torch.minimum(torch.minimum(places.u, places.v), 1.0 - places.u - places.v) > ALONG_EDGE
    nearby, clear = own[1] | own[2], past(hit, distance * (1.0 - SAME))
    return ((own[0] | (clear & ~past(hit, distance * (1.0 + SAME)))) & (inside | nearby)) | (clear & nearby)


def is_one_of(places: Places, hit: Hit) -> Tensor:
    """(N,) bool: rays that hit one of the two triangles at the sample."""
    found = (hit.prim >= 0) & ((hit.prim == places.behind.prim) | (hit.prim == places.ahead.prim))
    return found if places.instance is None else found & (hit.instance == places.instance)


def hides(geometry: Geometry, ray: Ray, hit: Hit, p: Vec3) -> Tensor:
    """(N,) bool: the plane of the hit triangle lies between the ray's origin and a point beside the ray, beyond rounding.

    The lengths of rays do not tell this: right beside a point they hit steep surfaces sooner or later than at the point,
    and the more so the farther the viewer.

    Args:
        geometry: of the scene, detached.
        ray, hit: (N,) the rays, and what they hit.
        p: (N,) world, float64, right beside the rays.
    """
    corners = positions(geometry, Between(*lookup(geometry.triangles.corners, hit.prim.clamp_min(0))), hit.instance)
    normal = unit_normal(corners[1] - corners[0], corners[2] - corners[0])
    height, of_viewer = dot(normal, p - corners[0]), dot(normal, ray.o.map(torch.Tensor.double) - corners[0])
    return (hit.prim >= 0) & (height * torch.sign(of_viewer) < -TOUCHING * largest_coordinate(p, *corners))


def past(hit: Hit, distance: Tensor) -> Tensor:
    """(N,) bool: rays that hit nothing closer than a given distance."""
    return (hit.prim < 0) | (hit.t > distance)
