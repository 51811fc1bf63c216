"""What one sensor of a call sees."""

from __future__ import annotations

from typing import NamedTuple

import torch

from torch_radbp.differentiated import detached
from torch_radbp.film.develop import Grid
from torch_radbp.plugin import Sensor
from torch_radbp.sampling.sampler import SampleKey, sample_key
from torch_radbp.scene.pack_cache import PackCache
from torch_radbp.scene.tensors import SceneTensors
from torch_radbp.sensor.kind import Camera
from torch_radbp.shape.placement import Instances
from torch_radbp.vec import Vec3


class View(NamedTuple):
    """One sensor of a call."""

    camera: Camera  # attached
    width: int  # of the crop window, pixels
    height: int
    sample_keys: tuple[SampleKey, SampleKey]  # of the forward pass, and of the backward pass
    clips: bool  # whether something lies beyond the far plane

    @property
    def grid(self) -> Grid:
        """The pixels that have samples."""
        film = self.camera.film
        return Grid(film.kernel, self.width + 2 * film.border, self.height + 2 * film.border, film.border)


def view_of(sensor: Sensor, index: int, seeds: tuple[int, int], scene: SceneTensors, cache: PackCache) -> View:
    """What a sensor, number `index` of the scene's, sees in a call with these seeds, forwards and backwards."""
    sampler, film = sensor.sampler, sensor.film
    camera = cache(camera_of, cache.twin(id(sensor), sensor))
    keys = tuple(sample_key(seed + sampler.seed, index, sampler.low_discrepancy, scene.device) for seed in seeds)
    instances = scene.triangles.instances
    reaches = cache(reaches_beyond, scene.triangles.vertices.p, None if instances is None else instances.casting, camera)
    return View(camera, film.crop_width, film.crop_height, keys, reaches)


def camera_of(sensor: Sensor) -> Camera:
    """The camera of a sensor, attached."""
    return sensor.tensors()


def reaches_beyond(vertices: Vec3, instances: Instances | None, camera: Camera) -> bool:
    """True if any vertex, (V,), or a corner of the box around an instance lies beyond the far plane of a camera."""
    points = vertices.detach()
    if instances is not None:
        own, boxes = int(instances.first_vertex[0]), Vec3.of(instances.boxes.flatten(0, 1))
        points = Vec3(*(torch.cat([own_vertices[:own], corners]) for own_vertices, corners in zip(points, boxes)))
    return bool(detached(camera).beyond_far_plane(points).any())
