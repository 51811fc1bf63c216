"""Boundary term of strips that become visible where touching bodies part: direct light, seen by the camera.

An edge lies on a surface, and rises from it by h. In the plane across it let the camera lie in the direction (c_x, c_y) and
a light sample in (l_x, l_y), y along the surface's normal and x away from the body. On the surface the camera sees past the
edge down to x_c = -h c_x / c_y, and the border of the edge's shadow lies at x_l = -h l_x / l_y. Moved as a silhouette alone
the edge uncovers what lies right before it, in light or not. Where x_l > x_c, what is missing is the strip between the two:

    light that reaches the surface before the edge does not reach the strip    - L (x_l - x_c)
    light from behind a sheet comes through below it                           + L (x_l - x_c)

with L what the surface sends to the camera by this light sample. Both ends are places on the film that follow from what
moves, as in `border.py`; the edge's own place is x_c. It counts by half: see `curve/contacts.py`.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.curve.contacts import resting_among
from torch_radbp.boundary.curve.film_term import lanes
from torch_radbp.boundary.curve.geometry import Geometry, geometry_of, positions
from torch_radbp.boundary.curve.inner_lines import segment_place, segment_weight
from torch_radbp.boundary.curve.places import Places, Sight, lot_of, on_film, sight_of
from torch_radbp.boundary.curve.segments import place_of
from torch_radbp.boundary.eye.light_points import light_line, light_points
from torch_radbp.boundary.eye.seen_edges import BEFORE, BESIDE, FAR, crossed_at
from torch_radbp.boundary.eye.seen_on_film import camera_sample, seen_at, sees
from torch_radbp.boundary.terms.border import SHARE
from torch_radbp.boundary.terms.call_traits import films_have_area
from torch_radbp.boundary.terms.lit_edges import samples_of
from torch_radbp.boundary.terms.shadow_term import CutOff, ShadowTerm, shadow_term
from torch_radbp.call.render_call import RenderCall, integrand_of, started
from torch_radbp.path.direct_light import LightDraw, light_sent_back
from torch_radbp.path.event import Ends
from torch_radbp.raycast.protocol import Hit
from torch_radbp.sampling.running_sum import running_sum
from torch_radbp.scene.tables.scene_tensors import SceneTensors, extent_of
from torch_radbp.tensors.vec import TINY, Ray, Vec2, Vec3, cross, dot, interpolated, normalize, rows, unit_normal


class Strips(NamedTuple):
    """K samples on edges that rest on surfaces, each with a light sample; detached."""

    places: Places  # on the triangles at the edges
    draw: LightDraw
    surface: Hit  # on what the edges lie, there


@shadow_term
class OpeningStrips(ShadowTerm):
    """The boundary term of strips that become visible below edges which rest on a surface, when these rise."""

    rank = 2
    needs = "casting", "crossing"

    def applies(self) -> bool:
        return films_have_area(self.call) and self.call.integrand.settings.nee

    def samples(self, number: int) -> CutOff | None:
        call, contacts = self.still, resting_among(self.crossing)
        if contacts is None:
            return None
        view, scene, geometry = call.views[number], call.scene, geometry_of(call.scene)
        sight = sight_of(view, ())
        weight = call.stages(segment_weight)(geometry, sight, contacts)
        if not bool((weight > 0.0).any()):
            return None
        count = samples_of(call, view, SHARE)
        places = call.stages(segment_place)(geometry, sight, contacts, lot_of(weight, count, running_sum(weight)),
                                           lanes(count, weight))
        draw = light_points(call.stages, scene, view, count).draw
        counted = (places.counts & ((places.normal.x != 0.0) | (places.normal.y != 0.0))).nonzero().squeeze(1)
        places, draw = rows((places, draw), counted)
        integrand = integrand_of(call, call.integrand, number)
        line = integrand.part(Ends.SURROUNDINGS).call(light_line, places.p, draw)
        across = across_edge(geometry, sight, places, line[1] * -1.0)
        film = _beside(sight, places, across.outwards, extent_of(geometry))
        sample = camera_sample(call, view, film, places.aperture, places.key)
        corners = place_of(geometry, places.through, places.shown_by)
        u, v = crossed_at(corners, Ray(places.p, across.upwards))
        dtype = scene.dtype
        surface = Hit(places.through, u.to(dtype), v.to(dtype), torch.zeros_like(u, dtype=dtype), places.shown_by)
        kept = (across.counts & sees(integrand, sample.ray, surface, places.p)).nonzero().squeeze(1)
        places, draw, sample, surface, across, line, film = rows((places, draw, sample, surface, across, line, film), kept)
        kept = lit(call, places, across, line, extent_of(geometry)).nonzero().squeeze(1)
        places, draw, sample, surface, across, film = rows((places, draw, sample, surface, across, film), kept)
        if not len(kept):
            return None
        light = light_sent_back(integrand, started(call, sample), seen_at(surface, sample.ray, places.p), draw)
        light = light if sample.weight is None else light * sample.weight
        aside, normal = Vec2(film.x - places.film.x, film.y - places.film.y), places.normal
        outwards = torch.sign(aside.x * normal.x + aside.y * normal.y)
        strength = torch.stack(tuple(light)).double() * torch.where(across.through, 1.0, -1.0)
        return CutOff(places.film, normal * outwards, strength, Strips(places, draw, surface))

    def seen(self, number: int, geometry: Geometry, found: CutOff) -> Vec2:
        camera, places = self.call.views[number].camera, found.samples.places
        p = places.at(geometry)
        light_end = on_film(camera, shadow_of(self.call.scene, geometry, found.samples, p), places.aperture)
        sight_end = on_film(camera, p, places.aperture)
        return Vec2(light_end.x - sight_end.x, light_end.y - sight_end.y)


def shadow_of(scene: SceneTensors, geometry: Geometry, strips: Strips, p: Vec3) -> Vec3:
    """The points at which light through p, (N,), meets the surface below the edge; (N,) world, attached."""
    start, d, _ = light_line(scene, p, strips.draw)
    corners = place_of(geometry, strips.surface.prim, strips.surface.instance)
    return interpolated(corners, *crossed_at(corners, Ray(start, d)))


class AcrossEdge(NamedTuple):
    """The directions in the plane perpendicular to edges at N samples; detached."""

    outwards: Vec3  # unit, along the surface, away from the body, towards the camera
    upwards: Vec3  # unit normal of the surface
    aside: Vec3  # unit, along the surface towards the light
    counts: Tensor  # (N,) bool: the shadow border becomes visible beside the edge when it rises
    through: Tensor  # (N,) bool: light comes from behind the edge's triangle


def across_edge(geometry: Geometry, sight: Sight, places: Places, to_light: Vec3) -> AcrossEdge:
    """The directions perpendicular to edges that rest on surfaces, at samples, and whether strips become visible there.

    Args:
        geometry, sight: of the scene and the camera, detached.
        places: the samples.
        to_light: (N,) directions from them, of any length.
    """
    corners = positions(geometry, places.between, places.instance)
    passed = place_of(geometry, places.through, places.shown_by)
    to_camera = sight.camera.kind.towards(sight.camera.lens, places.p, places.aperture)
    plane, upwards = (unit_normal(own[1] - own[0], own[2] - own[0]) for own in (corners, passed))
    along = normalize(cross(plane, upwards))
    upwards = upwards * torch.sign(dot(upwards, to_camera))
    outwards = cross(along, upwards)
    outwards = outwards * torch.sign(dot(plane, to_camera) * dot(plane, outwards))
    through = dot(plane, to_camera) * dot(plane, to_light) < 0.0
    (c_x, c_y), (l_x, l_y) = ((dot(outwards, d), dot(upwards, d)) for d in (to_camera, to_light))
    counts = (c_y > 0.0) & (l_y > 0.0) & (l_x * c_y < c_x * l_y)
    return AcrossEdge(outwards, upwards, outwards * torch.where(through, -1.0, 1.0), counts, through)


def _beside(sight: Sight, places: Places, outwards: Vec3, extent: Tensor) -> Vec2:
    """The film positions of points right beside samples, where the surface below is visible."""
    return on_film(sight.camera, places.p + outwards * (BESIDE * extent), places.aperture)


def lit(call: RenderCall, places: Places, across: AcrossEdge, line: tuple[Vec3, Vec3, Tensor], extent: Tensor) -> Tensor:
    """(N,) bool: the light sample is visible from the point right beside the edge, on the lit side."""
    start, d, parallel = line
    length = torch.sqrt(dot(d, d)).clamp_min(TINY)
    o = places.p + (across.aside + across.upwards) * (BESIDE * extent)
    dtype = call.scene.dtype
    ray = Ray(*(part.map(lambda c: c.to(dtype).contiguous()) for part in (o, d * (-1.0 / length))))
    return ~call.integrand.caster.occluded(ray, torch.where(parallel, FAR, length * (1.0 - BEFORE)).to(dtype))
