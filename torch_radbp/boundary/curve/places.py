"""Samples on discontinuity curves of the film, with their positions on the scene's surfaces."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.curve.geometry import Between, Geometry, positions
from torch_radbp.boundary.curve.silhouette import Eye
from torch_radbp.call.render_call import RenderCall
from torch_radbp.call.view import View
from torch_radbp.path.camera_rays import APERTURE_U, APERTURE_V, CameraSample
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
from torch_radbp.sensor.frustum import Frustum
from torch_radbp.sensor.kind import Camera
from torch_radbp.tensors.stage import Stages, stage
from torch_radbp.tensors.vec import TINY, Vec2, Vec3, dot, interpolated, max_component, rows
from torch_radbp.tensors.vector_jacobian import vector_jacobian_product, zeros_unless
from torch_radbp.vertex.cone import camera_cone

APART = 2e-6  # share of its distance by which places on either side of a curve lie off it, through which paths are traced
WIDER = 64.0  # times as far where rays pass boundaries of media
ROUNDED = 8 * 2.0**-24  # the same as a share of the coordinates, by whose rounding in float32 rays miss the places
NEIGHBOURS = 64  # successive places that share a sequence of low discrepancy
FEWEST, LARGEST_SHARE = 256, 4  # places on the curves of a kind; of all kinds, one for so many paths of the image at most
SALT = 0x2545F491  # tells the random numbers of places from those of images
FUSED = 0.5  # share of the memory that places take in plain torch, where loops are fused
ALONG = 0  # the random number of a place beside those of the aperture
APERTURE_COUNTER = 0x1B873593

# What a place lies on: edges that are silhouettes and edges that are creases, and the curves inside of triangles at which
# shading normals turn away from the camera, at which its near and its far plane cut them, at which textures jump, and along
# which other triangles pass through.
SILHOUETTE, CREASE, RIM, NEAR, FAR, TEXTURE, INTERSECTION = range(7)


class Glued(NamedTuple):
    """Points on triangles at fixed barycentric coordinates, (N,) each."""

    prim: Tensor  # int32, as in a hit; -1: unknown
    u: Tensor  # barycentric coordinate of the second vertex
    v: Tensor  # and of the third


class Places(NamedTuple):
    """N samples on discontinuity curves of a view; float64 unless said otherwise, detached."""

    kind: Tensor  # (N,) int32: SILHOUETTE, CREASE, ...
    between: Between
    instance: Tensor | None  # (N,) int32 instance as in a hit; None: the scene has none
    u: Tensor  # (N,) barycentric coordinate of the second vertex
    v: Tensor  # and of the third
    p: Vec3  # world
    film: Vec2  # pixels from the upper left corner of the window
    normal: Vec2  # normal of the curve on the film; its length is that of the piece of curve per sample, pixels
    side: Tensor  # 1 where the surface (on a rim its front) lies ahead on the film; -1 where it lies behind
    drift: Tensor  # motion of the curve along its normal per unit of its level function; 0 on edges
    depth: Tensor  # extent of the triangles at the curve along the line of sight, world
    behind: Glued  # point right behind the curve on the film, on the surface that ends there
    ahead: Glued  # point right ahead of it
    through: Tensor  # (N,) int32, triangle that intersects there; -1: none
    shown_by: Tensor | None  # (N,) int32, its instance
    key: LaneKey  # of random numbers
    aperture: Vec2 | None  # as of `CameraKind.sample_ray`
    counts: Tensor  # (N,) bool: in some pixel
    line: Tensor  # (N,) int32, which line of a surface it is, see `term.LineNumbers`; -1: none

    def at(self, geometry: Geometry) -> Vec3:
        """The world positions of the samples, as points fixed to their triangles; attached, float64."""
        return interpolated(positions(geometry, self.between, self.instance), self.u, self.v)


class Sight(NamedTuple):
    """A view as stages of boundary terms read it: camera, viewpoint, frustum, random numbers and lamps; detached."""

    camera: Camera
    eye: Eye
    frustum: Frustum  # around all that contributes to pixels, filter margin included
    seed: SampleKey  # key of the samples' random numbers
    lamps: tuple[Eye, ...]  # emitters as viewpoints, see `terminators.lamps_of`


def sight_of(view: View, lamps: tuple[Eye, ...]) -> Sight:
    """A detached view as stages of boundary terms read it, with lamps as viewpoints."""
    return Sight(view.camera, *known_view(view.camera, view.width, view.height), view.sample_keys[1], lamps)


def eye_and_frustum(camera: Camera, width: int, height: int) -> tuple[Eye, Frustum]:
    """The viewpoint of a detached camera, and the frustum of an image of width x height pixels."""
    film, reach = camera.film, camera.film.kernel.radius
    with torch.inference_mode(False):  # they may be kept, for renderings that are differentiated
        x, y = (torch.stack([(crop - reach) / size, (crop + pixels + reach) / size]).double()
                for crop, size, pixels in ((film.crop_x, film.size_x, width), (film.crop_y, film.size_y, height)))
        eye = Eye.of(camera.kind.eye(camera.lens), camera.kind.aperture_radius(camera.lens))
        return eye, camera.kind.frustum(camera.lens, x, y)


# Tensors of cameras are compared by identity; of one that has not changed they are those of the last rendering.
known_view = functools.lru_cache(maxsize=16)(eye_and_frustum)


def taken_by(stages: Stages, size: int) -> int:
    """The memory in bytes of samples that take `size` bytes in plain torch; less if stages are compiled."""
    return int(size * (FUSED if stages.is_compiled else 1.0))


class PlaceNumbers(NamedTuple):
    """The random numbers of samples on discontinuity curves."""

    key: LaneKey
    along: Tensor  # (N,) in [0, 1)
    aperture: Vec2 | None  # (N,) in [0, 1)


def place_numbers(sight: Sight, place: Tensor, salt: int) -> PlaceNumbers:
    """The random numbers of samples `place`, (N,) int32; each kind of curve has its own salt."""
    salted = SampleKey(hash32(sight.seed.seed ^ (SALT + salt)), sight.seed.shared)
    lanes = key_of_places(salted, place)
    along, aperture = fine_unit(random_bits(bounce_key(lanes, CAMERA_COUNTER), ALONG)), None
    if sight.camera.kind.has_aperture:
        more = bounce_key(lanes, APERTURE_COUNTER)
        aperture = Vec2(*(fine_unit(random_bits(more, dimension)) for dimension in (APERTURE_U, APERTURE_V)))
    return PlaceNumbers(lanes, along, aperture)


def key_of_places(seed: SampleKey, place: Tensor) -> LaneKey:
    """The random number keys of samples `place`, (N,) int32: `NEIGHBOURS` in a row share a sequence."""
    return lane_key(seed, torch.div(place, NEIGHBOURS, rounding_mode="floor"), place % NEIGHBOURS)


def place_counts(lengths: Sequence[float], call: RenderCall, view: View) -> list[int]:
    """The number of samples for each kind of curve: per pixel of length as many as a pixel has, within limits.

    Args:
        lengths: the lengths of the curves of each kind on the film, pixels.
        call, view: the rendering, and its view.
    """
    wanted = sum(lengths) * call.spp
    share = min(1.0, view.width * view.height * call.spp / (LARGEST_SHARE * wanted)) if wanted else 0.0
    return [max(FEWEST, int(length * call.spp * share)) for length in lengths]


class Lot(NamedTuple):
    """A discrete distribution over W items, for stratified sampling."""

    weight: Tensor  # (W,) float64, not normalised
    total: Tensor  # (W,) its running sum
    step: Tensor  # () weight per sample
    last: Tensor  # () int64, W - 1


def lot_of(weight: Tensor, count: int, total: Tensor) -> Lot:
    """A discrete distribution for `count` stratified samples, from weights, (W,), and their running sum `total`."""
    return Lot(weight, total, total[-1] / count, torch.full((), len(weight) - 1, dtype=torch.int64, device=weight.device))


def picked(lot: Lot, place: Tensor, along: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Samples one item of a discrete distribution for each of N samples, stratified.

    Args:
        lot: the distribution.
        place: (N,) int32, the numbers of the samples.
        along: (N,) uniform numbers.

    Returns:
        The index of the item, int64; the remaining uniform number; and the number of items for which a sample stands.
    """
    target = (place.double() + along) * lot.step
    row = torch.minimum(torch.searchsorted(lot.total, target, right=True), lot.last)
    own = rows(lot.weight, row)
    return row, ((target - rows(lot.total, row) + own) / own).clamp(0.0, 1.0), lot.step / own


def on_film(camera: Camera, p: Vec3, aperture: Vec2 | None) -> Vec2:
    """The film positions of world points, pixels from the upper left corner of the window."""
    film = camera.film
    place = camera.kind.project(camera.lens, p, aperture)
    return Vec2(place.x * film.size_x - film.crop_x, place.y * film.size_y - film.crop_y)


def length_in_view(sight: Sight, a: Vec3, b: Vec3) -> Tensor:
    """The lengths in view of lines from a to b, (N,) world points; float64 pixels, seen from the centre of the lens.

    They are sampling weights, and need not be exact.
    """
    camera = sight.camera
    enters, leaves = sight.frustum.clipped(a, b, torch.float32)
    middle = Vec2(*(torch.full_like(a.x, 0.5),) * 2) if camera.kind.has_aperture else None
    start, end = (on_film(camera, a + (b - a) * along, middle) for along in (enters, leaves))
    across, down = end.x - start.x, end.y - start.y
    return torch.where(enters < leaves, torch.sqrt(across * across + down * down), 0.0)


def velocities_on_film(camera: Camera, p: Vec3, directions: Sequence[Vec3], aperture: Vec2 | None) -> list[Vec2]:
    """The velocities on the film, pixels, of points p that move with given world velocities; (N,) each."""
    def velocity(direction: Vec3, coordinate: int) -> Tensor:
        with torch.enable_grad():
            step = (0.0 * p.x).requires_grad_()
            seen = on_film(camera, p + direction * step, aperture)[coordinate]
            return zeros_unless(vector_jacobian_product([seen], [step], [torch.ones_like(step)])[0], step).detach()

    return [Vec2(velocity(direction, 0), velocity(direction, 1)) for direction in directions]


def unknown(like: Tensor) -> Glued:
    """Points on no triangle (-1), one for each entry of a (N,) tensor."""
    return Glued(torch.full_like(like, -1, dtype=torch.int32), torch.zeros_like(like), torch.zeros_like(like))


def depth_of(camera: Camera, p: Vec3, vertices: Sequence[Vec3], aperture: Vec2 | None) -> Tensor:
    """The extent of triangles along lines of sight: from points p to `vertices`, (N,) each; (N,) world."""
    towards = camera.kind.towards(camera.lens, p, aperture)
    away = torch.zeros_like(p.x)
    for vertex in vertices:
        away = torch.maximum(away, dot(vertex - p, towards).abs())
    return away / torch.sqrt(dot(towards, towards))


@stage("sight", "places", "chosen")
def rays_beside(sight: Sight, places: Places, chosen: Tensor, count: Tensor, lane: Tensor, cones: bool,
                through_media: bool) -> CameraSample:
    """Camera rays to samples on curves, then to points behind, then ahead of the curves: three for each sample.

    Args:
        sight: of the view.
        places: the samples, of which some are used.
        chosen: (K,) int32, the indices of the samples to use.
        count: () int32, K.
        lane: (3 K,) int32, the indices of the rays.
        cones: whether rays have ray cones.
        through_media: whether rays pass boundaries of media, each of which shifts them slightly.
    """
    camera = sight.camera
    film, dtype = camera.film, camera.dtype
    place = rows(chosen, lane % count)
    way = torch.div(lane, count, rounding_mode="floor")
    key, aperture = rows(places.key, place), rows(places.aperture, place)
    at, p, normal = rows((places.film, places.p, places.normal), place)
    position = Vec2((at.x + film.crop_x) / film.size_x, (at.y + film.crop_y) / film.size_y)
    ray, _ = camera.kind.sample_ray(camera.lens, position, aperture)
    offset = p - ray.o
    distance = torch.sqrt(dot(offset, offset))
    cone = camera_cone(camera, ray, position, aperture)
    # Far enough for the rounding of places in the world and of positions on the film.
    apart = torch.maximum(apart_at(p, distance) / (cone.width + cone.spread * distance), APART * film.size_x)
    apart = apart * (WIDER if through_media else 1.0) * torch.where(way == 1, -1.0, torch.where(way == 2, 1.0, 0.0))
    scale = apart / torch.sqrt(normal.x * normal.x + normal.y * normal.y).clamp_min(TINY)
    position = Vec2(((at.x + normal.x * scale + film.crop_x) / film.size_x).to(dtype),
                    ((at.y + normal.y * scale + film.crop_y) / film.size_y).to(dtype))
    aperture = None if aperture is None else aperture.map(lambda part: part.to(dtype))
    ray, weight = camera.kind.sample_ray(camera.lens, position, aperture)
    return CameraSample(ray, key, weight, camera_cone(camera, ray, position, aperture) if cones else None, None)


def apart_at(p: Vec3, distance: Tensor) -> Tensor:
    """The offset, in world units, of points on either side of a curve at p; `distance`: (N,) from the rays' origins."""
    return torch.maximum(APART * distance, ROUNDED * max_component(p.map(torch.abs)))
