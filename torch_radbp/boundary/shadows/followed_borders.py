"""Boundary term of sharp shadows seen in scattered directions that carry derivatives.

As in `bounced.py`, places on borders are connected to vertices of paths. The point that a path meets next is not glued
here: it slides in a direction that moves (`followed_light.py`), and over the border by what the direction towards this moves
more than that.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.geometry import Geometry, geometry_of
from torch_radbp.boundary.outline import Outline
from torch_radbp.boundary.shadows.border import Borders, border
from torch_radbp.boundary.shadows.bounced import light_sent_on, pairs_of, way_to
from torch_radbp.boundary.shadows.drawn_directions import DirectionNumbers, drawn
from torch_radbp.boundary.shadows.film_jumps import FilmJumps, attached_geometry, swept_areas
from torch_radbp.boundary.shadows.followed_light import moved_directions
from torch_radbp.boundary.shadows.seen_edges import finite_normal, pace
from torch_radbp.boundary.shadows.shadow_term import ShadowTerm, follows, shadow_term, sharp_lights_later
from torch_radbp.boundary.shadows.split import ALL, Amount
from torch_radbp.boundary.shadows.viewpoints import Viewpoints, arriving, path_of, vertex_on
from torch_radbp.call.render_call import integrand_of
from torch_radbp.scene.tensors import SceneTensors
from torch_radbp.tensors.stage import EAGER
from torch_radbp.tensors.vec import Frame, Vec2, Vec3, dot, normalize, rows


class FollowedBorders(NamedTuple):
    """K samples on borders, each seen from a path vertex; detached."""

    points: Viewpoints  # the path vertices
    borders: Borders
    basis: tuple[Vec3, Vec3]  # across the line of sight
    numbers: DirectionNumbers  # with which the vertices sample the directions towards the samples
    normal: Vec2  # in coordinates across the line of sight; its length is that of the piece per sample
    strength: Tensor  # (3, K) float64, radiance from behind less that from ahead


@shadow_term
class FollowedShadows(ShadowTerm):
    """Borders of lights without extent that are seen in scattered directions which carry derivatives."""

    rank = 7

    def applies(self) -> bool:
        return follows(self.call) and sharp_lights_later(self.call)

    def samples(self, number: int, amount: Amount = ALL) -> FollowedBorders | None:
        call, casting = self.still, self.casting
        pairs = pairs_of(call, number, casting, True)
        if pairs is None:
            return None
        points, start, borders, inwards, times, key = pairs
        scene, geometry, integrand = call.scene, geometry_of(call.scene), integrand_of(call, call.integrand, number)
        way = way_to(start, border(scene, geometry, casting.outline, borders), scene.dtype)
        basis = Frame.of(normalize(way.reach))[:2]
        here, along = pace(lambda step: _sight_of(scene, geometry, casting.outline, start, borders, basis, step), times)
        shade = _sight_of(scene, geometry, casting.outline, start, borders, basis, off=inwards)
        normal = finite_normal(along, times)
        ahead = (shade.x - here.x) * normal.x + (shade.y - here.y) * normal.y > 0
        eager = integrand.with_stages(EAGER)
        found = drawn(eager, path_of(call, points.ray, key), points.hit, way.ray.d)
        beta = points.beta * found.scattered * found.share
        light = light_sent_on(call, integrand, borders, way, key) * torch.stack(tuple(beta)).double()
        light = torch.where((normal.x != 0.0) | (normal.y != 0.0), light, 0.0)
        kept = (light != 0).any(0).nonzero().squeeze(1)
        if not len(kept):
            return None
        light, ahead = light[:, kept], ahead[kept]
        return FollowedBorders(*rows((points, borders, basis, found.numbers, normal), kept),
                               torch.where(ahead, light, -light))

    def jumps(self, number: int, found: FollowedBorders) -> FilmJumps:
        geometry = attached_geometry(self.call.scene)
        rays = arriving(self.call, number, found.points, all_of_them=True)
        at = vertex_on(geometry, found.points, rays)
        seen = _sight_of(self.call.scene, geometry, self.casting.outline, at, found.borders, found.basis)
        d = moved_directions(self.call, found.points, rays, found.numbers)
        seen = Vec2(*(place - dot(d, across) for place, across in zip(seen, found.basis)))
        return FilmJumps(found.points.place, found.strength * swept_areas(seen, found.normal))


def _sight_of(scene: SceneTensors, geometry: Geometry, outline: Outline, at: Vec3, borders: Borders,
              basis: tuple[Vec3, Vec3], step: Tensor | float = 0.0, off: Vec3 | None = None) -> Vec2:
    """Shadow ends as points `at` see them, (N,) coordinates across the lines of sight, attached; args as of `border`."""
    d = normalize(border(scene, geometry, outline, borders, step, off) - at)
    return Vec2(*(dot(d, across) for across in basis))
