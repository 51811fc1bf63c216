"""Places on the film at which an image jumps, and where they lie on the surfaces of the scene."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.path.bounce import APERTURE_U, APERTURE_V, CameraSample
from torch_radbp.rendering.call.render_call import RenderCall
from torch_radbp.rendering.call.view import View
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
from torch_radbp.scene.placement import shown
from torch_radbp.scene.tensors import SceneTensors
from torch_radbp.vec import TINY, Ray, Vec2, Vec3, dot, interpolated, max_component, rows

APART = 2e-6  # share of its distance by which places on either side of a curve lie off it, through which paths are traced
ROUNDED = 8 * 2.0**-24  # the same as a share of the coordinates, by whose rounding in float32 rays miss the places
NEIGHBOURS = 64  # successive places that share a sequence of low discrepancy
FEWEST, LARGEST_SHARE = 256, 4  # places on the curves of a kind; and one for so many paths of the image at most
SALT = 0x2545F491  # tells the random numbers of places from those of images
ALONG = 0  # the random number of a place beside those of the aperture
APERTURE_COUNTER = 0x1B873593

# What a place lies on: edges that are silhouettes and edges that are creases, and the curves inside of triangles at which
# shading normals turn away from the camera, and at which its near and its far plane cut them.
SILHOUETTE, CREASE, RIM, NEAR, FAR = range(5)


class Placed(NamedTuple):
    """What shows vertices of groups, in place of a `Hit`."""

    instance: Tensor  # (N,) int32, as hits count


class Between(NamedTuple):
    """Three vertices of a surface, rows of the scene's vertices; (N,) int64."""

    first: Tensor
    second: Tensor
    third: Tensor  # of a place on an edge the second once more


class Glued(NamedTuple):
    """Points of triangles, (N,) each."""

    prim: Tensor  # int32, as hits count; -1: it is not known which
    u: Tensor  # barycentric weight of the second vertex; of the triangle, not of what it is glued to
    v: Tensor  # of the third


class Places(NamedTuple):
    """N places on curves at which an image jumps, in one view; float64 where not said otherwise, detached."""

    kind: Tensor  # (N,) int64: SILHOUETTE, CREASE, ...
    between: Between
    instance: Tensor | None  # (N,) int32 that shows these vertices, as hits count; None: the scene has none
    u: Tensor  # (N,) barycentric coordinates: of the second vertex
    v: Tensor  # of the third
    p: Vec3  # world
    film: Vec2  # pixels from the upper left corner of the crop window
    normal: Vec2  # across the curve on the film; as long as the piece of it that the place stands for, pixels
    side: Tensor  # 1 where the surface lies ahead on the film, on a rim its front; -1 where it lies behind
    drift: Tensor  # what the curve moves along its normal where its level changes by one at a fixed place; 0 on edges
    depth: Tensor  # how far the triangles at the curve reach from the place along the line of sight, world
    behind: Glued  # what lies right behind the curve on the film, on an outline the surface that ends there
    ahead: Glued  # right ahead, likewise
    key: LaneKey  # of random numbers
    aperture: Vec2 | None  # as of `CameraKind.sample_ray`

    def at(self, scene: SceneTensors) -> Vec3:
        """The places in the world, glued to their triangles; attached, float64."""
        corners = tuple(rows(scene.triangles.vertices.p, corner) for corner in self.between)
        if self.instance is not None:
            corners = shown(scene, Placed(self.instance), corners)
        return interpolated(tuple(corner.map(torch.Tensor.double) for corner in corners), self.u, self.v)


class Numbers(NamedTuple):
    """The random numbers of some places."""

    key: LaneKey
    along: Tensor  # (N,) in [0, 1)
    aperture: Vec2 | None  # (N,) in [0, 1)


def numbers_of(view: View, count: int, salt: int) -> Numbers:
    """The random numbers of some places in a view; curves of another kind have another salt."""
    key = view.sample_keys[1]
    place = torch.arange(count, dtype=torch.int32, device=key.seed.device)
    salted = SampleKey(hash32(key.seed ^ (SALT + salt)), key.shared)
    lanes = lane_key(salted, torch.div(place, NEIGHBOURS, rounding_mode="floor"), place % NEIGHBOURS)
    along, aperture = fine_unit(random_bits(bounce_key(lanes, CAMERA_COUNTER), ALONG)), None
    if view.camera.kind.has_aperture:
        more = bounce_key(lanes, APERTURE_COUNTER)
        aperture = Vec2(*(fine_unit(random_bits(more, dimension)) for dimension in (APERTURE_U, APERTURE_V)))
    return Numbers(lanes, along, aperture)


def number_of_places(length: float, call: RenderCall, view: View) -> int:
    """How many places are sampled: as many as a pixel has samples for each pixel of length, within bounds.

    Args:
        length: of all curves of a kind on the film, pixels; 0: nothing is in view.
        call: of `view`.
    """
    paths = view.width * view.height * call.spp
    return 0 if length == 0.0 else max(FEWEST, min(int(length * call.spp), paths // LARGEST_SHARE))


def picked(weight: Tensor, along: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Picks one of W things for each of N places, in proportion to weights, and in order.

    Args:
        weight: (W,) not normalised.
        along: (N,) uniform numbers.

    Returns:
        The row of `weight`; a uniform number that is left over; and how many things of that weight a place stands for.
    """
    total, count = running_sum(weight), len(along)
    place = torch.arange(count, dtype=torch.float64, device=weight.device) + along
    target = place * (total[-1:] / max(count, 1))
    row = torch.searchsorted(total, target, right=True).clamp_max(len(total) - 1)
    own = weight[row]
    return row, ((target - total[row] + own) / own).clamp(0.0, 1.0), total[-1:] / (own * max(count, 1))


def window(view: View) -> tuple[Tensor, Tensor]:
    """The borders of a view and of what the filter reaches beyond it: left and right, upper and lower, (2,) positions."""
    film = view.camera.film
    reach = film.kernel.radius
    return tuple(torch.stack([(crop - reach) / size, (crop + pixels + reach) / size]).double()
                 for crop, size, pixels in ((film.crop_x, film.size_x, view.width), (film.crop_y, film.size_y, view.height)))


def on_film(view: View, p: Vec3, aperture: Vec2 | None) -> Vec2:
    """Where world points are seen, pixels from the upper left corner of the crop window."""
    film = view.camera.film
    place = view.camera.kind.project(view.camera.lens, p, aperture)
    return Vec2(place.x * film.size_x - film.crop_x, place.y * film.size_y - film.crop_y)


def unknown(like: Tensor) -> Glued:
    """Points of which nothing is known, as many as a (N,) tensor has entries."""
    return Glued(torch.full_like(like, -1, dtype=torch.int32), torch.zeros_like(like), torch.zeros_like(like))


def depth_of(view: View, p: Vec3, vertices: Sequence[Vec3], aperture: Vec2 | None) -> Tensor:
    """How far some vertices, (N,) each, lie from places p along the lines of sight through these; (N,) world."""
    towards = view.camera.kind.towards(view.camera.lens, p, aperture)
    away = torch.stack([dot(vertex - p, towards).abs() for vertex in vertices]).amax(0)
    return away / torch.sqrt(dot(towards, towards))


def beside(view: View, places: Places) -> tuple[Vec2, Vec2]:
    """Points of the film close to a curve, behind and ahead of it; pixels from the upper left corner of the crop window."""
    camera, film = view.camera, view.camera.film
    position = Vec2((places.film.x + film.crop_x) / film.size_x, (places.film.y + film.crop_y) / film.size_y)
    ray, _ = camera.kind.sample_ray(camera.lens, position, places.aperture)
    offset = places.p - ray.o
    distance = torch.sqrt(dot(offset, offset))
    cone = camera_cone(camera, ray, position, places.aperture)
    # Far enough for the rounding of places in the world and of positions on the film.
    apart = torch.maximum(apart_at(places, distance) / (cone.width + cone.spread * distance), APART * film.size_x)
    scale = apart / torch.hypot(places.normal.x, places.normal.y).clamp_min(TINY)
    across = places.normal * scale
    return (Vec2(places.film.x - across.x, places.film.y - across.y),
            Vec2(places.film.x + across.x, places.film.y + across.y))


def apart_at(places: Places, distance: Tensor) -> Tensor:
    """How far off places on either side of a curve lie, world units; `distance` (N,) from where the rays start."""
    return torch.maximum(APART * distance, ROUNDED * max_component(places.p.map(torch.abs)))


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
    return CameraSample(ray, key, weight, cone, None)
