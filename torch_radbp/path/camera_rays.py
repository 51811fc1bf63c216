"""The rays of a camera: one for each sample of a pixel, with the keys of its random numbers."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.sampling.sampler import (
    CAMERA_COUNTER,
    BounceKey,
    FilmOrder,
    LaneKey,
    SampleKey,
    bounce_key,
    film_lane_key,
    uniform,
)
from torch_radbp.sensor.kind import Camera
from torch_radbp.tensors.stage import stage
from torch_radbp.tensors.vec import Ray, Vec2, Vec3
from torch_radbp.vertex.cone import Cone, camera_cone

FILM_U, FILM_V, APERTURE_U, APERTURE_V = range(4)  # the random numbers of a camera ray


class CameraSample(NamedTuple):
    """The rays with which N paths begin, with the keys of their random numbers."""

    ray: Ray
    key: LaneKey  # of random numbers
    weight: Tensor | None  # camera weight of their radiance; None: 1
    cone: Cone | None  # ray cone; None if no texture is filtered
    place: Vec2 | None  # position in the pixel, in [0, 1); None: they belong to no pixel
    slides: Tensor | None = None  # bool: what rays meet first slides with them, and is not glued; None: all does
    power: Vec3 | None = None  # linear RGB throughput with which they begin, attached; None: 1


@stage("camera")
def sample_camera(camera: Camera, order: FilmOrder, pixel: Tensor, sample: Tensor, key: SampleKey,
                  cones: bool) -> CameraSample:
    """Samples one camera ray per lane.

    Args:
        camera: the sensor.
        order: the order of the film's pixels.
        pixel, sample: (N,) int32, row-major number of the pixel on the film and number of the sample in it.
        key: the key of the rendering's random numbers.
        cones: whether rays get ray cones, which textures are filtered by.
    """
    lane = film_lane_key(order, pixel, sample, key)
    camera_key = bounce_key(lane, CAMERA_COUNTER)
    row = torch.div(pixel, order.width, rounding_mode="floor")
    column = pixel - row * order.width
    place = place_in_pixel(camera_key, camera.dtype)
    aperture = None
    if camera.kind.has_aperture:
        aperture = Vec2(*(uniform(camera_key, dimension, camera.dtype) for dimension in (APERTURE_U, APERTURE_V)))
    ray, weight = camera.sample_ray(column, row, place, aperture)
    cone = camera_cone(camera, ray, camera.film.position(column, row, place), aperture) if cones else None
    return CameraSample(ray, lane, weight, cone, place)


@stage()
def film_place(like: Tensor, order: FilmOrder, pixel: Tensor, sample: Tensor, key: SampleKey) -> Vec2:
    """The position of each sample in its pixel, (N,) in [0, 1), as `sample_camera` draws it; `like` has the dtype, the other
    args are as for that."""
    return place_in_pixel(bounce_key(film_lane_key(order, pixel, sample, key), CAMERA_COUNTER), like.dtype)


def place_in_pixel(key: BounceKey, dtype: torch.dtype) -> Vec2:
    """Random positions in a pixel, (N,) in [0, 1)."""
    return Vec2(*(uniform(key, dimension, dtype) for dimension in (FILM_U, FILM_V)))
