"""The curves that scans cross, as level functions: edges, rims, intersections of surfaces, shadow borders.

The level is 0 on the curve. At a fixed point of the film it changes with what the path follows there, mirrors, glass and the
camera, and with the surfaces that are seen.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.curve.geometry import Between, Corners, Geometry, geometry_of, positions, vertex_normals
from torch_radbp.boundary.eye import differences
from torch_radbp.boundary.eye.deposit import attached_geometry
from torch_radbp.boundary.eye.ideal_paths import to_light
from torch_radbp.boundary.eye.ideal_steps import LIT
from torch_radbp.boundary.eye.light_points import light_line
from torch_radbp.boundary.eye.seen_edges import crossed_at
from torch_radbp.boundary.eye.surfaces import LineTable, level_of_line
from torch_radbp.boundary.terms.crossings import Crossings
from torch_radbp.boundary.terms.scans import Searched
from torch_radbp.path.direct_light import LightDraw
from torch_radbp.path.lanes import put_rows
from torch_radbp.raycast.protocol import Hit
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.record import leaves_of, with_leaves
from torch_radbp.tensors.stage import Stages, stage
from torch_radbp.tensors.vec import TINY, Ray, Vec3, cross, dot, interpolated, rows, where

EDGE, RIM, MEETING, LINE, HORIZON, SHADOW = range(6)
OFF = 4.0  # times the distance of the two rays, by which an edge may lie off them
WALK = 32  # triangles of a smooth surface among whose sides its outline is searched
ROUNDED = 2e-5  # the same as a share of the distance, for the rounding of what rays meet


class TriangleSide(NamedTuple):
    """A side of a triangle for each lane, (K,)."""

    prim: Tensor  # int32, the triangle
    instance: Tensor | None  # int32
    corner: Tensor  # int64, the opposite corner


class Curves(NamedTuple):
    """K discontinuity curves that scans of the film have crossed."""

    kind: Tensor  # (K,) int64
    edge: TriangleSide  # of an edge; of a shadow border the casting edge; or the triangle of a rim, horizon or texture line
    other: Tensor  # (K,) int32, intersecting triangle, or receiver of the shadow
    shown_by: Tensor | None  # (K,) int32, its instance
    line: Tensor  # (K,) int64, texture line: row of the table of lines
    number: Tensor  # (K,) float64, integer of that line


def curves_crossed(searched: Searched, crossed: Crossings) -> tuple[Curves, Tensor]:
    """Identifies the curves at crossings, of edges the nearest to the rays; and (K,) bool: this was possible."""
    scene, lines = searched.call.scene, searched.surfaces.lines
    geometry, hit, beyond = geometry_of(scene), crossed.below.hit, crossed.above.hit
    rays = [_in_double(met.ray) for met in (crossed.below, crossed.above)]
    side, is_edge = nearest_side(searched.call.stages, geometry, searched.surfaces.smooth.continues,
                                 *sides_of_curves(searched, crossed, rays))
    meets = (hit.prim >= 0) & (beyond.prim >= 0) & _inside(_corners_of(geometry, beyond.prim, beyond.instance), rays[0]) & (
        _inside(_corners_of(geometry, hit.prim, hit.instance), rays[1]))
    kind = torch.where(meets, MEETING, EDGE)
    for how, curve in ((differences.RIM, RIM), (differences.TEXTURE, LINE), (differences.HORIZON, HORIZON),
                       (differences.SHADOW, SHADOW)):
        kind = torch.where(crossed.kind == how, curve, kind)
    own = (kind != EDGE) & (kind != SHADOW)
    known = (own | is_edge) & ((kind != RIM) | (geometry.triangles.vertices.n is not None))
    side = TriangleSide(torch.where(own, hit.prim, side.prim),
                        None if hit.instance is None else torch.where(own, hit.instance, side.instance), side.corner)
    other, shown_by = torch.where(kind == SHADOW, hit.prim, beyond.prim), beyond.instance
    if shown_by is not None:
        shown_by = torch.where(kind == SHADOW, hit.instance, shown_by)
    line, number = torch.zeros_like(kind), torch.zeros_like(crossed.times)
    for slot, (one, another) in enumerate(zip(crossed.below.cells, crossed.above.cells)):
        passed = one != another
        line = torch.where(passed, lines.row(hit.prim, slot), line)
        number = torch.where(passed, torch.maximum(one, another), number)
    return Curves(kind, side, other, shown_by, line, number), known


class SeenSide(NamedTuple):
    """A side of a triangle for each lane, (K,), and how two neighbouring rays pass it."""

    side: TriangleSide
    near: Tensor  # bool: it may pass between the two
    hides: Tensor  # bool: and behind it the surface ends, or turns away
    between: Tensor  # bool: and it is seen between the two
    off: Tensor  # float64, its distance from the first ray
    beside: Tensor  # int32, the next triangle across it if the surface goes on there, else -1


def nearest_side(stages: Stages, geometry: Geometry, continues: Tensor, rays: list[Ray],
                 hits: list[Hit]) -> tuple[TriangleSide, Tensor]:
    """Of a hit triangle's sides the nearest to two neighbouring rays, and (K,) bool: it may pass between them.

    A side across which a surface continues hides nothing, unless it lies between the two hits. Where a smooth surface turns
    away, its outline may be at a triangle beside the one that is hit; if it is not found, a side of the nearer triangle is
    taken.

    Args:
        stages: compiled or not.
        continues: as of `SmoothParts`.
        rays, hits: the two neighbouring rays, and what they hit.
    """
    seen, nearer = stages(side_between)(geometry, continues, *rays, *hits)
    left = (~seen.between).nonzero().squeeze(1)
    if len(left):
        walk = rows(SideWalk(seen, *rays, *nearer), left)
        step = stages(walked).knowing(geometry, continues)
        for _ in range(WALK):
            walk = step(geometry, continues, walk)
            if not (walk.prim >= 0).any():
                break
        put_rows(seen, left.int(), walk.best)
    return seen.side, seen.near


class NearerTriangle(NamedTuple):
    """The triangle that the nearer of two neighbouring rays hits, for each lane, (K,)."""

    misses: Ray  # the other ray
    prim: Tensor  # int32, the triangle; -1: none
    instance: Tensor | None
    beyond: Tensor  # int32, what the other ray hits


class SideWalk(NamedTuple):
    """A walk over the triangles of smooth surfaces, away from where a ray hits them, (K,)."""

    best: SeenSide  # of all sides so far
    one: Ray
    other: Ray
    misses: Ray  # the ray towards which it goes
    prim: Tensor  # int32, the triangle where it is; -1: it has ended
    instance: Tensor | None
    beyond: Tensor  # int32, the triangle behind


@stage("geometry", "continues")
def side_between(geometry: Geometry, continues: Tensor, ray: Ray, other_ray: Ray, one: Hit,
                 other: Hit) -> tuple[SeenSide, NearerTriangle]:
    """The nearest side of the two triangles that neighbouring rays hit, and which of these is nearer."""
    first_hides, sides = (one.prim >= 0) & ((other.prim < 0) | (one.t <= other.t)), []
    for hit, beyond, nearer in ((one, other, first_hides), (other, one, ~first_hides)):
        sides += [side._replace(near=side.near & (nearer | side.hides))
                  for side in _sides_of(geometry, continues, [ray, other_ray], hit.prim, hit.instance, beyond.prim)]
    prim, beyond = torch.where(first_hides, one.prim, other.prim), torch.where(first_hides, other.prim, one.prim)
    instance = None if one.instance is None else torch.where(first_hides, one.instance, other.instance)
    misses = Ray(*(where(first_hides, *parts) for parts in zip(other_ray, ray)))
    return nearest_of(sides), NearerTriangle(misses, prim, instance, beyond)


@stage("geometry", "continues")
def walked(geometry: Geometry, continues: Tensor, walk: SideWalk) -> SideWalk:
    """One step of a walk over triangles: across the side nearest to the ray that misses, if the surface goes on there."""
    around = _sides_of(geometry, continues, [walk.one, walk.other], walk.prim, walk.instance, walk.beyond)
    best, beside = nearest_of([walk.best, *around]), torch.full_like(walk.prim, -1)
    nearest = torch.full_like(walk.best.off, torch.inf)
    for side in around:
        away = torch.where(side.beside >= 0, distance_to_side(walk.misses, *_ends_of(geometry, side.side))[0], torch.inf)
        beside, nearest = torch.where(away < nearest, side.beside, beside), torch.minimum(away, nearest)
    return walk._replace(best=best, prim=torch.where(best.between, -1, beside))


def _sides_of(geometry: Geometry, continues: Tensor, rays: list[Ray], prim: Tensor, instance: Tensor | None,
              beyond: Tensor) -> list[SeenSide]:
    """The sides of triangles `prim`, -1: none; `beyond`: the triangles that the other ray hits."""
    own, met, seen = _corners_of(geometry, prim, instance), prim >= 0, []
    for number in range(3):
        a, b = own[(number + 1) % 3], own[(number + 2) % 3]
        beside, way = lookup(continues, 3 * prim.clamp_min(0).long() + number), a - rays[0].o
        next_one = _corners_of(geometry, beside, instance)
        goes_on = met & (beside >= 0) & (beside != beyond) & (
            dot(_normal_of(own), way) * dot(_normal_of(next_one), way) > 0)
        off, reach = distance_to_side(rays[0], a, b)
        near = met & passes_near(rays, off, reach)
        side, hides = TriangleSide(prim, instance, torch.full_like(prim, number, dtype=torch.int64)), near & ~goes_on
        seen.append(SeenSide(side, near, hides, hides & seen_between(rays, a, b), off, torch.where(goes_on, beside, -1)))
    return seen


def nearest_of(sides: list[SeenSide]) -> SeenSide:
    """The nearest side that is seen between the two rays; else one that hides something; else one that is close to them."""
    best = sides[0]
    for side in sides[1:]:
        rank, best_rank = (own.near.int() + own.hides.int() + own.between.int() for own in (side, best))
        better = (rank > best_rank) | (rank == best_rank) & (side.off < best.off)
        best = with_leaves(best, [None if new is None else torch.where(better, new, old)
                                  for new, old in zip(leaves_of(side), leaves_of(best))])
    return best


def passes_near(rays: list[Ray], off: Tensor, reach: Tensor) -> Tensor:
    """(N,) bool: something at the distance `off` from the first of two neighbouring rays, `reach` from its origin, may lie
    between the two."""
    apart = rays[1].o + rays[1].d * reach - rays[0].o - rays[0].d * reach
    return off <= OFF * torch.sqrt(dot(apart, apart)) + ROUNDED * reach


def seen_between(rays: list[Ray], a: Vec3, b: Vec3) -> Tensor:
    """(N,) bool: segments from a to b that pass between two neighbouring rays."""
    (level, share), (other_level, other_share) = [_passed_at(ray, a, b) for ray in rays]
    change = level - other_level
    share = share + (other_share - share) * (level / torch.where(change != 0, change, 1.0))
    return (level * other_level <= 0) & (share >= 0) & (share <= 1)


def _passed_at(ray: Ray, a: Vec3, b: Vec3) -> tuple[Tensor, Tensor]:
    """The side on which rays pass the lines from a to b, by its sign, and the position along these as a share of b - a."""
    w, e = a - ray.o, b - a
    across = e - ray.d * dot(e, ray.d)
    return dot(cross(e, ray.d), w), -dot(w, across) / dot(across, across).clamp_min(TINY)


def sides_of_curves(searched: Searched, crossed: Crossings, rays: list[Ray]) -> tuple[list[Ray], list[Hit]]:
    """Rays on both sides of crossed curves, and what they hit; for shadow borders these are shadow rays.

    Args:
        searched, crossed: as for `curves_crossed`.
        rays: the camera paths' rays on either side, float64.
    """
    shadows = (crossed.kind == differences.SHADOW).nonzero().squeeze(1)
    hits = [crossed.below.hit, crossed.above.hit]
    if not len(shadows):
        return rays, hits
    sides, draw = rows(((crossed.below, crossed.above), crossed.looks.draw), shadows)
    found = []
    for beside, met in zip(zip(rays, hits), sides):
        way = to_light(searched.integrand, met, draw)
        hit = searched.integrand.caster.intersect(way.ray)
        hit = hit._replace(prim=torch.where((hit.t < way.length) & ((met.what & LIT) == 0), hit.prim, -1))
        found.append(with_leaves(beside, [None if old is None else old.index_copy(0, shadows, new) for old, new in zip(
            leaves_of(beside), leaves_of((_in_double(way.ray), hit)))]))
    rays, hits = zip(*found)
    return list(rays), list(hits)


def _in_double(ray: Ray) -> Ray:
    """Converts rays to float64."""
    return Ray(*(part.map(torch.Tensor.double) for part in ray))


def _corners_of(geometry: Geometry, prim: Tensor, instance: Tensor | None) -> Corners:
    """The corner positions of triangles, (N,) int32, in the world, attached; float64. For -1, those of any triangle."""
    return positions(geometry, _between(geometry, prim), instance)


def _normal_of(corners: Corners) -> Vec3:
    """The normals of triangles, of any length."""
    return cross(corners[1] - corners[0], corners[2] - corners[0])


def _between(geometry: Geometry, prim: Tensor) -> Between:
    """The three vertices of triangles, as rows of the vertex table."""
    return Between(*lookup(geometry.triangles.corners, prim.clamp_min(0)))


def distance_to_side(ray: Ray, a: Vec3, b: Vec3) -> tuple[Tensor, Tensor]:
    """The distances of segments from a to b from rays, (N,), and where along the rays these are."""
    w, e = a - ray.o, b - a
    w_along, e_along = dot(w, ray.d), dot(e, ray.d)
    w, e = w - ray.d * w_along, e - ray.d * e_along
    at = (-dot(w, e) / dot(e, e).clamp_min(TINY)).clamp(0.0, 1.0)
    off = w + e * at
    reach = w_along + e_along * at
    return torch.where(reach > 0, torch.sqrt(dot(off, off)), torch.inf), reach


def _inside(corners: Corners, ray: Ray) -> Tensor:
    """(N,) bool: rays that cross the inside of triangles."""
    u, v = crossed_at(corners, ray)
    return (u > 0) & (v > 0) & (u + v < 1)


def level(scene: SceneTensors, lines: LineTable | None, curves: Curves, ray: Ray, draw: LightDraw | None) -> Tensor:
    """The values of the level functions of curves, (K,) float64, attached: 0 on the curves.

    Args:
        scene: attached.
        lines: of textures.
        curves: (K,) the curves.
        ray: the rays that see the curves, attached; for a horizon, the ray that leaves the surface.
        draw: the light samples whose shadow borders are among the curves.
    """
    geometry, ray = attached_geometry(scene), _in_double(ray)
    found = torch.zeros_like(ray.d.x)
    for kind in (EDGE, RIM, MEETING, LINE, HORIZON, SHADOW):
        own = (curves.kind == kind).nonzero().squeeze(1)
        if not len(own):
            continue
        some, seen_by = rows((curves, ray), own)
        if kind == LINE:
            value = across_line(scene, geometry, lines, some, seen_by)
        elif kind == SHADOW:
            value = across_shadow(scene, geometry, some, seen_by, rows(draw, own))
        else:
            value = {EDGE: beside_edge, RIM: _facing, MEETING: nearer, HORIZON: _above}[kind](geometry, some, seen_by)
        found = found.index_add(0, own, value)
    return found


def _ends_of(geometry: Geometry, side: TriangleSide) -> tuple[Vec3, Vec3]:
    """The end points of triangle sides, world, attached."""
    first, second, third = _corners_of(geometry, side.prim, side.instance)
    return (where(side.corner == 0, second, where(side.corner == 1, third, first)),
            where(side.corner == 0, third, where(side.corner == 1, first, second)))


def beside_edge(geometry: Geometry, curves: Curves, ray: Ray) -> Tensor:
    """The level function of edges: the signed distance, up to a factor, at which rays pass them."""
    a, b = _ends_of(geometry, curves.edge)
    return dot(cross(b - a, ray.d), a - ray.o)


def _facing(geometry: Geometry, curves: Curves, ray: Ray) -> Tensor:
    """The level function of rims: the cosine, up to a factor, between shading normals and rays."""
    corners = _corners_of(geometry, curves.edge.prim, curves.edge.instance)
    normals = vertex_normals(geometry, _between(geometry, curves.edge.prim), curves.edge.instance)
    return dot(interpolated(normals, *crossed_at(corners, ray)), ray.d)


def _above(geometry: Geometry, curves: Curves, ray: Ray) -> Tensor:
    """The level function of horizons: the cosine, up to a factor, between scattered rays and the geometric normal."""
    corners = _corners_of(geometry, curves.edge.prim, curves.edge.instance)
    return dot(_normal_of(corners), ray.d)


def nearer(geometry: Geometry, curves: Curves, ray: Ray) -> Tensor:
    """The level function of intersections: the difference of the distances to the two triangles."""
    distances = []
    for prim, instance in ((curves.edge.prim, curves.edge.instance), (curves.other, curves.shown_by)):
        corners = _corners_of(geometry, prim, instance)
        n = _normal_of(corners)
        along = dot(ray.d, n)
        distances.append(dot(corners[0] - ray.o, n) / torch.where(along != 0, along, 1.0))
    return distances[0] - distances[1]


def across_line(scene: SceneTensors, geometry: Geometry, lines: LineTable, curves: Curves, ray: Ray) -> Tensor:
    """The level function of texture lines: how far beyond a line rays hit its triangle."""
    u, v = crossed_at(_corners_of(geometry, curves.edge.prim, curves.edge.instance), ray)
    return level_of_line(scene, lines, curves.edge.prim, curves.line, u, v) - curves.number


def across_shadow(scene: SceneTensors, geometry: Geometry, curves: Curves, ray: Ray, draw: LightDraw) -> Tensor:
    """The level function of shadow borders: the signed distance, up to a factor, at which light passes edges."""
    corners = _corners_of(geometry, curves.other, curves.shown_by)
    start, d, _ = light_line(scene, interpolated(corners, *crossed_at(corners, ray)), draw)
    a, b = _ends_of(geometry, curves.edge)
    return dot(cross(b - a, d), a - start)
