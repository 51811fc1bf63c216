"""Boundary term of shadows in media: shafts of light.

At a point y of a medium light from a point or a single direction is there or is not, and ends at the sheets behind edges.
Light of lamps with extent is the mean of that of their points, and light of the environment of that of its directions.
With f(y) what the medium scatters there of it towards a vertex x and the view, per unit of volume, an image changes by

    dI = - integral of f(y) (v - u) . n dA

over the sheets, whose normal n points into the light, with v the velocity of the sheet and u that of the medium's points,
which keep their share of the way from x to the surface behind. The vertices x are cameras, and vertices of paths.

References: Zhang, Miller, Yan, Gkioulekas and Zhao 2020, "Path-Space Differentiable Rendering", section 5; Zhang, Yu and
Zhao 2021, "Path-Space Differentiable Rendering of Participating Media".
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.curve.geometry import Geometry, geometry_of
from torch_radbp.boundary.curve.places import on_film, velocities_on_film
from torch_radbp.boundary.eye.deposit import Deposit, attached_geometry
from torch_radbp.boundary.eye.lines_through_edges import scattered_towards
from torch_radbp.boundary.eye.past_edges import leaving_towards
from torch_radbp.boundary.eye.seen_edges import corners_of, salted, uniform_numbers
from torch_radbp.boundary.eye.seen_on_film import aperture_of, camera_sample
from torch_radbp.boundary.eye.slid import what_slides
from torch_radbp.boundary.eye.viewpoints import PathBatch, Viewpoints, flown_along, path_of, vertex_at, viewpoints
from torch_radbp.boundary.terms.border import share_of
from torch_radbp.boundary.terms.call_traits import films_have_area, glues
from torch_radbp.boundary.terms.covered_lights import Lights
from torch_radbp.boundary.terms.lit_edges import EdgesFromLights, samples_of
from torch_radbp.boundary.terms.shadow_sheets import SampledSheets, SheetPoints, sampled_sheets
from torch_radbp.boundary.terms.shadow_term import ShadowTerm, TermSize, shadow_term
from torch_radbp.boundary.terms.spread_borders import spread_sheets
from torch_radbp.call.render_call import RenderCall, integrand_of, started
from torch_radbp.path.direct_light import light_sent_back
from torch_radbp.path.event import Ends
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.sorting import first_hit
from torch_radbp.path.state import Flight, PathState
from torch_radbp.path.through_media import free_ways, let_through
from torch_radbp.raycast.protocol import Hit
from torch_radbp.sampling.sampler import LaneKey
from torch_radbp.tensors.differentiated import detached, primal
from torch_radbp.tensors.vec import TINY, Frame, Ray, Vec2, Vec3, dot, interpolated, normalize, rows, where
from torch_radbp.vertex.interaction import is_met

SALT = 0x7A1D3B65  # tells the random numbers of these paths from others


class LitInMedium(NamedTuple):
    """The light that media scatter towards viewpoints right beside sheets of shadow; (N,), detached."""

    light: Tensor  # (3, N) float64, radiance per length of the ray; 0: none
    ray: Ray  # from the vertex to the point
    behind: Hit  # the surface behind it
    flight: Flight  # from the vertex to the point


class SeenFromCamera(NamedTuple):
    """The film points and keys of camera rays that see K points in media; detached."""

    film: Vec2  # where they pass the film
    aperture: Vec2 | None  # and the lens
    key: LaneKey  # of random numbers

    def rays(self, call: RenderCall, number: int, geometry: Geometry, lit: LitInMedium) -> Ray:
        """The camera rays, (K,), attached; args as for `carried`."""
        return camera_sample(call, call.views[number], self.film, self.aperture, self.key).ray


class SeenFromVertices(NamedTuple):
    """The path vertices that see K points in media; detached."""

    points: Viewpoints

    @property
    def key(self) -> LaneKey:
        """The keys of the paths' random numbers."""
        return self.points.key

    def rays(self, call: RenderCall, number: int, geometry: Geometry, lit: LitInMedium) -> Ray:
        """The rays to the points, (K,), attached; their directions are fixed to the surfaces behind. Args as for
        `carried`."""
        met = is_met(detached(call.scene), lit.behind)
        behind = lit.behind._replace(prim=torch.where(met, lit.behind.prim, -1))
        x, place = vertex_at(call, geometry, number, self.points), Vec2(behind.u.double(), behind.v.double())
        near, ways = what_slides(call, number, geometry, self.points, x.map(primal), behind, place)
        place = Vec2(*(part.index_add(0, near, way) for part, way in zip(place, ways)))
        towards = normalize(interpolated(corners_of(geometry, behind), place.x, place.y) - x)
        d = where(met, towards, lit.ray.d.map(torch.Tensor.double))
        return Ray(*(part.map(lambda c: c.to(call.scene.dtype)) for part in (x, d)))


class ShaftsInView(NamedTuple):
    """K points on sheets between light and shadow that a view sees; detached."""

    place: Vec2  # on the film
    strength: Tensor  # (3, K) float64, light gained per volume that the sheet sweeps
    area: Vec3  # as of `SampledSheets`
    points: SheetPoints
    lit: LitInMedium
    seen_from: SeenFromCamera | SeenFromVertices


@shadow_term
class Shafts(ShadowTerm):
    """The boundary term of sheets between light and shadow in media, as cameras and path vertices see them."""

    rank = 9
    through_media = True

    @classmethod
    def size(cls, call: RenderCall) -> TermSize:
        if not has_shafts(call):
            return TermSize()
        samples = 2 * max(samples_of(call, view, share_of(call.scene)) for view in call.views)
        return TermSize(found=samples, kept=samples)

    def applies(self) -> bool:
        return has_shafts(self.call)

    def samples(self, number: int) -> list[ShaftsInView]:
        found = [seen_by_camera(self.from_lights, number)] if films_have_area(self.still) else []
        if self.still.integrand.max_depth > 2:
            found.append(seen_by_vertices(self.from_lights, number))
        return [own for own in found if own is not None]

    def jumps(self, number: int, found: list[ShaftsInView]) -> list[Deposit]:
        call, geometry = self.call, attached_geometry(self.call.scene)
        deposits = []
        for own in found:
            sheet = own.points.at(call.scene, geometry, self.casting.outline)
            apart = sheet - carried(call, number, geometry, own)
            deposits.append(Deposit(own.place, own.strength.unbind(), dot(apart - apart.map(primal), own.area)))
        return deposits


def has_shafts(call: RenderCall) -> bool:
    """True if media scatter light of lights whose shafts are sampled."""
    integrand, layout = call.integrand, call.scene.layout
    return glues(call) and bool(layout.scattering_media) and integrand.max_depth > 1 and bool(
        Lights.with_shafts(call).of(call.scene).any())


def seen_by_camera(edges: EdgesFromLights, number: int) -> ShaftsInView | None:
    """Samples points on sheets between light and shadow that the camera of view `number` sees; None: there are none."""
    call, casting = edges.call, edges.casting
    lit = edges.lit(number, Lights.with_shafts(call), share_of(call.scene))
    if lit is None:
        return None
    view, integrand = call.views[number], integrand_of(call, call.integrand, number)
    eye = view.camera.kind.eye(view.camera.lens)
    place = eye[:3] if eye[3] > 0 else torch.stack(tuple(geometry_of(call.scene).triangles.vertices.p)).double().mean(1)
    one = torch.ones_like(lit.passed.along)
    sheets = sampled_sheets(call, number, casting, lit, Vec3(*(one * coordinate for coordinate in place)))
    if sheets is None:
        return None
    aperture, key = aperture_of(view, sheets.passed.key), sheets.passed.key
    film = on_film(view.camera, sheets.p, aperture)
    counted = view.camera.film.sees(film).nonzero().squeeze(1)
    sheets, film, aperture, key = rows((sheets, film, aperture, key), counted)
    if not len(counted):
        return None
    sample = camera_sample(call, view, film, aperture, key)
    lit_there = lit_in_medium(integrand, started(call, sample), sheets, 0)
    # f per volume: radiance per length, times the area of the film per area across the ray.
    frame = Frame.of(sample.ray.d.map(torch.Tensor.double))
    s, t = velocities_on_film(view.camera, sheets.p, (frame.s, frame.t), aperture)
    strength = lit_there.light * (s.x * t.y - s.y * t.x).abs()
    strength = strength if sample.weight is None else strength * sample.weight.double()
    return lit_ones(film, strength, sheets, lit_there, SeenFromCamera(film, aperture, key))


def seen_by_vertices(edges: EdgesFromLights, number: int) -> ShaftsInView | None:
    """Samples points on sheets between light and shadow that path vertices of view `number` see; None: there are none."""
    call, casting = edges.call, edges.casting
    lit = edges.lit(number, Lights.with_shafts(call), share_of(call.scene))
    if lit is None:
        return None
    view, integrand, count = call.views[number], integrand_of(call, call.integrand, number), len(lit.passed.edge)
    points = viewpoints(call, number, integrand._replace(max_depth=integrand.max_depth - 1), PathBatch(count))
    if not len(points.depth):
        return None
    # Pair each place on an edge with a vertex.
    place = torch.arange(count, dtype=torch.int32, device=call.scene.device)
    pick, choice, turn = (uniform_numbers(salted(view, SALT), place, SALT + which, torch.float64) for which in range(3))
    own, paths = rows(points, (pick * len(points.depth)).long()), len(points.depth)
    start = vertex_at(call, geometry_of(call.scene), number, own)
    lit = lit._replace(passed=spread_sheets(call, casting.outline, lit, start, choice, turn))
    sheets = sampled_sheets(call, number, casting, lit, start)
    if sheets is None:
        return None
    own = rows(own, sheets.number)
    ray, medium = integrand.part(Ends.SURROUNDINGS).call(leaving_towards, own.ray, own.hit, own.flight, sheets.lit)
    found = lit_in_medium(integrand, path_of(call, ray, sheets.passed.key)._replace(medium=medium), sheets,
                          int(own.depth.max()) + 1)
    reach = sheets.lit - ray.o
    beta = own.beta * scattered_towards(call, integrand, own, reach.map(torch.Tensor.double))
    squared = dot(reach, reach).double().clamp_min(TINY)
    strength = found.light * torch.stack(tuple(beta)).double() * (paths / squared)
    return lit_ones(own.place, strength, sheets, found, SeenFromVertices(own))


def lit_ones(place: Vec2, strength: Tensor, sheets: SampledSheets, lit: LitInMedium,
             seen_from: SeenFromCamera | SeenFromVertices) -> ShaftsInView | None:
    """Keeps the points on sheets between light and shadow at which the view sees light; None: there are none.

    Args:
        place, strength, seen_from: as of `ShaftsInView`, for N points.
        sheets: the points.
        lit: the light that the medium scatters there.
    """
    kept = ((strength != 0) & torch.isfinite(strength)).any(0).nonzero().squeeze(1)
    place, area, points, ways, seen_from = rows((place, sheets.area, sheets.points, lit[1:], seen_from), kept)
    lit = LitInMedium(lit.light[:, kept], *ways)
    return ShaftsInView(place, strength[:, kept], area, points, lit, seen_from) if len(kept) else None


def lit_in_medium(integrand: Integrand, state: PathState, sheets: SampledSheets, depth: int) -> LitInMedium:
    """The light that media scatter back along rays, right beside sheets between light and shadow.

    Args:
        integrand: for the view, with a detached scene.
        state: (N,) path states with rays towards the points.
        sheets: (N,) the points.
        depth: the depth of the vertices at the points.
    """
    scene, ray, passed = integrand.proposal, state.ray, sheets.passed
    reach, one = sheets.lit - ray.o, torch.ones_like(ray.d.x)
    distance = torch.sqrt(dot(reach, reach))
    to_light = None
    if scene.layout.traces_segments:
        free, way = free_ways(integrand, ray, distance, state.medium, state.key, depth)
        behind = integrand.caster.intersect(Ray(sheets.lit, ray.d))
        behind = behind._replace(t=behind.t + distance)
        flight = Flight(distance, one, way.medium, way.ways, way.crossings, way.panes)
        back, gone = Ray(sheets.lit, -passed.onwards.d), sheets.lit - passed.onwards.o
        length = torch.sqrt(dot(gone, gone)) + passed.distance
        lit, light_way = free_ways(integrand, back, length, way.medium, state.key, depth + 1)
        to_light, free = (back, length, light_way._replace(crossings=None)), free & lit
        for medium in range(len(scene.layout.media)):
            if medium not in scene.layout.scattering_media:
                free = free & (way.medium != medium)
        free = free & (way.medium >= 0)
    else:
        behind = first_hit(integrand, ray, depth)
        free = (behind.prim < 0) | (behind.t > distance)
        flight = Flight(distance, one)
    shown = (free & (dot(reach, ray.d) > 0)).nonzero().squeeze(1)
    light = torch.zeros(3, len(one), dtype=torch.float64, device=one.device)
    if len(shown):
        own = rows((state, behind, sheets.points.draw, flight._replace(crossings=None), to_light), shown)
        found = light_sent_back(integrand, *own[:4])
        if to_light is not None:
            found = integrand.part(Ends.SURROUNDINGS).call(let_through, found, *own[4])
        light[:, shown] = torch.stack(tuple(found)).double()
    return LitInMedium(light, ray, behind, flight)


def carried(call: RenderCall, number: int, geometry: Geometry, own: ShaftsInView) -> Vec3:
    """The points in the medium, (K,) world, float64, attached: they keep their share of the way to the surface behind.

    Args:
        call, number: the rendering, attached, and the number of the view.
        geometry: of the scene, attached.
        own: the points on sheets.
    """
    ray = own.seen_from.rays(call, number, geometry, own.lit)
    return flown_along(call, ray, own.seen_from.key, own.lit.behind, own.lit.flight)
