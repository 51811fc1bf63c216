"""Path vertices as viewpoints from which edges are sampled."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.adjoint.attached import rays_reaching
from torch_radbp.adjoint.forward_mode import has_tangents
from torch_radbp.boundary.curve.geometry import Geometry, geometry_of
from torch_radbp.boundary.eye.eyes import Eyes, Lobe, lobe_around
from torch_radbp.boundary.eye.rays import rays_along
from torch_radbp.boundary.eye.seen_edges import corners_of, salted, uniform_numbers
from torch_radbp.call.render_call import RenderCall, integrand_of, started
from torch_radbp.path.camera_rays import CameraSample, sample_camera
from torch_radbp.path.event import Event
from torch_radbp.path.flight import FlightVertex
from torch_radbp.path.integrand import Integrand, int32_number
from torch_radbp.path.lanes import put_rows
from torch_radbp.path.light_share import ends_lamp_paths
from torch_radbp.path.state import Arrival, BoundaryCrossing, Flight, PathState, Settings
from torch_radbp.path.step import Onward, Step
from torch_radbp.path.taped_bounces import bounces_taken, found_out
from torch_radbp.raycast.protocol import Hit
from torch_radbp.sampling.running_sum import running_sum
from torch_radbp.sampling.sampler import LaneKey, SampleKey, hash32
from torch_radbp.tensors.differentiated import any_differentiated
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.record import joined, leaves_of, mapped, selected, with_leaves
from torch_radbp.tensors.stage import stage
from torch_radbp.tensors.vec import (
    TINY,
    Ray,
    Vec2,
    Vec3,
    cross,
    dot,
    interpolated,
    masked,
    max_component,
    rows,
    unit_normal,
    where,
)
from torch_radbp.vertex.cone import Cone
from torch_radbp.vertex.nearby import slides_from

SALT = 0x5BE0CD19  # tells the random numbers of these paths from others,
EVEN = 0.1  # how much edges count at grazing angles, by the cosine of interpolated normals
OF_TRIED = 0x2F6E2B17  # and those of paths that are tried


class Viewpoints(NamedTuple):
    """M path vertices from which edges are sampled; detached."""

    pixel: Tensor  # (M,) int32, pixel of the path
    sample: Tensor  # (M,) int32
    place: Vec2  # position of the path on the film, pixels from the window's upper left corner; float64
    depth: Tensor  # (M,) int64, from 0; -1: the path has no such vertex
    ray: Ray  # that meets it
    hit: Hit
    slides: Tensor  # (M,) bool: the ray's direction is not entirely random, so that the vertex slides
    beta: Vec3  # throughput before it, divided by the vertex's selection probability
    key: LaneKey
    lobe: Lobe  # around a scattered direction
    tried: Tensor | None  # (M,) bool: pilot samples, which only estimate noise; None: none are
    flight: Flight | None = None  # by which the ray comes there through media, or ends before `hit`; see `Arrival`
    boundary: Hit | None = None  # that it passes last; triangle -1: none; None: rays pass none, or carry no derivatives
    by_chance: Tensor | None = None  # (M,) bool: the ray's direction is entirely random
    behind_ideal: Tensor | None = None  # (M,) bool: the camera sees the vertex by way of one ideal vertex

    @property
    def in_medium(self) -> Tensor:
        """(M,) bool: vertices inside of a medium, before the surface that the ray hits."""
        return torch.zeros_like(self.slides) if self.flight is None else self.flight.t < torch.inf

    @property
    def standing(self) -> Hit:
        """(M,) the surfaces that vertices lie on; triangle -1: in a medium."""
        return self.hit._replace(prim=torch.where(self.in_medium, -1, self.hit.prim))


class Begun(NamedTuple):
    """N camera paths that start in cells of the film, for selecting viewpoints on them."""

    pixel: Tensor  # as of `Viewpoints`
    sample: Tensor
    place: Vec2
    area: Tensor  # (N,) float64, area of the film per path
    camera: CameraSample


class PathBatch(NamedTuple):
    """How many camera paths are traced to sample one vertex of each, and how they are spread over the film."""

    count: int
    density: Tensor | None = None  # (cells,) float64, by which they are spread over the cells of the film; None: evenly
    begun: int = 0  # how many others have begun before, with random numbers of their own
    tried: int = 0  # of how many paths more the vertices only tell how much noise there is, likewise; they come first
    ideal: float = 1.0  # how much more vertices are wanted that ideal mirrors or glass lead to


class Picked(NamedTuple):
    """The selected vertex of each of M paths so far, a state of reservoir sampling."""

    total: Tensor  # (M,) sum of the throughputs of candidates
    promise: Tensor  # (M,) throughput of the selected vertex; 0: none yet
    depth: Tensor  # (M,) int32; -1: likewise
    slides: Tensor  # (M,) bool: the ray's direction is not entirely random
    ideal: Tensor  # (M,) bool: it is not random at all
    onwards: Vec3  # (M,) scattered direction
    density: Tensor  # (M,) its density; 0: the path ends there
    ray: Ray  # hits the vertex
    beta: Vec3  # throughput before it
    hit: Hit
    flight: Flight | None = None  # as of `Viewpoints`
    boundary: Hit | None = None

    @staticmethod
    def nothing(state: PathState, instanced: bool) -> Picked:
        """The initial state, without a selected vertex; `instanced`: hits have instances."""
        none = torch.full_like(state.lane, -1)
        zero, vector = partial(torch.zeros_like, state.pdf), partial(Vec3.buffer, state.pdf)
        hit = Hit(none.clone(), zero(), zero(), zero(), none.clone() if instanced else None)
        no = partial(torch.zeros_like, none, dtype=torch.bool)
        return Picked(zero(), zero(), none.clone(), no(), no(), vector(), zero(), Ray(vector(), vector()), vector(), hit)


class PathsAtBounce(NamedTuple):
    """N paths at a bounce: what their rays hit, which of them are scattered on there, and in what state."""

    state: PathState  # (N,)
    hit: Hit  # (N,)
    order: Tensor  # int32, the path of each vertex
    survives: Tensor  # bool: it goes on,
    onwards: PathState  # with these states
    flight: Flight | None  # (N,) as of `Viewpoints`
    boundary: Hit | None


def viewpoints(call: RenderCall, number: int, integrand: Integrand, batch: PathBatch, following: bool = False) -> Viewpoints:
    """Samples one vertex of each camera path in proportion to throughput; paths without candidates are dropped.

    Args:
        call, number: the rendering, and the number of the view.
        integrand: with a detached scene.
        batch: the paths.
        following: select vertices whose scattered directions carry derivatives; else those whose next hits are fixed.
    """
    key, (_, _, begun, tried, ideal) = salted(call.views[number], SALT), batch
    paths = paths_begun(call, number, key, batch)
    if tried:
        pilots = paths_begun(call, number, salted(call.views[number], OF_TRIED), batch._replace(count=tried))
        paths = joined([pilots, paths])
    pixel, sample, place, area, camera = paths
    chosen = key._replace(seed=hash32(key.seed ^ begun)) if begun else key
    start = started(call, camera)
    picked = found_out(integrand, lambda integrand: picked_vertices(integrand, start, chosen, following, ideal))
    beta = picked.beta * (area.to(picked.total.dtype) * picked.total / picked.promise.clamp_min(TINY))
    if camera.weight is not None:
        beta = beta * camera.weight
    found = Viewpoints(pixel, sample, place, picked.depth.long(), picked.ray, picked.hit, picked.slides, beta, camera.key,
                       lobe_around(picked.onwards, picked.density),
                       torch.arange(len(sample), device=sample.device) < tried if tried else None, picked.flight,
                       picked.boundary, ~picked.slides, picked.ideal & (picked.depth == 1))
    found = rows(found, (found.depth >= 0).nonzero().squeeze(1))
    if call.camera_share is not None:
        lit_from_lamps = (found.depth == 0) & ends_lamp_paths(call.camera_share.integrand.scene, found.standing.prim)
        found = found._replace(slides=found.slides & ~lit_from_lamps)
    if call.scene.triangles.plain is None:
        return found
    geometry = geometry_of(call.scene)
    near = slides_from(corners_of(geometry, found.hit), found.hit.t.double(), hits_plain(geometry, found.standing))
    return found._replace(slides=found.slides | (near & (found.depth > 0)))


def paths_begun(call: RenderCall, number: int, key: SampleKey, batch: PathBatch) -> Begun:
    """Starts camera paths that are distributed over the film; args as for `viewpoints`, `key`: of random numbers."""
    view, grid, (count, density, begun, *_) = call.views[number], call.views[number].grid, batch
    sample = torch.arange(begun, begun + count, dtype=torch.int32, device=call.scene.device)
    jitter = uniform_numbers(key, sample, SALT, torch.float64)
    cell, area = cells_begun(sample - begun + jitter, count, grid.columns * grid.rows, density)
    row = torch.div(cell, grid.columns, rounding_mode="floor")
    column, pixel = cell - row * grid.columns, view.window.numbers(cell - row * grid.columns, row)
    camera = call.stages(sample_camera)(view.camera, view.apart, pixel, sample, key, call.scene.layout.traces_cones)
    place = Vec2(column - view.window.columns.before + camera.place.x.double(),
                 row - view.window.rows.before + camera.place.y.double())
    return Begun(pixel, sample, place, area.expand(count), camera)


def cells_begun(along: Tensor, count: int, cells: int, density: Tensor | None) -> tuple[Tensor, Tensor]:
    """The film cells in which paths start, (N,) int32, and the film area per path, (N,) or () float64.

    Args:
        along: (N,) float64 from 0 to `count`, the number of all paths.
        cells: the number of cells.
        density: as of `PathBatch`.
    """
    if density is None:
        return (along * (cells / count)).floor().clamp_max(cells - 1).to(torch.int32), along.new_tensor(cells / count)
    total = running_sum(density)
    cell = torch.searchsorted(total, along * (total[-1] / count), right=True).clamp_max(cells - 1)
    return cell.to(torch.int32), total[-1] / count / density[cell]


def picked_vertices(integrand: Integrand, start: PathState, key: SampleKey, following: bool, ideal: float = 1.0) -> Picked:
    """Selects one vertex of each path; the last hit is no candidate.

    Args:
        integrand: with a detached scene.
        start: the initial path states.
        key: of random numbers.
        following: as for `viewpoints`.
        ideal: as of `PathBatch`.
    """
    picked = Picked.nothing(start, integrand.proposal.triangles.instances is not None)
    stages, onward, L, depth = integrand.stages, Onward(start, None), Vec3.buffer(start.pdf), 0
    attached = integrand.settings.sampling == "attached"
    with bounces_taken(integrand, start.pdf.dtype) as bounce:
        while onward.count and not integrand.is_last(depth):
            state, step, onward = bounce(onward, depth, L)
            meant = [torch.arange(queue.first, queue.last, dtype=torch.int32, device=key.seed.device)
                     for queue in step.queues if queue.event.scatters and scatters_as(integrand, queue.event, following)]
            flight, boundary = flown(step)
            if flight is not None and picked.flight is None:
                room = mapped((flight, boundary), lambda leaf: None if leaf is None else leaf.new_zeros(len(start.lane)))
                picked = picked._replace(flight=room[0], boundary=room[1])
            if meant:
                reached = PathsAtBounce(state, step.hit, step.order, step.survives, onward.paths, flight, boundary)
                at = int32_number(SALT + 1 + depth, key.seed.device)
                put_rows(picked, *stages(picked_vertex)(picked, reached, torch.cat(meant), key, at,
                                                               (attached, ideal if depth else 1.0)))
            depth += 1
    return picked


@stage("picked", "reached")
def picked_vertex(picked: Picked, reached: PathsAtBounce, vertex: Tensor, key: SampleKey, counter: Tensor,
                  settings: tuple[bool, float]) -> tuple[Tensor, Picked]:
    """Reservoir sampling: updates the selected vertex of N paths by one bounce; returns the paths, int32, and the vertices.

    Args:
        picked: the selection of all paths.
        reached: the bounce.
        vertex: (N,) int32, indices of vertices.
        key, counter: of random numbers, the latter () int32.
        settings: whether all directions carry derivatives; and `PathBatch.ideal`.
    """
    attached, ideal = settings
    state, hit, flight, boundary = rows((reached.state, reached.hit, reached.flight, reached.boundary),
                                        rows(reached.order, vertex))
    before, weight = rows(picked, state.lane), max_component(state.beta)
    weight = weight if ideal == 1.0 else weight * torch.where(torch.isinf(state.pdf), ideal, 1.0)
    total = before.total + weight
    taken = uniform_numbers(key, state.lane, counter, weight.dtype) * total < weight
    is_ideal = torch.isinf(state.pdf)
    slides = is_ideal if state.followed is None else is_ideal | state.followed
    if flight is not None:  # in media points keep their share of the way to the surface behind, and move with the ray
        slides = slides | (flight.t < torch.inf)
    density = rows(reached.onwards.pdf, vertex) * rows(reached.survives, vertex).to(weight.dtype)
    depth = (counter - (SALT + 1)) + torch.zeros_like(state.lane)
    here = Picked(total, weight, depth, slides | attached, is_ideal, rows(reached.onwards.ray.d, vertex), density, state.ray,
                  state.beta, hit, flight, boundary)
    found = [torch.where(taken, new, old) if isinstance(new, Tensor) else None
             for new, old in zip(leaves_of(here), leaves_of(before))]
    return state.lane, with_leaves(here, found)._replace(total=total)


def flown(step: Step) -> tuple[Flight | None, Hit | None]:
    """How far the rays of a bounce come through media, and the last boundary of a medium that each passes, as a hit."""
    flight = step.flight
    if flight is None or flight.crossings is None:
        return flight, None
    last = step.hit._replace(prim=torch.full_like(step.hit.prim, -1))
    for crossing in flight.crossings:
        last = selected(crossing.hit.prim >= 0, crossing.hit, last)
    return flight._replace(crossings=None), last


def hits_plain(geometry: Geometry, hit: Hit) -> Tensor:
    """(N,) bool: hits on triangles where light jumps at borders of shadows alone, so that points near a vertex may slide."""
    return (hit.prim >= 0) & lookup(geometry.triangles.plain, hit.prim.clamp_min(0))


def scatters_as(integrand: Integrand, event: Event, following: bool) -> bool:
    """True if an event scatters into directions that carry derivatives (`following`), or else with next hits that are fixed
    to surfaces; in media only the latter is possible."""
    scatterer, settings = integrand.scatterer(event), integrand.settings
    if scatterer is None:
        return not following and settings.sampling != "attached"
    kind = scatterer.kind
    return kind.smooth and (settings.sampling == "attached" or settings.following and kind.follows) == following


def eyes_at(geometry: Geometry, points: Viewpoints, at: Vec3, lobes: tuple[Lobe, ...] = ()) -> Eyes:
    """The path vertices at positions `at`, (M,) world, as viewpoints that see more edges in the directions of their BSDFs
    and of `lobes`."""
    one, corners = torch.ones_like(at.x), corners_of(geometry, points.hit)
    normal = masked(~points.in_medium, unit_normal(corners[1] - corners[0], corners[2] - corners[0]))
    return Eyes(at, one, normal, one, torch.where(points.in_medium, 1.0, EVEN * one), (points.lobe, *lobes))


def vertex_at(call: RenderCall, geometry: Geometry, number: int, points: Viewpoints) -> Vec3:
    """The positions of viewpoints, (M,) world, attached: they slide along their rays, or are fixed to triangles."""
    ray = arriving(call, number, points)
    at = vertex_on(geometry, points, ray)
    return at if points.flight is None else where(points.in_medium, flown_to(call, points, ray), at)


def flown_to(call: RenderCall, points: Viewpoints, ray: Ray) -> Vec3:
    """The positions of viewpoints in media, (M,) world, attached; undefined for those on surfaces. Args as for
    `vertex_on`."""
    flight, boundary = points.flight._replace(t=torch.where(points.in_medium, points.flight.t, 0.0)), points.boundary
    if boundary is not None:
        flight = flight._replace(crossings=(BoundaryCrossing(boundary, flight.medium, flight.medium),))
    return flown_along(call, ray, points.key, points.hit, flight)


def flown_along(call: RenderCall, ray: Ray, key: LaneKey, hit: Hit, flight: Flight) -> Vec3:
    """The points in media where flights end, (N,) world, float64, attached: they keep their share of the way from the last
    boundary to the surface ahead.

    Args:
        call: attached.
        ray, key: (N,) of the flights, attached.
        hit: (N,) the surfaces ahead.
        flight: (N,) flights, all of which end before these.
    """
    arrival, t = Arrival(path_of(call, ray, key), hit, None, flight=flight), flight.t
    for medium in call.scene.layout.scattering_media:
        found, _ = FlightVertex(medium).distance_flown(call.scene, arrival, Settings(moving=True))
        t = found if flight.medium is None else torch.where(flight.medium == medium, found, t)
    o, d = (part.map(torch.Tensor.double) for part in ray)
    return o + d * t.double()


def vertex_on(geometry: Geometry, points: Viewpoints, ray: Ray) -> Vec3:
    """The positions of viewpoints on surfaces, (M,) world, attached: on the rays, or fixed to the triangles hit."""
    corners = corners_of(geometry, points.hit)
    glued = interpolated(corners, points.hit.u.double(), points.hit.v.double())
    ray = Ray(*(part.map(torch.Tensor.double) for part in ray))
    n = cross(corners[1] - corners[0], corners[2] - corners[0])
    facing = dot(ray.d, n)
    slides = points.slides & (facing != 0)
    slid = ray.o + ray.d * (dot(corners[0] - ray.o, n) / torch.where(slides, facing, 1.0))
    return where(slides, slid, glued)


def arriving(call: RenderCall, number: int, points: Viewpoints, all_of_them: bool = False) -> Ray:
    """The rays that hit the viewpoints, attached if their direction is not random, or if `all_of_them`."""
    view, cones = call.views[number], call.scene.layout.traces_cones

    def begun(chosen: Viewpoints) -> CameraSample:
        return sample_camera(view.camera, view.apart, chosen.pixel, chosen.sample, salted(view, SALT), cones)

    first, ray = points.depth == 0, points.ray
    if any_differentiated(view.camera):
        ray = Ray(*(where(first, *parts) for parts in zip(begun(points).ray, ray)))
    later = ((points.slides | all_of_them) & ~first).nonzero().squeeze(1)
    integrand = call.make_integrand(call.scene)
    if not len(later) or not integrand.settings.moving or not any_differentiated((call.scene, view.camera)):
        return ray
    chosen = rows(points, later)
    start = started(call, begun(chosen))
    if call.adjoint.taped or call.scene.layout.media or has_tangents((call.scene, view.camera)):
        found = rays_reaching(integrand, start, chosen.depth)
    else:
        found = rays_along(integrand_of(call, call.integrand, number), start, chosen.depth, chosen.hit, call.scene)
    return Ray(*(Vec3(*(old.index_copy(0, later, new) for old, new in zip(*parts))) for parts in zip(ray, found)))


def path_of(call: RenderCall, ray: Ray, key: LaneKey) -> PathState:
    """The path states at the start of rays whose directions are not random."""
    cone = None
    if call.scene.layout.traces_cones:
        cone = Cone(torch.zeros_like(ray.d.x), torch.zeros_like(ray.d.x))
    return started(call, CameraSample(ray, key, None, cone, None))
