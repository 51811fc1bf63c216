"""Samples of edges that occlude light from vertices of paths, and the motion of the borders at which that light ends."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.curve.geometry import Geometry, geometry_of
from torch_radbp.boundary.curve.outline import Outline
from torch_radbp.boundary.eye.deposit import Deposit, attached_geometry, swept_areas
from torch_radbp.boundary.eye.seen_edges import (
    BESIDE,
    Casting,
    Passed,
    corners_of,
    course_of,
    crossed_at,
    point_of_edge,
)
from torch_radbp.boundary.eye.slid import less_what_slides
from torch_radbp.boundary.eye.viewpoints import Viewpoints, vertex_at
from torch_radbp.call.render_call import RenderCall
from torch_radbp.raycast.protocol import Hit
from torch_radbp.scene.tables.scene_tensors import extent_of
from torch_radbp.tensors.differentiated import primal
from torch_radbp.tensors.record import leaves_of, with_leaves
from torch_radbp.tensors.stage import Stages, stage
from torch_radbp.tensors.vec import Ray, Vec2, Vec3, cross, dot, normalize, rows, unit_normal


class Cuts(NamedTuple):
    """N samples of edges that occlude light from viewpoints; detached."""

    viewpoint: Tensor  # (N,) int32
    edge: Tensor  # (N,) int32, edge of the outline
    along: Tensor  # (N,) float64, position along the edge, from a to b
    hit: Hit  # the surface beyond; triangle -1: nothing
    basis: tuple[Vec3, Vec3]  # across the line of sight


class CutsOfView(NamedTuple):
    """K samples of edges that occlude light from path vertices of a view; detached."""

    points: Viewpoints  # viewpoints, not all of them used
    cuts: Cuts
    normal: Vec2  # in the coordinates of `cut_at`; its length is that of the piece per sample
    strength: Tensor  # (3, K) float64, light lost per unit of motion of the border
    sweep: Tensor  # as of `shadow_term.CutOff`

    def independent(self) -> Tensor:
        """(3, P) changes of the image if all edges move alike, one for each path, so that they are independent."""
        _, path = self.cuts.viewpoint.unique(return_inverse=True)
        return self.strength.new_zeros(3, int(path.max()) + 1).index_add(1, path, self.strength * self.sweep)

    def parted(self) -> tuple[CutsOfView | None, CutsOfView | None]:
        """Splits into samples of pilot paths, which only estimate noise, and all others; None: there are none."""
        if self.points.tried is None:
            return None, self
        tried, own = rows(self.points.tried, self.cuts.viewpoint), self._replace(points=self.points._replace(tried=None))
        return tuple(with_used_viewpoints(some_cuts(own, part.nonzero().squeeze(1))) if part.any() else None
                     for part in (tried, ~tried))


def jumps_of_cuts(call: RenderCall, number: int, outline: Outline, found: CutsOfView) -> Deposit:
    """The derivative from light that edges occlude from path vertices, as a deposit on the film of view `number`.

    Args:
        call: the rendering, in which something moves.
        outline: the edges of everything that casts shadows.
        found: the samples of the view.
    """
    geometry = attached_geometry(call.scene)
    at, viewpoint = vertex_at(call, geometry, number, found.points), found.cuts.viewpoint
    seen, start = cut_at(geometry, outline, at, found.cuts), rows(at.map(primal), viewpoint)
    seen = less_what_slides(call, number, geometry, rows(found.points, viewpoint), start, found.cuts.hit, seen)
    return Deposit(rows(found.points.place, viewpoint), found.strength.unbind(), swept_areas(seen, found.normal))


def rise_of(call: RenderCall, number: int, outline: Outline, found: CutsOfView) -> Tensor:
    """The cosine between a path vertex's normal, on the side it came from, and the direction to an edge; (K,) detached."""
    geometry, cuts = geometry_of(call.scene), found.cuts
    points, at = rows((found.points, vertex_at(call, geometry, number, found.points)), cuts.viewpoint)
    corners = corners_of(geometry, points.hit)
    n = unit_normal(corners[1] - corners[0], corners[2] - corners[0])
    reach = normalize(point_of_edge(geometry, outline, cuts.edge, cuts.along) - at)
    return -dot(n, reach) * torch.sign(dot(n, points.ray.d.map(torch.Tensor.double)))


class CutCourse(NamedTuple):
    """The normals of borders at which edges occlude light, and the areas swept, at N samples; detached, float64."""

    basis: tuple[Vec3, Vec3]  # across the line of sight
    normal: Vec2  # as of `CutsOfView`; 0 where unknown
    sweep: Tensor


def cut_at(geometry: Geometry, outline: Outline, vertices: Vec3, cuts: Cuts, step: Tensor | float = 0.0,
           off: Vec3 | None = None) -> Vec2:
    """The points at which lines from viewpoints through edges meet the surface beyond, (N,) barycentric; attached.

    If nothing lies beyond: the direction of the line, as coordinates across the line of sight.

    Args:
        geometry: attached.
        outline: the edges.
        vertices: (M,) the viewpoints, attached.
        cuts: the samples.
        step, off: as for `border`.
    """
    start, p = rows(vertices, cuts.viewpoint), point_of_edge(geometry, outline, cuts.edge, cuts.along + step)
    reach = (p if off is None else p + off) - start
    met, d = crossed_at(corners_of(geometry, cuts.hit), Ray(start, reach)), normalize(reach)
    return Vec2(*(torch.where(cuts.hit.prim >= 0, inside, dot(d, across)) for inside, across in zip(met, cuts.basis)))


@stage("geometry", "outline", "at")
def cut_course(geometry: Geometry, outline: Outline, at: Vec3, passed: Passed, hit: Hit, extent: Tensor) -> CutCourse:
    """The normals of borders on the surfaces beyond edges, where light ends that these occlude, and the areas swept.

    Args:
        geometry: of the scene, detached.
        outline: the edges.
        at: (M,) world positions of the viewpoints.
        passed: (N,) samples on edges as the viewpoints see them.
        hit: (N,) the surfaces beyond.
        extent: () of the scene.
    """
    sight = normalize(passed.p - rows(at, passed.eye))
    side = normalize(cross(passed.outwards, sight))
    cuts = Cuts(passed.eye, passed.edge, passed.along, hit, (cross(sight, side), side))
    course = course_of(partial(cut_at, geometry, outline, at, cuts), passed.times, passed.outwards * (BESIDE * extent))
    return CutCourse(cuts.basis, course.normal, course.sweep)


def all_cuts(stages: Stages, geometry: Geometry, casting: Casting, points: Viewpoints, at: Vec3, passed: Passed, hit: Hit,
             light: Callable[[Cuts], Tensor]) -> CutsOfView:
    """Samples of edges with the light that they occlude from path vertices, and how its borders move.

    Those that occlude no light are included.

    Args:
        stages, geometry, casting: as for `places_seen`.
        points: viewpoints, which lie `at` (M,) world.
        passed: (N,) samples on edges as the viewpoints see them.
        hit: (N,) the surfaces beyond, on which light is cut off.
        light: returns for cuts the light beyond that reaches the view, (3, N), per unit of `cut_at`'s coordinates.
    """
    basis, normal, sweep = stages(cut_course)(geometry, casting.outline, at, passed, hit, extent_of(geometry))
    cuts = Cuts(passed.eye, passed.edge, passed.along, hit, basis)
    lost = torch.where((normal.x != 0.0) | (normal.y != 0.0), light(cuts), 0.0)
    return CutsOfView(points, cuts, normal, torch.where(sweep > 0, -lost, lost), sweep)


def cuts_that_matter(stages: Stages, geometry: Geometry, casting: Casting, points: Viewpoints, at: Vec3, passed: Passed,
                     hit: Hit, light: Callable[[Cuts], Tensor]) -> CutsOfView | None:
    """The samples at which edges occlude light; None: there are none. Args as for `all_cuts`."""
    found = all_cuts(stages, geometry, casting, points, at, passed, hit, light)
    kept = matter(found)
    return with_used_viewpoints(some_cuts(found, kept)) if len(kept) else None


def matter(found: CutsOfView) -> Tensor:
    """The indices of samples at which an edge occludes light, int64."""
    return (found.strength != 0).any(0).nonzero().squeeze(1)


def some_cuts(found: CutsOfView, kept: Tensor) -> CutsOfView:
    """Selects samples of edges that occlude light by index; the viewpoints of all are kept."""
    return found._replace(cuts=rows(found.cuts, kept), normal=rows(found.normal, kept), strength=found.strength[:, kept],
                          sweep=found.sweep[kept])


def with_used_viewpoints(found: CutsOfView) -> CutsOfView:
    """Drops the viewpoints without samples, since viewpoints that slide are traced once more, attached."""
    used, viewpoint = found.cuts.viewpoint.unique(return_inverse=True)
    cuts = found.cuts._replace(viewpoint=viewpoint.to(found.cuts.viewpoint.dtype))
    return found._replace(points=rows(found.points, used.long()), cuts=cuts)


def joined_cuts(found: Sequence[tuple[CutsOfView, float]]) -> CutsOfView | None:
    """Joins sets of samples, each scaled by its weight; None: there are none."""
    if not found:
        return None
    before = itertools.accumulate([len(own.points.depth) for own, _ in found], initial=0)
    parts = [own._replace(strength=own.strength * share, cuts=own.cuts._replace(viewpoint=own.cuts.viewpoint + first))
             for (own, share), first in zip(found, before)]
    if len(parts) == 1:
        return parts[0]
    columns = zip(*(leaves_of(part) for part in parts))
    return with_leaves(parts[0], [torch.cat(own, -1) if isinstance(own[0], Tensor) else own[0] for own in columns])
