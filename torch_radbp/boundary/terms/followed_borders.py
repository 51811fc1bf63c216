"""Boundary term of sharp shadows seen in scattered directions that carry derivatives.

As in `bounced.py`, places on borders are connected to vertices of paths. The point that a path meets next is not glued
here: it slides in a direction that moves (`followed_light.py`), and over the border by what the direction towards this moves
more than that.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.curve.geometry import Geometry, geometry_of
from torch_radbp.boundary.curve.outline import Outline
from torch_radbp.boundary.eye.drawn_directions import DirectionNumbers, drawn
from torch_radbp.boundary.eye.seen_edges import course_of
from torch_radbp.boundary.eye.viewpoints import Viewpoints, arriving, path_of, vertex_on
from torch_radbp.boundary.terms.border import Borders, border
from torch_radbp.boundary.terms.bounced import light_sent_on, pairs_of, way_to
from torch_radbp.boundary.terms.call_traits import follows, sharp_lights_later
from torch_radbp.boundary.terms.covered_lights import Lights
from torch_radbp.boundary.terms.followed_light import moved_directions
from torch_radbp.boundary.terms.shadow_term import CutOff, ShadowTerm, cut_off, shadow_term
from torch_radbp.call.render_call import integrand_of
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.tensors.stage import EAGER
from torch_radbp.tensors.vec import Frame, Vec2, Vec3, dot, normalize


class FollowedBorders(NamedTuple):
    """K samples on shadow borders, each seen from a path vertex by a scattered direction; detached."""

    points: Viewpoints  # the path vertices
    borders: Borders
    basis: tuple[Vec3, Vec3]  # across the line of sight
    numbers: DirectionNumbers  # with which the vertices sample the directions towards the samples


@shadow_term
class FollowedShadows(ShadowTerm):
    """The boundary term of shadow borders of lights without extent, seen in scattered directions that carry derivatives."""

    rank = 7

    def applies(self) -> bool:
        return follows(self.call) and sharp_lights_later(self.call)

    def samples(self, number: int) -> CutOff | None:
        call, casting = self.still, self.casting
        pairs = pairs_of(self.from_lights, number, Lights(sharp=True, soft=False, around=False), True)
        if pairs is None:
            return None
        points, start, borders, inwards, times, passed = pairs
        scene, geometry, integrand = call.scene, geometry_of(call.scene), integrand_of(call, call.integrand, number)
        way = way_to(start, border(scene, geometry, casting.outline, borders), scene.dtype)
        basis = Frame.of(normalize(way.reach))[:2]
        course = course_of(partial(_sight_of, scene, geometry, casting.outline, start, borders, basis), times, inwards)
        eager = integrand.with_stages(EAGER)
        found = drawn(eager, path_of(call, points.ray, passed.key), points.hit, way.ray.d)
        beta = points.beta * found.scattered * found.share
        light = light_sent_on(call, integrand, points, borders, way, passed) * torch.stack(tuple(beta)).double()
        return cut_off(points.place, course, light, FollowedBorders(points, borders, basis, found.numbers))

    def seen(self, number: int, geometry: Geometry, found: CutOff) -> Vec2:
        points, borders, basis, numbers = found.samples
        rays = arriving(self.call, number, points, all_of_them=True)
        at = vertex_on(geometry, points, rays)
        seen = _sight_of(self.call.scene, geometry, self.casting.outline, at, borders, basis)
        d = moved_directions(self.call, points, rays, numbers)
        return Vec2(*(place - dot(d, across) for place, across in zip(seen, basis)))


def _sight_of(scene: SceneTensors, geometry: Geometry, outline: Outline, at: Vec3, borders: Borders,
              basis: tuple[Vec3, Vec3], step: Tensor | float = 0.0, off: Vec3 | None = None) -> Vec2:
    """Shadow ends as seen from points `at`, (N,) coordinates across the lines of sight, attached; args as of `border`."""
    d = normalize(border(scene, geometry, outline, borders, step, off) - at)
    return Vec2(*(dot(d, across) for across in basis))
