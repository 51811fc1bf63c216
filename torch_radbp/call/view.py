"""The view of one sensor in a call: camera, window and random numbers."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import torch

from torch_radbp.film.develop import Grid
from torch_radbp.film.window import Window
from torch_radbp.interface.instances import Instances
from torch_radbp.plugin import Sensor
from torch_radbp.sampling.sampler import APART, FilmOrder, SampleKey, film_order, sample_key
from torch_radbp.scene.cache.pack_cache import PackCache
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.sensor.kind import Camera
from torch_radbp.tensors.asked_later import presumed
from torch_radbp.tensors.differentiated import detached
from torch_radbp.tensors.vec import Vec3

BLOCK = 8  # pixels
OF_NO_SENSOR = -1  # the index of a sensor that is none of the scene's


class View(NamedTuple):
    """One sensor of a call with its camera, window and random number keys."""

    sensor: Sensor
    camera: Camera  # attached
    window: Window  # of its film
    sample_keys: tuple[SampleKey, SampleKey]  # of the forward pass, and of the backward pass
    orders: tuple[FilmOrder, FilmOrder]  # orders in which pixels take points of the sequence, likewise
    clips: bool  # True if something lies beyond the far plane

    @property
    def width(self) -> int:
        """The width of the image in pixels."""
        return self.window.columns.size

    @property
    def height(self) -> int:
        return self.window.rows.size

    @property
    def apart(self) -> FilmOrder:
        """A film order that gives each pixel a separate random sequence, for paths that start anywhere."""
        return film_order(self.window.numbered, APART, self.camera.film.size_x.device)

    @property
    def grid(self) -> Grid:
        """The pixel grid of the film's window."""
        return Grid(self.camera.film.kernel, self.window)


class Shot(NamedTuple):
    """An image that a call is to make: a sensor and a window."""

    sensor: Sensor
    index: int  # index of the sensor in the scene, or `OF_NO_SENSOR`
    window: Window  # of its film


def view_of(shot: Shot, seeds: tuple[int, int], own: bool, spp: int, scene: SceneTensors, cache: PackCache) -> View:
    """The view of a shot, with seeds for the forward and the backward pass, and `spp` samples per pixel.

    The gradient of a squared error sums products of the noise of the image and that of the derivative over pixels. If both
    were found in the same high frequencies, that sum would be noisier than that of independent pixels. So a derivative's own
    samples are as good as independent within `BLOCK` x `BLOCK` pixels, and fill gaps from block to block. `own`: the
    derivative has samples of its own; else those of an image with its seed.
    """
    sensor, sampler = shot.sensor, shot.sensor.sampler
    reach = cache.inventory(sensor).reach((sensor,))
    camera = cache.part(("camera", id(sensor)), camera_of, sensor, reach, sensor)
    keys = tuple(sample_key(seed + sampler.seed, shot.index, sampler.low_discrepancy, scene.device) for seed in seeds)
    place = "reaches", id(sensor)
    beyond = partial(reaches_beyond, last=bool(cache.made_last(place)))
    reaches = cache.part(place, beyond, sensor, reach, scene.triangles.vertices.p, scene.triangles.casting_instances, camera)
    if shot.window != sensor.film.window():
        camera = camera._replace(film=sensor.film.tensors(camera.film.size_x, shot.window))
    width, device = shot.window.numbered, scene.device
    orders = tuple(film_order(width, spp, device, block) for block in (1, BLOCK if own else 1))
    return View(sensor, camera, shot.window, keys, orders, reaches)


def camera_of(cache: PackCache, sensor: Sensor) -> Camera:
    """The camera of a sensor with its whole film, attached; cached."""
    return cache(_tensors_of, cache.twin("sensor", sensor))


def _tensors_of(sensor: Sensor) -> Camera:
    """The camera tensors of a sensor's copy, for `camera_of`."""
    return sensor.tensors()


def reaches_beyond(cache: PackCache, vertices: Vec3, instances: Instances | None, camera: Camera, last: bool) -> bool:
    """True if any vertex or corner of an instance's box lies beyond the camera's far plane. `last`: the result of the last
    rendering."""
    points = vertices.detach()
    if instances is not None:
        own, boxes = instances.first_vertex[0], Vec3.of(instances.boxes.flatten(0, 1))
        points = Vec3(*(torch.cat([own_vertices[:own], corners]) for own_vertices, corners in zip(points, boxes)))
    return presumed(detached(camera).beyond_far_plane(points).any(), last)
