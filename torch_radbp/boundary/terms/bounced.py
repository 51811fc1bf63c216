"""Boundary term of shadows at later path vertices: borders of the light of light samples.

The light of one light sample has hard borders on every surface that a path meets. Those on the first are counted in
`border.py`. On the next, x_{k+1}, glued to its surface, what vertex x_k receives from there is

    integral of f |cos x_k| |cos x_{k+1}| / r^2  L(x_{k+1}) dA

and L jumps at the border, which moves over the surface as it does over the film there; the points of a surface close to x_k
slide (`eye/slid.py`). Each place on a border is connected to one vertex of a path, which says where along the edge it
lies (`spread_borders.py`).

Paths rarely meet the half shadow of a small lamp, and see it past an edge from there: found so (`hidden_light.py`), few
samples would hold nearly all of the variance. Here all of them lie on borders.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.curve.geometry import Geometry, geometry_of
from torch_radbp.boundary.curve.outline import Outline
from torch_radbp.boundary.eye.lines_through_edges import height_over_plane, scattered_towards, solid_angle
from torch_radbp.boundary.eye.lit_behind import light_sent_past, lit_surfaces, sees_receivers
from torch_radbp.boundary.eye.past_edges import leaving_towards
from torch_radbp.boundary.eye.seen_edges import BEFORE, Passed, corners_of, course_of, crossed_at, uniform_numbers
from torch_radbp.boundary.eye.slid import less_what_slides
from torch_radbp.boundary.eye.viewpoints import PathBatch, Viewpoints, path_of, vertex_at, viewpoints
from torch_radbp.boundary.terms.border import Borders, light_through, shadows_cast
from torch_radbp.boundary.terms.call_traits import glues
from torch_radbp.boundary.terms.covered_lights import Lights
from torch_radbp.boundary.terms.lit_edges import EdgesFromLights, samples_of
from torch_radbp.boundary.terms.shadow_term import CutOff, ShadowTerm, TermSize, cut_off, shadow_term
from torch_radbp.boundary.terms.spread_borders import spread_borders
from torch_radbp.call.render_call import RenderCall, integrand_of
from torch_radbp.path.direct_light import light_sent_back
from torch_radbp.path.event import Ends
from torch_radbp.path.integrand import Integrand
from torch_radbp.raycast.protocol import Hit
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.tensors.vec import TINY, Ray, Vec2, Vec3, dot, interpolated, rows

SHARE = 16  # one place for so many paths of the image
SALT = 0x2B3E6C1F  # tells the random numbers that connect borders with paths from others


class ConnectedBorders(NamedTuple):
    """K samples on shadow borders, each connected to a path vertex that sees it; detached."""

    points: Viewpoints  # the path vertices
    start: Vec3  # their world positions
    borders: Borders


@shadow_term
class BouncedShadows(ShadowTerm):
    """The boundary term of shadow borders on surfaces that path vertices see, for light of light samples."""

    rank = 5
    through_media = True

    @classmethod
    def size(cls, call: RenderCall) -> TermSize:
        samples = bounced_samples(call) if glues(call) and borders_bounce(call) else 0
        return TermSize(0, samples, samples)

    def applies(self) -> bool:
        return glues(self.call) and borders_bounce(self.call)

    def samples(self, number: int) -> CutOff | None:
        call, casting = self.still, self.casting
        pairs = pairs_of(self.from_lights, number, Lights.bounced(call), False)
        if pairs is None:
            return None
        points, start, borders, inwards, times, passed = pairs
        scene, geometry, integrand = call.scene, geometry_of(call.scene), integrand_of(call, call.integrand, number)
        course = course_of(partial(on_receiver, scene, geometry, casting.outline, borders), times, inwards)
        here = course.at
        way = way_to(start, interpolated(corners_of(geometry, borders.receiver), here.x, here.y), scene.dtype)
        light = light_sent_on(call, integrand, points, borders, way, passed)
        beta = points.beta * scattered_towards(call, integrand, points, way.reach)
        light = light * torch.stack(tuple(beta)).double() * solid_angle(scene, borders.receiver, Ray(start, way.reach))
        return cut_off(points.place, course, light, ConnectedBorders(points, start, borders))

    def seen(self, number: int, geometry: Geometry, found: CutOff) -> Vec2:
        points, start, borders = found.samples
        seen = on_receiver(self.call.scene, geometry, self.casting.outline, borders)
        return less_what_slides(self.call, number, geometry, points, start, borders.receiver, seen)


def on_receiver(scene: SceneTensors, geometry: Geometry, outline: Outline, borders: Borders, step: Tensor | float = 0.0,
                off: Vec3 | None = None) -> Vec2:
    """The barycentric coordinates at which shadows end on receivers, (N,), attached; args as for `border`."""
    return crossed_at(corners_of(geometry, borders.receiver), light_through(scene, geometry, outline, borders, step, off))


class ConnectedPlaces(NamedTuple):
    """N samples on shadow borders, each paired with a path vertex, with weights; detached."""

    points: Viewpoints  # the path vertices
    start: Vec3  # their world positions
    borders: Borders
    inwards: Vec3  # as of `CastShadows`
    times: Tensor  # weight: edges per light sample times paths that a pair stands for
    passed: Passed  # the edges


def borders_bounce(call: RenderCall) -> bool:
    """True if there are lights whose shadow borders are sampled at later path vertices."""
    return any(map(Lights.bounced(call).covers, call.scene.layout.lights))


def bounced_samples(call: RenderCall) -> int:
    """The greatest number of samples on shadow borders at later path vertices, for a view."""
    return max(samples_of(call, view, SHARE) for view in call.views)


def pairs_of(edges: EdgesFromLights, number: int, lights: Lights, following: bool) -> ConnectedPlaces | None:
    """Samples shadow borders, each paired with a path vertex of view `number`; None: there are none.

    Args:
        edges: the edges that cast shadows.
        number, lights: as for `lit_edges`.
        following: as for `viewpoints`.
    """
    call, casting, lit = edges.call, edges.casting, edges.lit(number, lights, SHARE)
    if lit is None:
        return None
    integrand, geometry, count = integrand_of(call, call.integrand, number), geometry_of(call.scene), len(lit.passed.edge)
    points = viewpoints(call, number, integrand._replace(max_depth=integrand.max_depth - 1), PathBatch(count), following)
    if not len(points.depth):
        return None
    place = torch.arange(count, dtype=torch.int32, device=call.scene.device)
    pick, choice, turn = (uniform_numbers(call.views[number].sample_keys[1], place, SALT + which, torch.float64)
                          for which in range(3))
    connected = (pick * len(points.depth)).long()
    start = rows(vertex_at(call, geometry, number, points), connected)
    passed = spread_borders(call, casting.outline, lit, start, choice, turn)
    kept, receiver = lit_surfaces(call, casting.outline, passed)
    _, height = height_over_plane(corners_of(geometry, receiver), rows(start, kept))
    seen = (height > 0).nonzero().squeeze(1)  # nothing of a floor is seen from the floor
    if not len(seen):
        return None
    kept, receiver = kept[seen], rows(receiver, seen)
    borders, passed, inwards, times = shadows_cast(geometry, lit, rows(passed, kept), receiver)
    return ConnectedPlaces(rows(points, connected[kept]), rows(start, kept), borders, inwards, times * len(points.depth),
                           passed)


class Way(NamedTuple):
    """The connections from path vertices to points on borders, (N,)."""

    ray: Ray  # in the rays' dtype
    reach: Vec3  # vector, float64
    distance: Tensor  # float64

    def meets(self, borders: Borders) -> Hit:
        """The triangles on which shadow borders lie, as hits of the rays that connect path vertices to them."""
        return borders.receiver._replace(t=self.distance.to(self.ray.d.x.dtype))


def way_to(start: Vec3, x: Vec3, dtype: torch.dtype) -> Way:
    """The connection from `start` to `x`, (N,) world each; `dtype`: of rays."""
    reach = x - start
    distance = torch.sqrt(dot(reach, reach).clamp_min(TINY))
    ray = Ray(*(part.map(lambda c: c.to(dtype).contiguous()) for part in (start, reach / distance)))
    return Way(ray, reach, distance)


def light_sent_on(call: RenderCall, integrand: Integrand, points: Viewpoints, borders: Borders, way: Way,
                  passed: Passed) -> Tensor:
    """(3, N) float64 radiance that path vertices receive from the lit side of shadow borders.

    Args:
        points: the vertices.
        borders: the borders.
        way: the connections to these.
        passed: the edges that light passes on its way to the borders.
    """
    dtype, key = integrand.proposal.dtype, passed.key
    if integrand.proposal.layout.traces_segments:
        p = way.ray.o.map(torch.Tensor.double) + way.reach
        part, depth = integrand.part(Ends.SURROUNDINGS), int(points.depth.max()) + 1
        ray, medium = part.call(leaving_towards, points.ray, points.hit, points.flight, p.map(lambda c: c.to(dtype)))
        state = path_of(call, ray, key)._replace(medium=medium)
        shown, flight = sees_receivers(integrand, state, borders.receiver, p, depth)
        found = light_sent_past(integrand, state, way.meets(borders), flight, borders.draw, passed, depth)
        return torch.zeros(3, len(p.x), dtype=torch.float64, device=p.x.device).index_copy(
            1, shown, torch.stack(tuple(found)).double()[:, shown])
    o = (way.ray.o.map(torch.Tensor.double) + way.reach * BEFORE).map(lambda c: c.to(dtype).contiguous())
    free = ~integrand.caster.occluded(Ray(o, way.ray.d), (way.distance * (1.0 - 2.0 * BEFORE)).to(dtype))
    light = light_sent_back(integrand, path_of(call, way.ray, key), way.meets(borders), borders.draw)
    return torch.stack(tuple(light)).double() * free
