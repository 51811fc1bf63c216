"""Boundary term of direct shadows: borders on surfaces that the camera sees.

The image is the mean over random numbers of what one light sample each adds to it. For given numbers a sample is a point of
a light, glued to it, or a direction; it lights a part of what is seen, and at the border of the shadow that an edge casts
the image of this light jumps. There it changes as at any curve on the film (`primary.py`): by

    dI = integral of h (L_behind - L_ahead) v . n dl

with v the velocity of the border on the film. It follows from the points that move: the border lies where the line from the
light's point y through the point p of the edge meets the plane of the receiver, and is seen by the camera. So it is the same
for moving lights, blockers, receivers and cameras, and for all samplings but those whose directions towards a light of some
extent carry derivatives.

From each light sample edges that are silhouettes from there are looked for by a tree (`eye/edge_tree.py`), unless edges are
so few that all can be tried (`eye/edges_tried.py`).

References: Li, Aittala, Durand and Lehtinen 2018, "Differentiable Monte Carlo Ray Tracing through Edge Sampling", section 4;
Zhang, Miller, Yan, Gkioulekas and Zhao 2020, "Path-Space Differentiable Rendering", section 5 (samples that start at edges).
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.adjoint.forward_mode import has_tangents
from torch_radbp.boundary.curve.edge_order import GROUP
from torch_radbp.boundary.curve.geometry import Geometry, geometry_of
from torch_radbp.boundary.curve.outline import Outline
from torch_radbp.boundary.curve.places import on_film
from torch_radbp.boundary.curve.rendering import Rendering
from torch_radbp.boundary.curve.silhouette import crosses_view
from torch_radbp.boundary.eye.light_points import light_line
from torch_radbp.boundary.eye.lit_behind import light_sent_past, lit_surfaces, sees_receivers
from torch_radbp.boundary.eye.lit_sides import motion_of_surface
from torch_radbp.boundary.eye.seen_edges import (
    BESIDE,
    Course,
    Passed,
    corners_of,
    course_of,
    crossed_at,
    point_of_edge,
)
from torch_radbp.boundary.eye.seen_on_film import aperture_of, camera_sample, into_shade, seen_at
from torch_radbp.boundary.eye.viewpoints import path_of
from torch_radbp.boundary.terms.call_traits import films_have_area
from torch_radbp.boundary.terms.covered_lights import Lights
from torch_radbp.boundary.terms.lit_edges import LOOKS, EdgesFromLights, LitEdges, samples_of
from torch_radbp.boundary.terms.shadow_term import CutOff, ShadowTerm, TermSize, cut_off, shadow_term
from torch_radbp.call.render_call import RenderCall, integrand_of, started
from torch_radbp.path.direct_light import LightDraw, light_sent_back
from torch_radbp.path.event import Ends
from torch_radbp.path.light_share import ends_lamp_paths
from torch_radbp.raycast.protocol import Hit
from torch_radbp.scene.tables.part import part_of
from torch_radbp.scene.tables.scene_tensors import SceneTensors, extent_of
from torch_radbp.sensor.kind import Camera
from torch_radbp.tensors.stage import EAGER, stage
from torch_radbp.tensors.vec import Ray, Vec2, Vec3, interpolated, max_component, rows

SHARE = 16  # one place for so many paths of the image
SHARP_SHARE = 4  # the same where some lights have no extent: all that shadows move by lies on their borders
FEW = 1024  # light samples of a warning
BYTES_OF_TRIED = 20, 240  # an edge that is tried from a light sample: in fused loops, in plain torch


class Borders(NamedTuple):
    """N samples on shadow borders: where light that passes an edge meets its receiver; detached."""

    edge: Tensor  # (N,) int32, casting edge of the outline
    along: Tensor  # (N,) float64, position along the edge, from a to b
    draw: LightDraw
    receiver: Hit  # the point on which the border falls


class CastShadows(NamedTuple):
    """N samples on shadow borders, with the edges that cast these, and weights."""

    borders: Borders
    passed: Passed  # how light passes the edges
    inwards: Vec3  # motion by which points right beside the edges come into shadow
    times: Tensor  # weight: the number of edges that a sample stands for, per light sample


class BordersInView(NamedTuple):
    """K samples on shadow borders that the camera of a view sees; detached."""

    borders: Borders
    aperture: Vec2 | None  # of the rays that see them


@shadow_term
class DirectShadows(ShadowTerm):
    """The boundary term of shadow borders on surfaces that the camera sees."""

    rank = 0

    @classmethod
    def size(cls, call: RenderCall) -> TermSize:
        samples = most_samples(call)
        return TermSize(samples * LOOKS * GROUP * BYTES_OF_TRIED[not call.stages.is_compiled], samples, samples)

    through_media = True

    def applies(self) -> bool:
        return films_have_area(self.call)

    def samples(self, number: int) -> CutOff | None:
        call, outline = self.still, self.casting.outline
        view, scene = call.views[number], call.scene
        found = borders_of(self.from_lights, number, Lights.covered(call), share_of(scene))
        if found is None:
            return None
        borders, passed, inwards, times = found
        integrand = integrand_of(call, call.integrand, number)
        geometry, camera, aperture = geometry_of(scene), view.camera, aperture_of(view, passed.key)
        on_border, course = integrand.part(Ends.SURROUNDINGS).call(border_course, geometry, outline, camera, borders,
                                                                   inwards, times, aperture)
        counted = ((course.normal.x != 0.0) | (course.normal.y != 0.0)).nonzero().squeeze(1)
        own, course, on_border, passed = rows((BordersInView(borders, aperture), course, on_border, passed), counted)
        sample = camera_sample(call, view, course.at, own.aperture, passed.key)
        shown, flight = sees_receivers(integrand, started(call, sample), own.borders.receiver, on_border, 0)
        own, course, on_border, passed, sample, flight = rows((own, course, on_border, passed, sample, flight), shown)
        in_shade = camera_sample(call, view, into_shade(camera, course.at, course.aside), own.aperture, passed.key)
        shown, _ = sees_receivers(integrand, started(call, in_shade), own.borders.receiver, on_border, 0)
        if not len(shown):
            return None
        own, course, on_border, sample, flight, passed = rows((own, course, on_border, sample, flight, passed), shown)
        hit = seen_at(own.borders.receiver, sample.ray, on_border)
        light = light_sent_past(integrand, started(call, sample), hit, flight, own.borders.draw, passed, 0)
        light = light if sample.weight is None else light * sample.weight
        return cut_off(course.at, course, torch.stack(tuple(light)).double(), own)

    def left_out(self, rendering: Rendering) -> set[str]:
        if rendering.shadows and rendering.has_area:
            return set()
        call, outline, view = self.still, self.casting.outline, self.still.views[0]
        lights = Lights.covered(call)._replace(sharp=call.integrand.settings.nee)
        found = borders_of(self.from_lights, 0, lights, max(1, call.spp * view.width * view.height // FEW))
        if found is None:
            return set()
        borders, passed = found.borders, found.passed
        light = light_sent_back(call.integrand, path_of(call, passed.onwards, passed.key), borders.receiver, borders.draw)
        p = border(call.scene, geometry_of(call.scene), outline, borders)
        seen = torch.stack([crosses_view(p, p, sight) for sight in rendering.sights]) & (max_component(light) > 0.0)
        borders = rows(borders, seen.any(0).nonzero().squeeze(1))
        lamps = [rendering.light_movers[element] for element in borders.draw.picked.element.unique().tolist()]
        cameras = [names for names, own in zip(rendering.camera_movers, seen) if own.any()]
        return rendering.movers_at(outline.triangle(borders.edge), borders.receiver.prim).union(*lamps, *cameras)

    def seen(self, number: int, geometry: Geometry, found: CutOff) -> Vec2:
        borders, aperture = found.samples
        forward_mode = has_tangents((geometry, self.call.scene, self.call.views[number].camera))
        seen = (self.call.stages if forward_mode else EAGER)(border_on_film)(
            part_of(self.call.scene, None, Ends.SURROUNDINGS.vertex), geometry, self.casting.outline,
            self.call.views[number].camera, borders, aperture)
        if self.call.camera_share is None:
            return seen
        moved = motion_of_surface(self.call, number, geometry, borders.receiver, aperture)
        lit_from_lamps = ends_lamp_paths(self.call.camera_share.integrand.scene, borders.receiver.prim)
        return Vec2(*(place - torch.where(lit_from_lamps, own, 0.0) for place, own in zip(seen, moved)))


def border(scene: SceneTensors, geometry: Geometry, outline: Outline, borders: Borders, step: Tensor | float = 0.0,
           off: Vec3 | None = None) -> Vec3:
    """The points at which the shadows of edges end on their receivers' planes, (N,) world, attached.

    Args:
        scene: attached.
        geometry: of the scene, attached.
        outline: the edges.
        borders: the samples.
        step: a shift of the samples along the edges, as a share of their lengths.
        off: (N,) a shift of the samples off the edges; None: none.
    """
    corners = corners_of(geometry, borders.receiver)
    return interpolated(corners, *crossed_at(corners, light_through(scene, geometry, outline, borders, step, off)))


def light_through(scene: SceneTensors, geometry: Geometry, outline: Outline, borders: Borders, step: Tensor | float,
                  off: Vec3 | None) -> Ray:
    """The rays of light that pass edges on their way to receivers; args as for `border`."""
    p = point_of_edge(geometry, outline, borders.edge, borders.along + step)
    start, d, _ = light_line(scene, p if off is None else p + off, borders.draw)
    return Ray(start, d)


def share_of(scene: SceneTensors) -> int:
    """The number of image paths for each sample on shadow borders."""
    return SHARP_SHARE if any(kind.delta for kind in scene.layout.lights) else SHARE


def most_samples(call: RenderCall) -> int:
    """The greatest number of samples on direct shadow borders for a view."""
    return max(samples_of(call, view, share_of(call.scene)) for view in call.views)


def shadows_cast(geometry: Geometry, lit: LitEdges, passed: Passed, receiver: Hit) -> CastShadows:
    """The shadow borders of samples on edges; `receiver`: the surfaces on which the light falls beyond these."""
    borders = Borders(passed.edge, passed.along, rows(lit.draw, passed.eye), receiver)
    return CastShadows(borders, passed, passed.outwards * (-BESIDE * extent_of(geometry)), passed.times / lit.count)


def borders_of(edges: EdgesFromLights, number: int, lights: Lights, share: int) -> CastShadows | None:
    """Samples shadow borders, visible to view `number` or not; None: there are none. Other args as for `lit_edges`."""
    call, lit = edges.call, edges.lit(number, lights, share)
    if lit is None:
        return None
    kept, receiver = lit_surfaces(call, edges.casting.outline, lit.passed)
    passed = rows(lit.passed, kept)
    return shadows_cast(geometry_of(call.scene), lit, passed, receiver) if len(passed.edge) else None


@stage("scene", "geometry", "outline", "camera")
def border_on_film(scene: SceneTensors, geometry: Geometry, outline: Outline, camera: Camera, borders: Borders,
                   aperture: Vec2 | None) -> Vec2:
    """The film positions of shadow borders, (N,) pixels, attached; args as for `border_course`, attached."""
    return on_film(camera, border(scene, geometry, outline, borders), aperture)


@stage("scene", "geometry", "outline", "camera")
def border_course(scene: SceneTensors, geometry: Geometry, outline: Outline, camera: Camera, borders: Borders,
                  inwards: Vec3, times: Tensor, aperture: Vec2 | None) -> tuple[Vec3, Course]:
    """The points of shadow borders, world; and their film positions and normals, 0 outside of all pixels, and areas swept.

    Args:
        scene, geometry, outline, borders: as for `border`, detached.
        camera: the camera that sees them.
        inwards, times: (N,) as of `CastShadows`.
        aperture: (N,) points of the lens.
    """
    def seen(step: Tensor | float = 0.0, off: Vec3 | None = None) -> Vec2:
        return on_film(camera, border(scene, geometry, outline, borders, step, off), aperture)

    course = course_of(seen, times, inwards)
    counts = camera.film.sees(course.at)
    return border(scene, geometry, outline, borders), course._replace(
        normal=course.normal.map(lambda c: torch.where(counts, c, 0.0)))
