"""What one sensor of a call sees."""

from __future__ import annotations

from typing import NamedTuple

from torch_radbp.differentiated import detached
from torch_radbp.plugin import Sensor
from torch_radbp.sampling.sampler import SampleKey, sample_key
from torch_radbp.scene.kept import Kept
from torch_radbp.scene.tensors import SceneTensors
from torch_radbp.sensor.kind import Camera
from torch_radbp.vec import Vec3


class View(NamedTuple):
    """One sensor of a call."""

    camera: Camera  # attached
    width: int  # of the crop window, pixels
    height: int
    sample_keys: tuple[SampleKey, SampleKey]  # of the forward pass, and of the backward pass
    clips: bool  # whether something lies beyond the far plane


def view_of(sensor: Sensor, index: int, seeds: tuple[int, int], scene: SceneTensors, kept: Kept) -> View:
    """What a sensor, number `index` of the scene's, sees in a call with these seeds, forwards and backwards."""
    sampler, film = sensor.sampler, sensor.film
    camera = kept(camera_of, kept.twin(id(sensor), sensor))
    keys = tuple(sample_key(seed + sampler.seed, index, sampler.low_discrepancy, scene.device) for seed in seeds)
    return View(camera, film.crop_width, film.crop_height, keys, kept(reaches_beyond, scene.triangles.vertices.p, camera))


def camera_of(sensor: Sensor) -> Camera:
    """The camera of a sensor, attached."""
    return sensor.tensors()


def reaches_beyond(vertices: Vec3, camera: Camera) -> bool:
    """True if any of some vertices, (V,), lies beyond the far plane of a camera."""
    return bool(detached(camera).beyond_far_plane(vertices.detach()).any())
