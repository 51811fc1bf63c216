"""Boundary terms of scattered directions that carry derivatives (attached sampling, rough glass).

There the next vertex of a path is not glued to its surface. For given random numbers it slides over surfaces in a direction
d that moves, and from one surface to another where an edge p is met. With e the edge's unit tangent and n normal to e and d,
from the blocker to the background,

    dL = integral of f |cos x| / r  (L_blocker - L_background)  n . (p' - x' - r d')  dl / r

with r the distance from x, and d' the motion of the direction that the random numbers give which pass the edge
(`eye/drawn_directions.py`). Points of lamps that are picked are glued to these: of their share, by multiple importance
sampling, edges cut off what `hidden_light.py` says.

References: as there; Li 2020, equation 1, with whose derivative of directions this goes.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.curve.geometry import geometry_of
from torch_radbp.boundary.eye.deposit import Deposit, attached_geometry, swept_areas
from torch_radbp.boundary.eye.drawn_directions import DirectionNumbers, Drawn, directions_drawn, drawn
from torch_radbp.boundary.eye.lines_through_edges import solid_angle
from torch_radbp.boundary.eye.seen_edges import BEFORE, BESIDE, Passed, places_seen, salted, unhidden
from torch_radbp.boundary.eye.viewpoints import PathBatch, Viewpoints, arriving, path_of, vertex_at, vertex_on, viewpoints
from torch_radbp.boundary.terms.call_traits import follows
from torch_radbp.boundary.terms.cuts import CutsOfView, all_cuts, cut_at, matter, some_cuts
from torch_radbp.boundary.terms.hidden_light import (
    EVERYTHING,
    LOOKS,
    Straight,
    eyes_of,
    most_paths,
    number_of_paths,
    on_no_surface,
)
from torch_radbp.boundary.terms.shadow_term import ShadowTerm, TermSize, shadow_term
from torch_radbp.call.render_call import RenderCall, integrand_of
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.trace import trace
from torch_radbp.raycast.protocol import Hit
from torch_radbp.scene.packing.material_tables import one_sided
from torch_radbp.scene.tables.scene_tensors import extent_of
from torch_radbp.tensors.differentiated import any_differentiated, asks_for_derivatives
from torch_radbp.tensors.stage import EAGER
from torch_radbp.tensors.vec import TINY, Ray, Vec2, Vec3, dot, masked, normalize, rows
from torch_radbp.vertex.material import sampling_at, turning_values

SALT = 0x510E527F  # tells the random numbers of these places from others
PLACES = 2  # on edges, for each path
TIMES_AS_LARGE = 2  # as other places in memory: how directions move is recorded operation by operation


class FollowedCuts(NamedTuple):
    """K samples where differentiated directions meet edges, and samples where edges occlude sampled lamps; detached."""

    directions: CutsOfView  # in coordinates across the line of sight
    numbers: DirectionNumbers  # (K,) with which vertices sample the directions
    lamps: CutsOfView


class EdgeSide(NamedTuple):
    """What path vertices see on one side of N edges."""

    ray: Ray  # from the vertices
    hit: Hit  # what it meets


class Beyond(NamedTuple):
    """What path vertices see on both sides of an edge, (N,) each."""

    front: EdgeSide  # the blocker
    back: EdgeSide  # the background


class LightBeside(NamedTuple):
    """The light on both sides of edges that reaches a view, (3, N) float64 each, per solid angle."""

    drawn: Tensor  # background less blocker, by BSDF sampling
    picked: Tensor  # background, by light sampling


@shadow_term
class FollowedLight(ShadowTerm):
    """The boundary term of scattered directions that carry derivatives: they turn with parameters, and slide over edges."""

    rank = 6

    @classmethod
    def size(cls, call: RenderCall) -> TermSize:
        places = follows(call) * most_paths(call) * PLACES * TIMES_AS_LARGE
        return TermSize(0, places, places)

    @classmethod
    def turns(cls, call: RenderCall) -> bool:
        """True if differentiated textures or normals turn sampled directions that carry derivatives."""
        settings = call.integrand.settings
        kinds = [(bsdf.textures(), bsdf.kind()) for bsdf in one_sided(call.module.bsdfs())]
        turned = [source for textures, kind in kinds if kind.smooth and sampling_at(kind, settings.sampling) == "attached"
                  for slot in turning_values(kind, settings.sampling) for source in textures[slot].sources()]
        normals = call.scene.triangles.vertices.n
        return any(map(asks_for_derivatives, turned)) or follows(call) and any_differentiated(normals)

    def applies(self) -> bool:
        return follows(self.call)

    def samples(self, number: int) -> FollowedCuts | None:
        call, casting = self.still, self.casting
        view, geometry = call.views[number], geometry_of(call.scene)
        integrand = integrand_of(call, call.integrand, number)
        points = viewpoints(call, number, integrand, PathBatch(number_of_paths(call, view)), following=True)
        if not len(points.depth):
            return None
        at = vertex_at(call, geometry, number, points)
        eyes = eyes_of(call, number, integrand, points, at, EVERYTHING)
        passed = places_seen(call.stages, geometry, casting, eyes, salted(view, SALT), LOOKS, PLACES * len(points.depth))
        if passed is None:
            return None
        passed = rows(passed, unhidden(call.integrand, passed))
        if not len(passed.edge):
            return None
        start = rows(at, passed.eye)
        beyond = _beside(integrand, passed, start, BESIDE * extent_of(geometry))
        own = rows(points, passed.eye)._replace(key=passed.key)
        eager = integrand.with_stages(EAGER)
        found = drawn(eager, path_of(call, own.ray, own.key), own.hit, beyond.back.ray.d)
        elsewhere = own.by_chance & on_no_surface(casting.outline, passed.edge)
        light = light_beside(call, integrand, own, beyond, found, elsewhere)

        def cuts_at(hit: Hit, lost: Tensor) -> CutsOfView:
            return all_cuts(call.stages, geometry, casting, points, at, passed, hit, lambda cuts: lost)

        nothing = beyond.back.hit._replace(prim=torch.full_like(beyond.back.hit.prim, -1))
        directions = cuts_at(nothing, light.drawn)
        onto_lamps = solid_angle(call.scene, beyond.back.hit, Ray(start, passed.p - start))
        lamps = cuts_at(beyond.back.hit, light.picked * onto_lamps)
        kept, of_lamps = matter(directions), matter(lamps)
        if not len(kept) and not len(of_lamps):
            return None
        return FollowedCuts(some_cuts(directions, kept), rows(found.numbers, kept), some_cuts(lamps, of_lamps))

    def jumps(self, number: int, found: FollowedCuts) -> list[Deposit]:
        call, geometry, own, lamps = self.call, attached_geometry(self.call.scene), found.directions, found.lamps
        points, viewpoint = own.points, own.cuts.viewpoint
        rays = arriving(call, number, points, all_of_them=True)
        at = vertex_on(geometry, points, rays)
        seen, of_lamps = (cut_at(geometry, self.casting.outline, at, cuts) for cuts in (own.cuts, lamps.cuts))
        d = moved_directions(call, rows(points, viewpoint), rows(rays, viewpoint), found.numbers)
        seen = Vec2(*(place - dot(d, across) for place, across in zip(seen, own.cuts.basis)))
        parts = (own, viewpoint, swept_areas(seen, own.normal)), (
            lamps, lamps.cuts.viewpoint, swept_areas(of_lamps, lamps.normal))
        return [Deposit(rows(points.place, number), part.strength.unbind(), moved) for part, number, moved in parts]


def moved_directions(call: RenderCall, points: Viewpoints, rays: Ray, numbers: DirectionNumbers) -> Vec3:
    """(K,) unit, float64, attached: the directions that path vertices sample from given random numbers.

    Args:
        points: the viewpoints.
        rays: the rays that hit them, attached.
        numbers: the random numbers.
    """
    integrand = call.make_integrand(call.scene)
    state = path_of(call, rays, points.key)
    state = state._replace(pdf=torch.where(points.slides, state.pdf, 1.0))  # tells which of them slide
    found = directions_drawn(integrand.with_stages(EAGER), state, points.hit, numbers)
    return found.map(torch.Tensor.double)


def _beside(integrand: Integrand, passed: Passed, start: Vec3, off: Tensor) -> Beyond:
    """Traces rays on both sides of samples on edges; `start`: (N,) the path vertices, `off`: their offset from the edge."""
    reach = passed.p - start
    distance = torch.sqrt(dot(reach, reach)).clamp_min(TINY)
    dtype = passed.onwards.d.x.dtype
    to_front = normalize(reach - passed.outwards * off)
    o, d = (part.map(lambda c: c.to(dtype).contiguous()) for part in (start + to_front * (distance * BEFORE), to_front))
    front, back = integrand.caster.intersect(Ray(o, d)), integrand.caster.intersect(passed.onwards)
    origin = start.map(lambda c: c.to(dtype))
    return Beyond(EdgeSide(Ray(origin, d), front._replace(t=front.t + (distance * BEFORE).to(dtype))),
                  EdgeSide(Ray(origin, passed.onwards.d), back._replace(t=back.t + distance.to(dtype))))


def light_beside(call: RenderCall, integrand: Integrand, points: Viewpoints, beyond: Beyond, found: Drawn,
                 elsewhere: Tensor) -> LightBeside:
    """The light on either side of edges that reaches a view.

    Args:
        integrand: of the view, detached.
        points: (N,) the path vertices that see the edges.
        beyond: what they see on both sides.
        found: the directions as BSDF samples of the vertices.
        elsewhere: (N,) bool: later vertices at which light samples' borders are counted in `bounced.py` already.
    """
    first, later = Straight.uncovered(call)[:2]
    none = torch.zeros(3, len(points.depth), dtype=torch.float64, device=call.scene.device)
    by_drawing, by_picking = none, none.clone()
    for depth in points.depth.unique().tolist():
        lanes = (points.depth == depth).nonzero().squeeze(1)
        back, front = (rows(side, lanes) for side in (beyond.back, beyond.front))
        pdf = found.pdf[lanes]
        here = None if found.vantage is None else rows(found.vantage, lanes)
        sure, behind, before = (path_of(call, side.ray, rows(points.key, lanes)) for side in (back, back, front))
        behind, before = (state._replace(pdf=torch.where(pdf > 0, pdf, 1.0), vantage=here) for state in (behind, before))
        L = trace(integrand, behind, hit=back.hit, depth=depth + 1)
        L = L - trace(integrand, before, hit=front.hit, depth=depth + 1)
        by_drawing[:, lanes] = torch.stack(tuple(L)).double()
        if integrand.settings.nee and (depth > 0 or any(first)):
            straight = integrand._replace(max_depth=depth + 2)
            L = trace(straight, sure, hit=back.hit, depth=depth + 1) - trace(straight, behind, hit=back.hit, depth=depth + 1)
            some = first if depth == 0 else later
            counts = torch.where(back.hit.prim >= 0, some.soft, some.around)
            L = masked(counts if depth == 0 else counts | ~elsewhere[lanes], L)
            by_picking[:, lanes] = torch.stack(tuple(L)).double()
    scale = torch.stack(tuple(points.beta * found.scattered)).double()
    return LightBeside(by_drawing * scale * found.share.double(), by_picking * scale)
