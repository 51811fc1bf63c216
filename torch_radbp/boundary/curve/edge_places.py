"""Samples on edges as a camera sees them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.curve.creases import FOLD, SHADED, TURNED, WHOLE
from torch_radbp.boundary.curve.film_term import CurvesInView, ExaminedView, FilmTerm, film_term, lines_in_view
from torch_radbp.boundary.curve.geometry import Between, Geometry, in_world, point_at, vertex_normals
from torch_radbp.boundary.curve.outline import Jumps, Outline
from torch_radbp.boundary.curve.places import (
    CREASE,
    SILHOUETTE,
    Glued,
    Lot,
    Places,
    Sight,
    depth_of,
    length_in_view,
    on_film,
    picked,
    place_numbers,
    velocities_on_film,
)
from torch_radbp.boundary.curve.silhouette import is_silhouette
from torch_radbp.boundary.curve.terminators import light_may_end
from torch_radbp.scene.tables.triangle_corners import clearance
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.stage import stage
from torch_radbp.tensors.vec import TINY, Vec2, Vec3, dot, normalize, rows, unit_normal

COPLANAR = 1e-6  # half of the difference of unit normals, below which triangles lie in one plane
STEP = 1e-5  # of the width of a triangle, by which it is told on which side of an edge it is seen
CLEARANCES = 8.0  # how far off an edge a triangle is looked at, in units of how far off it rays leave it
INWARDS = 1e-3  # the same as a barycentric weight of the vertex opposite: at most, and where normals are seen askance:
ASKANCE = 1e-2  # cosine between line of sight and interpolated normal at the edge, up to which they are


@film_term
class OutlineEdges(FilmTerm):
    """The film curves of mesh edges: those that are silhouettes or creases."""

    rank = 0

    def in_view(self, viewed: ExaminedView, jumps: Jumps) -> list[CurvesInView]:
        return lines_in_view(viewed, jumps.outline, edge_weight, edge_place)


@stage("geometry", "sight")
def edge_weight(geometry: Geometry, sight: Sight, outline: Outline) -> Tensor:
    """The sampling weights of edges, (E,) float64: their length in view in pixels, less for weak discontinuities.

    Args:
        geometry: of the scene, detached.
        sight: of the camera.
        outline: (E,) the edges.
    """
    edges = outline.edges
    a, b, *opposite = in_world(geometry, (edges.a, edges.b, *edges.opposite), outline.instance)
    silhouette = is_silhouette(a, b, opposite, sight.eye.towards(a), sight.eye.radius)
    jump = torch.where(silhouette, 1.0, jump_of_creases(outline, a, b, opposite))
    if sight.lamps:
        ends = (outline.crease == SHADED) & light_may_end(sight.lamps, a, b, opposite)
        jump = torch.where(ends & ~silhouette, torch.minimum(*folds(a, b, opposite)), jump)
    return torch.where(jump > 0.0, length_in_view(sight, a, b) * jump, 0.0)


def jump_of_creases(outline: Outline, a: Vec3, b: Vec3, opposite: Sequence[Vec3]) -> Tensor:
    """An upper bound of the discontinuity at edges that are no silhouettes, (E,) float64 in [0, 1]; 0: none.

    Args:
        outline: (E,) the edges.
        a, b, opposite: their ends, and the vertices opposite; the bound is half the difference of the triangles' normals.
    """
    jump = (outline.crease == WHOLE).double()
    if not outline.folds:
        return jump
    facing, turned = folds(a, b, opposite)
    return torch.where(outline.crease >= FOLD, torch.where(outline.crease == TURNED, turned, facing), jump)


def folds(a: Vec3, b: Vec3, opposite: Sequence[Vec3]) -> tuple[Tensor, Tensor]:
    """Half the length of the difference of the two triangles' unit normals at edges, and the same with one normal reversed;
    (E,) float64 each, 0 where it is small."""
    here, there = (unit_normal(b - a, tip - a) for tip in opposite[:2])  # of two that are alike on opposite sides
    apart = [0.5 * torch.sqrt(dot(difference, difference)) for difference in (here + there, here - there)]
    return tuple(torch.where(half > COPLANAR, half, 0.0) for half in apart)


@stage("geometry", "sight", "outline", "lot")
def edge_place(geometry: Geometry, sight: Sight, outline: Outline, lot: Lot, place: Tensor) -> Places:
    """Samples points on an outline in proportion to its length on the film.

    Args:
        geometry, sight, outline: as for `edge_weight`.
        lot: the distribution of samples over its edges.
        place: (N,) int32, the numbers of the samples.
    """
    camera, numbers = sight.camera, place_numbers(sight, place, SILHOUETTE)
    aperture = numbers.aperture
    edge, share, times = picked(lot, place, numbers.along)
    edges, instance = rows(outline.edges, edge), rows(outline.instance, edge)
    a, b, *opposite = in_world(geometry, (edges.a, edges.b, *edges.opposite), instance)
    enters, leaves = sight.frustum.clipped(a, b)
    reach = leaves - enters
    along = enters + reach * share
    p = a + (b - a) * along
    at, (pace,) = on_film(camera, p, aperture), velocities_on_film(camera, p, [b - a], aperture)
    # The density over `along` is 1 / (times reach); the length of the edge on the film per `along` is in `pace`.
    scale = times * reach
    scale = scale if outline.share is None else scale / rows(outline.share, edge)
    scale = scale if outline.parts is None else scale * rows(outline.parts, edge).weight(along)
    if aperture is None:
        silhouette = is_silhouette(a, b, opposite, sight.eye.towards(a))
    else:
        silhouette = is_silhouette(a, b, opposite, -camera.kind.towards(camera.lens, a, aperture))
        crease = rows(outline.crease, edge)
        ends = (crease == SHADED) & light_may_end(sight.lamps, a, b, opposite)
        scale = scale * (silhouette | (crease > 0) | ends)
    normal = Vec2(-pace.y * scale, pace.x * scale)
    nothing = torch.zeros_like(along)
    here = PlaceOnEdge(instance, p, at, normal, aperture)
    sheets = [sheet_at(geometry, sight, (a, b, tip), corner, here)
              for tip, corner in zip(opposite[:2], edges.corner[:2])]
    side = torch.where(sheets[0].ahead + sheets[1].ahead >= 0.0, 1.0, -1.0)
    behind, ahead = _in_order(sheets, silhouette, edges.count <= 2)
    depth = torch.maximum(depth_of(camera, p, [a, b], aperture), torch.maximum(*(sheet.depth for sheet in sheets)))
    kind = torch.where(silhouette, SILHOUETTE, CREASE).to(torch.int32)
    return Places(kind, Between(edges.a, edges.b, edges.b), instance, along, nothing, p, at, normal, side, nothing, depth,
                  behind, ahead, torch.full_like(kind, -1), instance, numbers.key, aperture, camera.film.sees(at),
                  torch.full_like(kind, -1))


class PlaceOnEdge(NamedTuple):
    """N samples on edges as a camera sees them."""

    instance: Tensor | None  # (N,) int32, that shows the edge
    p: Vec3  # world
    film: Vec2  # as of `Places`, as are the next
    normal: Vec2
    aperture: Vec2 | None


class Sheet(NamedTuple):
    """One of the triangles at each sampled edge, as a camera sees it next to the sample; (N,)."""

    point: Glued  # a point of the triangle next to the sample
    ahead: Tensor  # how far it extends ahead of the edge on the film, not normalised
    nearness: Tensor  # derivative of its nearness by the distance from the edge on the film, likewise
    depth: Tensor  # its extent along the line of sight


def sheet_at(geometry: Geometry, sight: Sight, corners: tuple[Vec3, Vec3, Vec3], corner: Tensor,
             here: PlaceOnEdge) -> Sheet:
    """One triangle at each of N samples on edges, and how it extends from the edge on the film.

    Args:
        corners: the ends of the edge, and the opposite vertex of the triangle.
        corner: (N,) int32, the index of that corner among all.
        here: the samples.
    """
    (a, b, opposite), (instance, p, film, normal, aperture) = corners, here
    camera, along, inwards = sight.camera, b - a, opposite - p
    across = inwards - along * (dot(inwards, along) / dot(along, along))
    seen = on_film(camera, p + across * STEP, aperture)
    ahead = (seen.x - film.x) * normal.x + (seen.y - film.y) * normal.y
    towards = camera.kind.towards(camera.lens, p, aperture)
    triangle, place = torch.div(corner, 3, rounding_mode="floor"), corner % 3
    first, second, third = lookup(geometry.triangles.corners, triangle)
    in_turn = [torch.where(place == 0, one, torch.where(place == 1, two, three))
               for one, two, three in ((first, second, third), (second, third, first), (third, first, second))]
    tip, start, end = (point_at(geometry, row, instance) for row in in_turn)
    side = end - start
    of_tip, share = (dot(point - start, side) / dot(side, side) for point in (tip, p))
    # Where another surface touches an edge, light changes the faster the nearer to the end of that: near places have it
    # right, but rays must not pass by what touches. Normals at the edge itself may lie exactly across the line of sight.
    inwards = CLEARANCES * clearance(corners) * torch.rsqrt(dot(across, across).clamp_min(TINY))
    inwards = inwards.clamp_max(INWARDS)
    if geometry.layout.shading_normals:
        level = facing_at(geometry, triangle, Between(*in_turn), instance, share, towards)
        inwards = torch.where(level.abs() < ASKANCE, INWARDS, inwards)
    share = torch.minimum((share - inwards * of_tip).clamp_min(0.0), 1.0 - inwards)
    weights = inwards, 1.0 - inwards - share, share  # of the corner and those after it
    u = torch.where(place == 0, weights[1], torch.where(place == 1, weights[0], weights[2]))
    v = torch.where(place == 0, weights[2], torch.where(place == 1, weights[1], weights[0]))
    return Sheet(Glued(triangle, u, v), ahead, dot(across, towards) / ahead.abs(), depth_of(camera, p, [opposite], aperture))


def facing_at(geometry: Geometry, triangle: Tensor, between: Between, instance: Tensor | None, share: Tensor,
              towards: Vec3) -> Tensor:
    """The cosines between lines of sight and interpolated normals at points of edges, (N,); 1 for flat triangles.

    Args:
        triangle: (N,) int32, one triangle at each edge.
        between: the vertices opposite the edges, and those at their ends.
        instance: (N,) int32, the instances of the triangles.
        share: (N,) positions along the edges, as shares of their lengths.
        towards: (N,) the viewer, of any length.
    """
    _, start, end = vertex_normals(geometry, between, instance)
    n = normalize(start + (end - start) * share)
    level, smooth = dot(n, towards) * torch.rsqrt(dot(towards, towards)), geometry.triangles.smooth
    return level if smooth is None else torch.where(lookup(smooth, triangle), level, 1.0)


def _in_order(sheets: list[Sheet], silhouette: Tensor, known: Tensor) -> tuple[Glued, Glued]:
    """The triangles seen right behind and ahead of edges, at silhouettes the nearer one for both; -1 if not `known`."""
    one, two = sheets
    nearer, first = one.nearness >= two.nearness, one.ahead <= two.ahead
    found = []
    for of_crease in (first, ~first):
        pick = (silhouette & nearer) | (~silhouette & of_crease)
        point = Glued(*(torch.where(pick, here, there) for here, there in zip(one.point, two.point)))
        found.append(point._replace(prim=torch.where(known, point.prim, -1)))
    return tuple(found)
