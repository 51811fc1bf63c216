"""Vertices of paths, from which edges are looked at."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.adjoint.attached import rays_reaching
from torch_radbp.boundary.geometry import Geometry, geometry_of
from torch_radbp.boundary.shadows.eyes import Lobe, lobe_around
from torch_radbp.boundary.shadows.seen_edges import corners_of, numbers, salted
from torch_radbp.call.render_call import RenderCall, started
from torch_radbp.path.bounce import CameraSample, sample_camera
from torch_radbp.path.event import Scatters
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.state import PathState
from torch_radbp.path.wavefront import bounces
from torch_radbp.raycast.protocol import Hit
from torch_radbp.sampling.sampler import LaneKey
from torch_radbp.scene.cone import Cone
from torch_radbp.scene.nearby import slides_from
from torch_radbp.tensors.differentiated import any_differentiated
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.vec import TINY, Ray, Vec2, Vec3, cross, dot, interpolated, max_component, rows, where

SALT = 0x5BE0CD19  # tells the random numbers of these paths from others


class Viewpoints(NamedTuple):
    """M vertices of paths; detached."""

    pixel: Tensor  # (M,) int32, the number of the pixel that the path began in
    sample: Tensor  # (M,) int32
    place: Vec2  # of the path on the film, pixels from the upper left corner of the window; float64
    depth: Tensor  # (M,) int64, from 0; -1: the path has none
    ray: Ray  # that meets it
    hit: Hit
    slides: Tensor  # (M,) bool: not all of the ray's direction is left to chance, so that the vertex slides
    beta: Vec3  # throughput before it, over the probability of this vertex
    key: LaneKey
    lobe: Lobe  # around a direction in which light is scattered


def viewpoints(call: RenderCall, number: int, integrand: Integrand, count: int, following: bool = False) -> Viewpoints:
    """One vertex each of so many camera paths, picked in proportion to their throughput; of those that have one.

    Args:
        call, number: of the view.
        integrand: of the detached scene.
        count: of the paths.
        following: vertices whose scattered directions carry derivatives are meant; else those after which points are glued.
    """
    view, grid, device = call.views[number], call.views[number].grid, call.scene.device
    cells = grid.columns * grid.rows
    sample = torch.arange(count, dtype=torch.int32, device=device)
    key = salted(view, SALT)
    jitter = numbers(key, sample, SALT, torch.float64)
    cell = ((sample + jitter) * (cells / count)).floor().clamp_max(cells - 1).to(torch.int32)
    row = torch.div(cell, grid.columns, rounding_mode="floor")
    column, pixel = cell - row * grid.columns, view.window.numbers(cell - row * grid.columns, row)
    camera = call.stages.sample_camera(view.camera, view.numbered, pixel, sample, key, call.scene.layout.traces_cones)
    place = Vec2(column - view.window.columns.before + camera.place.x.double(),
                 row - view.window.rows.before + camera.place.y.double())
    state = started(call, camera)
    zero = torch.zeros_like(state.pdf)
    total, depth = zero.clone(), torch.full((count,), -1, dtype=torch.int64, device=device)
    nothing = torch.zeros_like(sample)
    instance = None if call.scene.triangles.instances is None else nothing.clone()
    hit = Hit(nothing - 1, *(zero.clone() for _ in range(3)), instance)
    ray, beta, promise = Ray(Vec3.buffer(zero), Vec3.buffer(zero)), Vec3.buffer(zero), zero.clone()
    slides = torch.zeros_like(depth, dtype=torch.bool)
    onwards, density = Vec3.buffer(zero), zero.clone()
    for bounce in bounces(integrand, state):
        for queue in bounce.step.queues:
            if not queue.event.scatters or not scatters_as(integrand, queue.event, following):
                continue
            own = bounce.step.order[queue.first:queue.last].long()
            lane = bounce.state.lane[own].long()
            weight = max_component(bounce.state.beta)[own]
            total[lane] += weight
            draw = numbers(key, lane.to(torch.int32), SALT + 1 + bounce.depth, zero.dtype)
            taken = draw * total[lane] < weight
            own, lane = own[taken], lane[taken]
            scattered = torch.arange(queue.first, queue.last, device=device)[taken]  # among the vertices
            density[lane] = bounce.vertex.next.pdf[scattered] * bounce.vertex.survives[scattered]
            for target, found in zip(onwards, bounce.vertex.next.ray.d):
                target[lane] = found[scattered]
            followed = bounce.state.followed
            depth[lane] = bounce.depth
            slides[lane] = torch.isinf(bounce.state.pdf[own]) | (integrand.settings.sampling == "attached")
            if followed is not None:
                slides[lane] |= followed[own]
            for target, found in zip((*ray.o, *ray.d, *beta, promise, *hit[:4]),
                                     (*bounce.state.ray.o, *bounce.state.ray.d, *bounce.state.beta,
                                      max_component(bounce.state.beta), *bounce.step.hit[:4])):
                target[lane] = found[own]
            if hit.instance is not None:
                hit.instance[lane] = bounce.step.hit.instance[own]
    area = cells / count  # of the film, for which each path stands
    beta = beta * (area * total / promise.clamp_min(TINY))
    if camera.weight is not None:
        beta = beta * camera.weight
    found = Viewpoints(pixel, sample, place, depth, ray, hit, slides, beta, camera.key,
                       lobe_around(onwards, density))
    found = rows(found, (depth >= 0).nonzero().squeeze(1))
    if call.scene.triangles.plain is None:
        return found
    geometry = geometry_of(call.scene)
    near = slides_from(corners_of(geometry, found.hit), found.hit.t.double(), is_plain(geometry, found.hit))
    return found._replace(slides=found.slides | (near & (found.depth > 0)))


def is_plain(geometry: Geometry, hit: Hit) -> Tensor:
    """True where a triangle is hit that is plain, (N,) bool; see `scene.nearby`."""
    return (hit.prim >= 0) & lookup(geometry.triangles.plain, hit.prim.clamp_min(0))


def scatters_as(integrand: Integrand, event: Scatters, following: bool) -> bool:
    """True if paths are scattered by chance so that their directions carry derivatives, or else so that the points that they
    meet next are glued to surfaces."""
    kind, settings = integrand.scatterer(event).kind, integrand.settings
    return kind.smooth and (settings.sampling == "attached" or settings.following and kind.follows) == following


def vertex_at(call: RenderCall, geometry: Geometry, number: int, points: Viewpoints) -> Vec3:
    """The viewpoints, (M,) world, attached: they slide along their rays, or are glued."""
    return vertex_on(geometry, points, arriving(call, number, points))


def vertex_on(geometry: Geometry, points: Viewpoints, ray: Ray) -> Vec3:
    """As `vertex_at`; `ray`: (M,) that meet them, attached."""
    corners = corners_of(geometry, points.hit)
    glued = interpolated(corners, points.hit.u.double(), points.hit.v.double())
    ray = Ray(*(part.map(torch.Tensor.double) for part in ray))
    n = cross(corners[1] - corners[0], corners[2] - corners[0])
    facing = dot(ray.d, n)
    slides = points.slides & (facing != 0)
    slid = ray.o + ray.d * (dot(corners[0] - ray.o, n) / torch.where(slides, facing, 1.0))
    return where(slides, slid, glued)


def arriving(call: RenderCall, number: int, points: Viewpoints, all_of_them: bool = False) -> Ray:
    """The rays that meet the viewpoints, attached where they are not left to chance, or `all_of_them`."""
    view, cones = call.views[number], call.scene.layout.traces_cones

    def begun(chosen: Viewpoints) -> CameraSample:
        return sample_camera(view.camera, view.numbered, chosen.pixel, chosen.sample, salted(view, SALT), cones)

    first = points.depth == 0
    ray = begun(points).ray
    ray = Ray(*(where(first, *parts) for parts in zip(ray, points.ray)))
    later = ((points.slides | all_of_them) & ~first).nonzero().squeeze(1)
    integrand = call.make_integrand(call.scene)
    if not len(later) or not integrand.settings.moving or not any_differentiated((call.scene, view.camera)):
        return ray
    chosen = rows(points, later)
    found = rays_reaching(integrand, started(call, begun(chosen)), chosen.depth)
    return Ray(*(Vec3(*(old.index_copy(0, later, new) for old, new in zip(*parts))) for parts in zip(ray, found)))


def path_of(call: RenderCall, ray: Ray, key: LaneKey) -> PathState:
    """Paths that begin with rays whose directions are not left to chance."""
    cone = None
    if call.scene.layout.traces_cones:
        cone = Cone(torch.zeros_like(ray.d.x), torch.zeros_like(ray.d.x))
    return started(call, CameraSample(ray, key, None, cone, None))
