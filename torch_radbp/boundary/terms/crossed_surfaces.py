"""Boundary term of intersecting surfaces as path vertices see them.

At a vertex x of a path, of two surfaces that pass through each other along a curve a part of each is seen, up to the curve:
the part on the same side of the other surface as x. Paths that are scattered at x go on to points z that are glued to
surfaces; as an integral over these,

    L(x) = integral of f |cos x| |cos z| / r^2  L(z, x) dA

is cut off at the curve, once on either surface. Where the level of a surface, its height above the plane of the triangle
that passes through it, changes by dh at a fixed place, the curve moves over it by -dh / |grad h|, and

    dL = sum over both surfaces, integral of f |cos x| |cos z| / r^2  L(z, x)  s dh / |grad h| dl

with s the sign of the level at x. Points that are near x are not glued, but slide (`eye/slid.py`): then dh is of the point
that does. Where they are glued and both surfaces move together nothing changes, whatever x does. So it is for all
light, that of a lamp which passes through something included: no light sample tells what of its own lamp is hidden. From
lights without extent nothing is looked for: what they light ends at the curve, and what is seen from elsewhere ends there,
too.

References: as of `hidden_light.py`.
"""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.curve.geometry import Between, Corners, Geometry, geometry_of
from torch_radbp.boundary.curve.segments import Segments, height_above, heights_by, level_on_lines, place_of
from torch_radbp.boundary.eye.deposit import Deposit, attached_geometry
from torch_radbp.boundary.eye.past_edges import straight_past_edges
from torch_radbp.boundary.eye.seen_edges import BESIDE, Passed, salted, unhidden
from torch_radbp.boundary.eye.segment_tree import (
    SegmentTree,
    ends_of,
    segment_found,
    segment_passed,
    segment_tree,
    surfaces_along,
)
from torch_radbp.boundary.eye.slid import what_slides
from torch_radbp.boundary.eye.viewpoints import PathBatch, Viewpoints, eyes_at, vertex_at, viewpoints
from torch_radbp.boundary.eye.ways_down import lot_of_found, ways_down
from torch_radbp.boundary.terms.call_traits import glues
from torch_radbp.boundary.terms.hidden_light import EVERYTHING, light_beyond, most_paths, number_of_paths
from torch_radbp.boundary.terms.shadow_term import ShadowTerm, TermSize, shadow_term
from torch_radbp.call.render_call import RenderCall, integrand_of
from torch_radbp.raycast.protocol import Hit
from torch_radbp.scene.tables.scene_tensors import SceneTensors, extent_of
from torch_radbp.tensors.differentiated import primal
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.record import joined
from torch_radbp.tensors.stage import stage
from torch_radbp.tensors.vec import TINY, Vec2, Vec3, cross, dot, interpolated, normalize, rows, where

SALT = 0x7F4A7C15  # tells the random numbers of these places from others
PATHS = 0.5  # of the paths from which edges are looked at, that segments are looked at from
LOOKS, PLACES = 4, 2  # for segments from each vertex, and places on segments that were found


class Sheets(NamedTuple):
    """N surfaces that others intersect, at points of the intersection, as viewpoints see them; detached, float64."""

    triangle: Tensor  # (N,) int32
    instance: Tensor | None  # (N,) int32, that shows it
    at: Vec2  # barycentric
    through: Tensor  # (N,) int32, the triangle that passes through
    shown_by: Tensor | None  # (N,) int32, what shows that
    beside: Vec2  # a little into the part that is seen, barycentric
    line: Tensor  # (N,) int32, of a line that slides; -1: of none
    growth: Tensor  # how much of that is gained where the level rises by one, barycentric coordinates squared


class CrossedOfView(NamedTuple):
    """K surfaces that path vertices of a view see up to an intersection; detached."""

    points: Viewpoints  # the path vertices
    viewpoint: Tensor  # (K,) int32, index of the vertex
    start: Vec3  # world positions of the vertices
    sheets: Sheets
    strength: Tensor  # (3, K) float64, gain of light per unit of the level


@shadow_term
class CrossedSurfaces(ShadowTerm):
    """The boundary term of surface intersections, and of lines that slide over surfaces, as path vertices see them."""

    rank = 8
    needs = "crossing",

    @classmethod
    def size(cls, call: RenderCall) -> TermSize:
        return TermSize(kept=int(2 * PLACES * PATHS * most_paths(call)))  # fewer than others while found

    def applies(self) -> bool:
        return glues(self.call) and (self.call.integrand.max_depth > 2 or surfaces_shine(self.call.scene, self.crossing))

    @cached_property
    def curves(self) -> SegmentTree:
        """The intersection segments and sliding lines, and a tree over them."""
        return segment_tree(self.still.stages, geometry_of(self.still.scene), self.crossing)

    def samples(self, number: int) -> CrossedOfView | None:
        call = self.still
        view, geometry = call.views[number], geometry_of(call.scene)
        integrand = integrand_of(call, call.integrand, number)
        points = viewpoints(call, number, integrand, PathBatch(number_of_paths(call, view, PATHS)))
        if not len(points.depth):
            return None
        at, extent = vertex_at(call, geometry, number, points), extent_of(geometry)
        eyes = eyes_at(geometry, points, at)
        seed, count, (segments, tree) = salted(view, SALT), PLACES * len(points.depth), self.curves
        ways = ways_down(call.stages, tree, eyes, seed, LOOKS, extent)
        found = call.stages(segment_found)(geometry, segments, tree.slots, eyes, ways, extent)
        found = lot_of_found(found, ways.eye, LOOKS, count)
        if found is None:
            return None
        passed = call.stages(segment_passed)(geometry, segments, eyes, found[0], seed, extent, found[1])
        passed = rows(passed, unhidden(call.integrand, passed))
        if not len(passed.edge):
            return None
        sheets = joined(list(call.stages(sheets_seen)(geometry, segments, at, passed, extent)))
        passed = joined([passed, passed])
        hit = hit_at(sheets, sheets.beside, integrand.proposal.dtype)
        past = straight_past_edges(call.scene, at, passed, hit)
        everywhere = torch.ones_like(passed.edge, dtype=torch.bool)
        light = light_beyond(call, integrand, points, at, passed, past, EVERYTHING, everywhere) * sheets.growth
        kept = ((light != 0) & torch.isfinite(light)).any(0).nonzero().squeeze(1)
        if not len(kept):
            return None
        return CrossedOfView(points, passed.eye[kept], rows(at, passed.eye[kept]), rows(sheets, kept), light[:, kept])

    def jumps(self, number: int, found: CrossedOfView) -> list[Deposit]:
        geometry, sheets = attached_geometry(self.call.scene)._replace(lines=self.lines), found.sheets
        met, seen_from = hit_at(sheets, sheets.at, found.points.hit.u.dtype), rows(found.points, found.viewpoint)
        near, ways = what_slides(self.call, number, geometry, seen_from, found.start, met, sheets.at)
        at = (place.index_add(0, near, way) for place, way in zip(sheets.at, ways))
        u, v = at
        p = interpolated(place_of(geometry, sheets.triangle, sheets.instance), u, v)
        level = height_above(place_of(geometry, sheets.through, sheets.shown_by), p)
        if self.lines is not None:
            between = Between(*lookup(geometry.triangles.corners, sheets.triangle))
            level = torch.where(sheets.line >= 0, level_on_lines(geometry, between, u, v, sheets.line), level)
        return [Deposit(seen_from.place, found.strength.unbind(), level - primal(level))]


def surfaces_shine(scene: SceneTensors, segments: Segments) -> bool:
    """True if one of the intersecting surfaces emits light, which path vertices receive directly."""
    return any(bool(((rows(scene.triangles.emitter, triangle.clamp_min(0)) >= 0) & (triangle >= 0)).any())
               for triangle, _ in surfaces_along(segments))


def hit_at(sheets: Sheets, place: Vec2, dtype: torch.dtype) -> Hit:
    """Hits on the surfaces at given barycentric coordinates, (N,), at distance 0."""
    u, v = (part.to(dtype) for part in place)
    return Hit(sheets.triangle, u, v, torch.zeros_like(u), sheets.instance)


@stage("geometry", "segments", "at")
def sheets_seen(geometry: Geometry, segments: Segments, at: Vec3, passed: Passed,
                extent: Tensor) -> tuple[Sheets, Sheets]:
    """The two intersecting surfaces at samples on segments, as viewpoints see them.

    Args:
        geometry: of the scene, detached.
        segments: (S,) the segments.
        at: (M,) world positions of the viewpoints.
        passed: (N,) samples on segments as these see them.
        extent: () of the scene.
    """
    own, eye = rows(segments, passed.edge), rows(at, passed.eye)
    surfaces, (start, end) = surfaces_along(own), ends_of(geometry, own)
    corners, found = [place_of(geometry, *surface) for surface in surfaces], []
    slides, (one, two) = own.through < 0, corners  # a line on one surface, of which either side is seen
    corners = [one, tuple(where(slides, here, there) for here, there in zip(one, two))]
    surfaces[1] = tuple(None if there is None else torch.where(slides, here, there)
                        for here, there in zip(surfaces[0], surfaces[1]))
    for way, (surface, other), (mine, passing) in zip((1.0, -1.0), (surfaces, surfaces[::-1]), (corners, corners[::-1])):
        rise, run = heights_by(passing, mine), direction_on(mine, end - start)
        steep = rise.x * rise.x + rise.y * rise.y
        side = torch.sign(height_above(passing, eye))
        growth = side * torch.sqrt((run.x * run.x + run.y * run.y) / steep.clamp_min(TINY)) * passed.times
        n = cross(mine[1] - mine[0], mine[2] - mine[0])
        across = normalize(cross(n, end - start))
        upwards = torch.sign(dot(across, cross(passing[1] - passing[0], passing[2] - passing[0])))
        here, step = direction_on(mine, passed.p - mine[0]), direction_on(mine, across * (side * upwards * BESIDE * extent))
        run_of_line, steep_line = direction_on(one, end - start), own.rise.x * own.rise.x + own.rise.y * own.rise.y
        of_line = way * torch.sqrt(
            (run_of_line.x * run_of_line.x + run_of_line.y * run_of_line.y) / steep_line.clamp_min(TINY)) * passed.times
        growth = torch.where(slides, of_line, growth)
        step = Vec2(*(torch.where(slides, aside * way, across) for aside, across in zip(own.aside, step)))
        found.append(Sheets(*surface, here, *other, here + step, own.line, growth))
    return tuple(found)


def direction_on(corners: Corners, d: Vec3) -> Vec2:
    """The changes of barycentric coordinates along directions d in the planes of triangles; (N,)."""
    one, two = corners[1] - corners[0], corners[2] - corners[0]
    n = cross(one, two)
    squared = dot(n, n).clamp_min(TINY)
    return Vec2(dot(cross(d, two), n) / squared, dot(cross(one, d), n) / squared)
