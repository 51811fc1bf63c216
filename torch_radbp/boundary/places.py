"""Places on the edges of an outline, as a camera sees them."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.adjoint.function import RenderCall
from torch_radbp.boundary.edges import Edges
from torch_radbp.boundary.outline import Outline
from torch_radbp.boundary.silhouette import is_silhouette, is_silhouette_from
from torch_radbp.path import APERTURE_U, APERTURE_V, CameraSample
from torch_radbp.sampling.running_sum import running_sum
from torch_radbp.sampling.sampler import (
    CAMERA_COUNTER,
    LaneKey,
    SampleKey,
    bounce_key,
    fine_unit,
    hash32,
    lane_key,
    random_bits,
)
from torch_radbp.scene.cone import camera_cone
from torch_radbp.vec import TINY, Ray, Vec2, Vec3, dot, max_component
from torch_radbp.view import View

APART = 3e-5  # share of its distance by which places on either side of an edge lie off it, through which paths are traced
STEP = 1e-5  # of the length of an edge in view, by which its direction on the film is found
NEIGHBOURS = 64  # successive places on an outline that share a sequence of low discrepancy
FEWEST, LARGEST_SHARE = 256, 4  # places on the outline; and one for so many paths of the image at most
SALT = 0x2545F491  # tells the random numbers of outlines from those of images
ALONG, FILM_U, FILM_V = 0, 1, 2  # random numbers of a place beside those of the aperture
APERTURE_COUNTER = 0x1B873593


class Places(NamedTuple):
    """N places on edges of an outline in one view; float64 where not said otherwise, detached."""

    edge: Tensor  # (N,) int64
    silhouette: Tensor  # (N,) bool: it is one; else it is a crease
    along: Tensor  # (N,) share of the way from a to b
    p: Vec3  # world
    film: Vec2  # pixels from the upper left corner of the crop window
    normal: Vec2  # across the edge on the film; as long as the piece of the edge that the place stands for, pixels
    key: LaneKey  # of random numbers
    aperture: Vec2 | None  # as of `CameraKind.sample_ray`


class Choice(NamedTuple):
    """The edges in a view, and how often each is picked."""

    enters: Tensor  # (E,) shares of the way from a to b between which it is in view
    leaves: Tensor
    weight: Tensor  # (E,) not normalised; 0: not at all
    silhouette: Tensor  # (E,) bool: it is one, from somewhere on the lens
    length: float  # of all edges in view on the film, those that may jump less counted as less, pixels


def places_in_view(call: RenderCall, number: int, outline: Outline) -> Places:
    """Places on an outline as a camera sees it, in proportion to lengths on the film."""
    view, edges = call.views[number], outline.edges
    vertices = outline.vertices(call.scene).stack().double()
    choice = edges_in_view(view, outline, vertices)
    count = number_of_places(choice.length * call.spp, view.width * view.height * call.spp)
    key = keys(view.sample_keys[1], count, vertices.device)
    numbers = bounce_key(key, CAMERA_COUNTER)
    total = running_sum(choice.weight)
    place = torch.arange(count, dtype=torch.float64, device=vertices.device) + fine_unit(random_bits(numbers, ALONG))
    target = place * (total[-1:] / max(count, 1))
    edge = torch.searchsorted(total, target, right=True).clamp_max(len(total) - 1)
    weight = choice.weight[edge]
    share = ((target - total[edge] + weight) / weight).clamp(0.0, 1.0)
    reach = choice.leaves[edge] - choice.enters[edge]
    along = choice.enters[edge] + reach * share
    # The density over `along` is weight / (total reach); the length of the edge on the film per `along` is in `normal`.
    stands_for = reach * total[-1:] / (weight * max(count, 1) * outline.share[edge])
    aperture = None
    if view.camera.kind.has_aperture:
        more = bounce_key(key, APERTURE_COUNTER)
        aperture = Vec2(*(fine_unit(random_bits(more, dimension)) for dimension in (APERTURE_U, APERTURE_V)))
    a, b = (Vec3.of(vertices[index[edge]]) for index in (edges.a, edges.b))
    before, at, after = (on_film(view, a + (b - a) * (along + step * reach), aperture) for step in (-STEP, 0.0, STEP))
    scale = stands_for / (2.0 * STEP * reach)
    p = a + (b - a) * along
    silhouette = choice.silhouette[edge]
    if aperture is not None:
        eyes = camera_sample(call, view, at, aperture, key).ray.o.stack().double()
        silhouette = is_silhouette_from(edges, vertices, edge, eyes)
        scale = scale * (silhouette | (outline.crease[edge] > 0))
    return Places(edge, silhouette, along, p, at, Vec2(-(after.y - before.y) * scale, (after.x - before.x) * scale), key,
                  aperture)


def number_of_places(wanted: float, paths: int) -> int:
    """How many places on an outline are sampled: as many as a pixel has samples for each pixel of length, within bounds.

    Args:
        wanted: length times samples of a pixel; 0: nothing is in view.
        paths: of the image.
    """
    return 0 if wanted == 0.0 else max(FEWEST, min(int(wanted), paths // LARGEST_SHARE))


def keys(key: SampleKey, count: int, device: torch.device) -> LaneKey:
    """The keys of the random numbers of places."""
    place = torch.arange(count, dtype=torch.int32, device=device)
    salted = SampleKey(hash32(key.seed ^ SALT), key.shared)
    return lane_key(salted, torch.div(place, NEIGHBOURS, rounding_mode="floor"), place % NEIGHBOURS)


def edges_in_view(view: View, outline: Outline, vertices: Tensor) -> Choice:
    """Which edges are in view, and how long they are there; `vertices` (U, 3) of the outline, float64."""
    camera, edges = view.camera, outline.edges
    silhouette = is_silhouette(edges, vertices, camera.kind.eye(camera.lens), camera.kind.aperture_radius(camera.lens))
    jump = torch.where(silhouette, 1.0, outline.crease.double())
    some, enters, leaves = clipped(view, edges, vertices, (jump > 0).nonzero().squeeze(1))
    a, b = (Vec3.of(vertices[index[some]]) for index in (edges.a, edges.b))
    middle = Vec2(*(torch.full_like(enters, 0.5),) * 2) if camera.kind.has_aperture else None
    ends = [on_film(view, a + (b - a) * along, middle) for along in (enters, leaves)]
    length = torch.hypot(ends[1].x - ends[0].x, ends[1].y - ends[0].y)
    weight = length * jump[some]
    every = torch.zeros(3, len(jump), dtype=torch.float64, device=vertices.device)
    enters, leaves, weights = every.index_copy(1, some, torch.stack([enters, leaves, weight]))
    return Choice(enters, leaves, weights, silhouette, float(weight.sum()))


def clipped(view: View, edges: Edges, vertices: Tensor, some: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Those of some edges that are in view, (S,), and the shares of the way from a to b between which they are.

    Only edges that cross the border of the view are clipped.

    Args:
        view: where also counts what the filter reaches beyond the window.
        edges: between `vertices`, (U, 3) float64.
        some: (E',) int64, of the edges.
    """
    camera, film = view.camera, view.camera.film
    reach = film.filter.quantiles.abs().max()
    x, y = (torch.stack([(crop - reach) / size, (crop + pixels + reach) / size]).double()
            for crop, size, pixels in ((film.crop_x, film.size_x, view.width), (film.crop_y, film.size_y, view.height)))
    beyond = camera.kind.frustum(camera.lens, x, y, Vec3.of(vertices)) < 0
    bits = 1 << torch.arange(len(beyond), device=vertices.device)
    outside = (beyond * bits[:, None]).sum(0)  # a bit for each plane of the frustum, as Cohen and Sutherland have it
    at_a, at_b = (outside[index[some]] for index in (edges.a, edges.b))
    seen = (at_a & at_b) == 0
    some, crossing = some[seen], (at_a | at_b)[seen].nonzero().squeeze(1)
    enters = torch.zeros(len(some), dtype=torch.float64, device=vertices.device)
    a, b = (Vec3.of(vertices[index[some[crossing]]]) for index in (edges.a, edges.b))
    first, last = camera.kind.clipped(camera.lens, x, y, a, b)
    leaves = torch.ones_like(enters).index_copy(0, crossing, last)
    enters = enters.index_copy(0, crossing, first)
    seen = enters < leaves
    return some[seen], enters[seen], leaves[seen]


def on_film(view: View, p: Vec3, aperture: Vec2 | None) -> Vec2:
    """Where world points are seen, pixels from the upper left corner of the crop window."""
    film = view.camera.film
    place = view.camera.kind.project(view.camera.lens, p, aperture)
    return Vec2(place.x * film.size_x - film.crop_x, place.y * film.size_y - film.crop_y)


def beside(view: View, places: Places) -> tuple[Vec2, Vec2]:
    """Points of the film close to an edge, behind and ahead of it; pixels from the upper left corner of the crop window."""
    camera, film = view.camera, view.camera.film
    position = Vec2((places.film.x + film.crop_x) / film.size_x, (places.film.y + film.crop_y) / film.size_y)
    ray, _ = camera.kind.sample_ray(camera.lens, position, places.aperture)
    offset = places.p - ray.o
    distance = torch.sqrt(dot(offset, offset))
    cone = camera_cone(camera, ray, position, places.aperture)
    # Far enough for the rounding of places in the world and of positions on the film.
    apart = APART * torch.maximum(torch.maximum(distance, max_component(places.p.map(torch.abs)))
                                  / (cone.width + cone.spread * distance), film.size_x)
    scale = apart / torch.hypot(places.normal.x, places.normal.y).clamp_min(TINY)
    across = places.normal * scale
    return (Vec2(places.film.x - across.x, places.film.y - across.y),
            Vec2(places.film.x + across.x, places.film.y + across.y))


def camera_sample(call: RenderCall, view: View, film: Vec2, aperture: Vec2 | None, key: LaneKey) -> CameraSample:
    """The rays through points of the film, pixels from the upper left corner of the crop window."""
    camera, dtype = view.camera, call.scene.dtype
    window = camera.film
    position = Vec2(*(((place + crop) / size).to(dtype) for place, crop, size in (
        (film.x, window.crop_x, window.size_x), (film.y, window.crop_y, window.size_y))))
    aperture = None if aperture is None else aperture.map(lambda part: part.to(dtype))
    ray, weight = camera.kind.sample_ray(camera.lens, position, aperture)
    ray = Ray(*(part.map(torch.Tensor.contiguous) for part in ray))
    cone = camera_cone(camera, ray, position, aperture) if call.scene.layout.traces_cones else None
    return CameraSample(ray, key, weight, cone)
