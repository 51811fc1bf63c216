"""Silhouettes as seen from points in the scene, and the surfaces beyond."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.curve.edge_order import GROUP, EdgeSlots
from torch_radbp.boundary.curve.geometry import Between, Geometry, in_world, positions
from torch_radbp.boundary.curve.outline import Outline
from torch_radbp.boundary.curve.places import key_of_places, picked
from torch_radbp.boundary.curve.silhouette import is_silhouette
from torch_radbp.boundary.eye.edge_tree import Descent, EdgeTree
from torch_radbp.boundary.eye.eyes import Eyes, how_much_counts, how_much_lobes_count
from torch_radbp.boundary.eye.ways_down import EdgeLot, PickedEdges, found_among, lot_of_found, ways_down
from torch_radbp.call.view import View
from torch_radbp.path.integrand import Integrand
from torch_radbp.raycast.protocol import Hit
from torch_radbp.sampling.sampler import (
    CAMERA_COUNTER,
    LaneKey,
    SampleKey,
    bounce_key,
    fine_unit,
    hash32,
    random_bits,
    uniform,
)
from torch_radbp.scene.tables.scene_tensors import extent_of
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.stage import Stages, stage
from torch_radbp.tensors.vec import TINY, Ray, Vec2, Vec3, angle_between, cross, crossing, dot, normalize, rows
from torch_radbp.tensors.vector_jacobian import vector_jacobian_product, zeros_unless

BESIDE = 2e-5  # share of the scene's extent by which rays pass edges
BEFORE = 1e-3  # share of its length by which a ray ends before what it aims at
FAR = 1e10  # the distance of what is a direction


class Casting(NamedTuple):
    """The edges of a scene that may cast shadows, and a tree by which viewpoints sample those they see; detached."""

    outline: Outline
    tree: EdgeTree  # over its edges


class Passed(NamedTuple):
    """N samples on edges as viewpoints see them, with the rays right past the edges; float64 but for integers."""

    edge: Tensor  # int32
    eye: Tensor  # int32, viewpoint
    along: Tensor  # position along the edge, from a to b
    times: Tensor  # weight: edges that a sample stands for, divided by their selection probability
    p: Vec3  # the sampled point
    outwards: Vec3  # unit, across the edge and the line of sight, to the background
    back: Ray  # from right beside the edge to the viewpoint
    onwards: Ray  # and away from it
    distance: Tensor  # of the viewpoint, slightly shortened
    key: LaneKey  # of random numbers


def angle_seen(geometry: Geometry, outline: Outline, edge: Tensor, eye: Eyes, extent: Tensor) -> Tensor:
    """The angles that silhouettes subtend, times the weight of their directions; 0 for other edges; (N,) float64.

    From a viewpoint at infinity it is the length across the direction, as a share of the extent.

    Args:
        geometry: of the scene, detached.
        outline: its edges.
        edge: (N,) int32, indices of edges; -1: none.
        eye: (N,) the viewpoints.
        extent: () of the scene.
    """
    edges, instance = rows((outline.edges, outline.instance), edge.clamp_min(0))
    return angle_of_edge(geometry, EdgeSlots(edge, (edges.a, edges.b, *edges.opposite), instance), eye, extent)


def angle_of_edge(geometry: Geometry, slot: EdgeSlots, eye: Eyes, extent: Tensor) -> Tensor:
    """The angles that silhouettes among the edges `slot`, (N,), subtend, times the weight of directions, as `angle_seen`."""
    a, b, *opposite = in_world(geometry, slot.vertices, slot.instance)
    silhouette = is_silhouette(a, b, opposite, a * eye.w - eye.place)
    return torch.where((slot.edge >= 0) & silhouette, angle_of(a, b, eye, extent), 0.0)


def angle_of(a: Vec3, b: Vec3, eye: Eyes, extent: Tensor) -> Tensor:
    """The angles that segments from a to b subtend from viewpoints, times the weight of directions, (N,); `angle_seen` has
    them for silhouettes alone."""
    from_a, from_b = (end * eye.w - eye.place for end in (a, b))
    to_a, to_b, across = normalize(from_a), normalize(from_b), cross(b - a, eye.place)
    apart = to_a - to_b
    # Between the ends of an edge no direction lies farther on either side than they do.
    counts = torch.maximum(how_much_counts(eye, to_a), how_much_counts(eye, to_b))
    if eye.lobes:
        counts = counts * how_much_lobes_count(eye, normalize(to_a + to_b), 0.25 * dot(apart, apart))
    return counts * torch.where(eye.w > 0.0, torch.sqrt(dot(apart, apart)), torch.sqrt(dot(across, across)) / extent)


@stage("geometry", "slots", "eyes")
def edge_found(geometry: Geometry, slots: EdgeSlots, eyes: Eyes, at: Descent, extent: Tensor) -> PickedEdges:
    """Samples a silhouette below each descent's last node of the tree, in proportion to their angles.

    Args:
        geometry, extent: as for `angle_seen`.
        slots: the edges in the order of the tree.
        eyes: the viewpoints.
        at: (N,) descents at the last nodes.
    """
    own, first = rows(eyes, at.eye), at.node * GROUP
    angles = [angle_of_edge(geometry, rows(slots, first + place), own, extent) for place in range(GROUP)]
    return found_among(slots.edge, at, first, angles)


@stage("geometry", "outline", "eyes", "found")
def edge_passed(geometry: Geometry, outline: Outline, eyes: Eyes, found: EdgeLot, seed: SampleKey, extent: Tensor,
                place: Tensor) -> Passed:
    """Samples points on the silhouette edges that viewpoints have selected, with the rays past these.

    Args:
        geometry, outline, extent: as for `angle_seen`.
        eyes: the viewpoints.
        found: the selected edges.
        seed: of the random numbers.
        place: (N,) int32, the numbers of the samples.
    """
    key, aim, turn = numbers_of_places(seed, place)
    number, _, times = picked(found.lot, place, aim)
    (edge, repeated, _), eye = rows((found.found, found.eye), number)
    times, own = times * repeated, rows(eyes, eye)
    edges, instance, share, parts = rows((outline.edges, outline.instance, outline.share, outline.parts), edge.clamp_min(0))
    a, b, *opposite = in_world(geometry, (edges.a, edges.b, *edges.opposite), instance)
    along, times, p = place_between(a, b, own, turn, times)
    times = times if parts is None else times * parts.weight(along)
    sight = normalize(p * own.w - own.place)
    across = normalize(cross(b - a, sight))
    inside = [dot(tip - a, across) for tip in opposite[:2]]
    deeper = torch.where(inside[0].abs() > inside[-1].abs(), inside[0], inside[-1])
    outwards = across * torch.where(deeper > 0.0, -1.0, 1.0)
    times = times if share is None else times / share
    return passed_at(own, Passed(edge, eye, along, times, p, outwards, None, None, None, key), extent,
                     geometry.triangles.n.x.dtype)


def numbers_of_places(seed: SampleKey, place: Tensor) -> tuple[LaneKey, Tensor, Tensor]:
    """The random numbers of samples `place`, (N,) int32: keys, one to select edges, one for the position along these."""
    key = key_of_places(seed, place)
    numbers = bounce_key(key, CAMERA_COUNTER)
    return key, fine_unit(random_bits(numbers, 1)), fine_unit(random_bits(numbers, 0))


def place_between(a: Vec3, b: Vec3, eye: Eyes, turn: Tensor, times: Tensor) -> tuple[Tensor, Tensor, Vec3]:
    """Points of segments at a fraction `turn` of the subtended angle: position along, weight, and point; (N,) each."""
    along, density = evenly_seen(a * eye.w - eye.place, b * eye.w - eye.place, turn)
    along, times = torch.where(eye.w > 0.0, along, turn), torch.where(eye.w > 0.0, times / density, times)
    return along, times, a + (b - a) * along


def passed_at(own: Eyes, place: Passed, extent: Tensor, dtype: torch.dtype) -> Passed:
    """The samples with the rays that pass right beside their edges; `own`: (N,) the viewpoints, `dtype`: of rays."""
    start = place.p + place.outwards * (BESIDE * extent)
    away = start * own.w - own.place
    length = torch.sqrt(dot(away, away)).clamp_min(TINY)
    o, d = (part.map(lambda c: c.to(dtype)) for part in (start, away * (1.0 / length)))
    distance = torch.where(own.w > 0.0, length * (1.0 - BEFORE), FAR).to(dtype)
    return place._replace(back=Ray(o, -d), onwards=Ray(o, d), distance=distance)


def evenly_seen(a: Vec3, b: Vec3, turn: Tensor) -> tuple[Tensor, Tensor]:
    """Positions on segments from a to b at a fraction of the angle seen from the origin, and their density for uniform
    fractions.

    Args:
        a, b: (N,) float64, the ends relative to the origin.
        turn: (N,) in [0, 1), fractions of the angle between them.
    """
    (to_a, near_a), (to_b, near_b) = ((end * torch.rsqrt(squared), torch.sqrt(squared))
                                      for end in (a, b) for squared in [dot(end, end).clamp_min(TINY)])
    angle, normal = angle_between(to_a, to_b), cross(a, b)
    start, end = near_b * torch.sin((1.0 - turn) * angle), near_a * torch.sin(turn * angle)
    known = (start + end > 0.0) & (dot(normal, normal) > 0.0)
    along = end / torch.where(known, start + end, 1.0)
    p = a + (b - a) * along
    density = torch.sqrt(dot(normal, normal)) / (dot(p, p) * angle).clamp_min(TINY)
    return torch.where(known, along, turn), torch.where(known, density, 1.0)


def density_seen(a: Vec3, b: Vec3, along: Tensor) -> Tensor:
    """The densities of positions along segments that are sampled evenly in the angle seen from the origin, (N,)."""
    p, normal = a + (b - a) * along, cross(a, b)
    angle, squared = angle_between(normalize(a), normalize(b)), dot(normal, normal)
    return torch.where(squared > 0.0, torch.sqrt(squared) / (dot(p, p) * angle).clamp_min(TINY), 1.0)


def places_seen(stages: Stages, geometry: Geometry, casting: Casting, eyes: Eyes, seed: SampleKey, each: int, count: int,
                tried: Tensor | None = None) -> Passed | None:
    """Samples points on silhouettes as viewpoints see them, in proportion to the angle; None: there are none.

    Args:
        stages: runs the stages.
        geometry: of the scene, detached.
        casting: the edges, and their tree.
        eyes: the viewpoints.
        seed: of the random numbers.
        each: the number of descents of the tree per viewpoint.
        count: the greatest number of samples; there are at most as many as descents that found an edge.
        tried: (M,) bool, pilot viewpoints, whose samples have separate random numbers and do not depend on others; they
            come first. None: there are none.
    """
    outline, tree = casting
    extent = extent_of(geometry)
    at = ways_down(stages, tree, eyes, seed, each, extent, tried)
    found = stages(edge_found)(geometry, outline.slots, eyes, at, extent)
    count = min(count, int(torch.count_nonzero(found.times)))
    return places_on(stages, geometry, outline, eyes, seed, lot_of_found(found, at.eye, each, count, tried))


def places_on(stages: Stages, geometry: Geometry, outline: Outline, eyes: Eyes, seed: SampleKey,
              found: tuple[EdgeLot, Tensor] | None) -> Passed | None:
    """Samples points on the edges that viewpoints have found; None: there are none. `found`: from `lot_of_found`; other args
    as for `places_seen`."""
    if found is None:
        return None
    return stages(edge_passed)(geometry, outline, eyes, found[0], seed, extent_of(geometry), found[1])


def salted(view: View, salt: int) -> SampleKey:
    """The key of a view's random numbers for derivatives, changed by a salt."""
    key = view.sample_keys[1]
    return SampleKey(hash32(key.seed ^ salt), key.shared)


def uniform_numbers(key: SampleKey, lane: Tensor, counter: Tensor | int, dtype: torch.dtype) -> Tensor:
    """One uniform random number in [0, 1) for each lane, (N,) int32."""
    return uniform(bounce_key(LaneKey(hash32(lane + key.seed), torch.zeros_like(lane)), counter), 0, dtype)


def unhidden(integrand: Integrand, passed: Passed) -> Tensor:
    """The indices of samples on edges that nothing hides from their viewpoints, (K,) int64."""
    return (~integrand.caster.occluded(passed.back, passed.distance)).nonzero().squeeze(1)


def point_of_edge(geometry: Geometry, outline: Outline, edge: Tensor, along: Tensor) -> Vec3:
    """The positions of points on edges, (N,) world, attached; float64.

    Args:
        geometry: attached.
        outline: the edges.
        edge: (N,) int32, indices of edges.
        along: (N,) positions as shares of the edges' lengths.
    """
    a, b = in_world(geometry, rows((outline.edges.a, outline.edges.b), edge), rows(outline.instance, edge))
    return a + (b - a) * along


def corners_of(geometry: Geometry, hit: Hit) -> tuple[Vec3, Vec3, Vec3]:
    """The corner positions of hit triangles in the world, attached; float64. For a miss, those of any triangle."""
    return positions(geometry, Between(*lookup(geometry.triangles.corners, hit.prim.clamp_min(0))), hit.instance)


def crossed_at(corners: tuple[Vec3, Vec3, Vec3], line: Ray) -> Vec2:
    """The barycentric coordinates at which lines, (N,), cross the planes of triangles; attached."""
    volume, of_u, of_v = crossing(line, corners[0], corners[1] - corners[0], corners[2] - corners[0])
    volume = torch.where(volume != 0.0, volume, 1.0)
    return Vec2(of_u / volume, of_v / volume)


class Course(NamedTuple):
    """Positions and normals of borders at N samples, in two coordinates, and the areas swept; detached, float64."""

    at: Vec2
    normal: Vec2  # across the border; its length is that of the piece per sample; 0 where unknown
    aside: Vec2  # towards points right beside it
    sweep: Tensor  # what the border sweeps if points move there


def course_of(seen: Callable[..., Vec2], times: Tensor, off: Vec3) -> Course:
    """The positions and normals of borders at samples, and the areas that they sweep, from a function of their points.

    Args:
        seen: returns positions for args `step` and `off`, as of `border.border`.
        times: (N,) the number of edges for which each sample stands.
        off: (N,) from edges to points beside them.
    """
    (at, along), beside = pace(seen, times), seen(off=off)
    normal, aside = finite_normal(along, times), Vec2(beside.x - at.x, beside.y - at.y)
    return Course(at, normal, aside, aside.x * normal.x + aside.y * normal.y)


def finite_normal(along: Vec2, times: Tensor) -> Vec2:
    """The normals of curves, as long as the piece that each sample stands for; 0 where that is not finite; (N,) each.

    Args:
        along: (N,) the derivative of positions along edges, from `pace`.
        times: (N,) the number of edges for which each sample stands.
    """
    normal = Vec2(-along.y * times, along.x * times)
    counts = torch.isfinite(normal.x) & torch.isfinite(normal.y)
    return normal.map(lambda c: torch.where(counts, c, 0.0))


def pace(seen: Callable[[Tensor], Vec2], like: Tensor) -> tuple[Vec2, Vec2]:
    """The positions of samples, in two coordinates, and their derivative along the edges; (N,) each, detached.

    Args:
        seen: returns the positions for (N,) steps along the edges, as shares of their lengths.
        like: (N,) float64, a template for the steps.
    """
    def velocity(coordinate: int) -> tuple[Tensor, Tensor]:
        with torch.enable_grad():
            step = (0.0 * like).requires_grad_()
            place = seen(step)[coordinate]
            found, = vector_jacobian_product([place], [step], [torch.ones_like(step)])
        return place.detach(), zeros_unless(found, step).detach()

    (x, across), (y, down) = velocity(0), velocity(1)
    return Vec2(x, y), Vec2(across, down)
