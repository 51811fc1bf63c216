"""Where the paths of a call begin.

The paths of an image begin at the cameras of its views. A source of another kind is a class with this interface: it makes
the rays of a chunk's lanes from a record of tensors, and the backward pass hands it the adjoints of these rays.
"""

from __future__ import annotations

import functools
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from torch_radbp.call.chunks import Chunk, LaneBlock, Rows
from torch_radbp.call.view import View
from torch_radbp.film.window import Window
from torch_radbp.path.camera_rays import CameraSample, film_place, sample_camera
from torch_radbp.raycast.protocol import Hit
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.sensor.kind import Camera
from torch_radbp.tensors.differentiated import detached
from torch_radbp.tensors.record import leaves_of
from torch_radbp.tensors.stage import EAGER, Stages
from torch_radbp.tensors.vec import Vec2

FEW = 1 << 16  # lanes whose numbers are kept for the next call


class PathSource(ABC):
    """The interface of where paths begin. Random numbers are of two kinds: 0 for the image, 1 for its derivative."""

    @property
    @abstractmethod
    def tensors(self) -> Any:
        """The record of tensors on which the rays depend, attached."""

    @abstractmethod
    def with_tensors(self, tensors: Any) -> PathSource:
        """The same source with other tensors, whose tables are read by `lookup`."""

    @abstractmethod
    def samples(self, chunk: LaneBlock, which: int, stages: Stages, cones: bool) -> CameraSample:
        """The first rays of a chunk's paths, (chunk.lanes,), attached to `tensors`.

        Args:
            chunk: one of the call's wavefronts' chunks.
            which: the kind of random numbers, 0 or 1.
            stages: runs the stages.
            cones: whether rays get ray cones.
        """

    @abstractmethod
    def of_derivative(self) -> PathSource:
        """The source whose image has the random numbers of the derivative."""

    def glued(self, chunk: LaneBlock, which: int, scene: SceneTensors, hit: Hit) -> CameraSample:
        """The first rays of a chunk's paths, which follow the points that they hit, and are attached to these, if the source
        has such rays; others are as of `samples`. In plain torch.

        Args:
            scene: the scene, attached.
            hit: (chunk.lanes,) what the rays hit.
        """
        return self.samples(chunk, which, EAGER, scene.layout.traces_cones)

    @property
    def columns(self) -> int:
        """The number of lanes in one sample of a row of pixels; 1: lanes belong to no pixels."""
        return 1

    def pilots(self, lanes: int, stages: Stages, cones: bool) -> CameraSample:
        """The first rays of a few paths from all over the source, (lanes,), by which memory is predicted; args as of
        `samples`."""
        raise TypeError(f"the memory of paths from {type(self).__name__} is not predicted")

    def leaves_read(self, chunk: LaneBlock) -> range:
        """The indices of the tensors on which the rays of a chunk depend, as `leaves_of(tensors)` counts them."""
        return range(len(leaves_of(self.tensors)))

    def clipping(self, chunk: LaneBlock) -> Camera | None:
        """The camera whose far plane ends the rays of a chunk; None: there is none."""
        return None

    def still(self) -> PathSource:
        """The same source without derivatives."""
        return self._still

    @functools.cached_property
    def _still(self) -> PathSource:
        return self.with_tensors(detached(self.tensors))


@dataclass(frozen=True)
class Cameras(PathSource):
    """The cameras of a call's views as the source of paths: each lane begins at a sample of a pixel."""

    views: list[View]

    @property
    def tensors(self) -> list[Camera]:
        return [view.camera for view in self.views]

    def with_tensors(self, tensors: list[Camera]) -> Cameras:
        return Cameras([view._replace(camera=camera) for view, camera in zip(self.views, tensors)])

    def samples(self, chunk: Chunk, which: int, stages: Stages, cones: bool) -> CameraSample:
        view = self.views[chunk.sensor]
        return stages(sample_camera)(view.camera, view.orders[which], *self.numbers(chunk), view.sample_keys[which], cones)

    @property
    def columns(self) -> int:
        return max(view.grid.columns for view in self.views)

    def pilots(self, lanes: int, stages: Stages, cones: bool) -> CameraSample:
        view, grid, device = self.views[0], self.views[0].grid, self.views[0].camera.film.size_x.device
        pixel = torch.linspace(0, grid.columns * grid.rows - 1, lanes, dtype=torch.float64, device=device).to(torch.int32)
        sample = torch.arange(lanes, dtype=torch.int32, device=device)
        number = view.window.numbers(pixel % grid.columns, torch.div(pixel, grid.columns, rounding_mode="floor"))
        return stages(sample_camera)(view.camera, view.orders[0], number, sample, view.sample_keys[0], cones)

    def places(self, chunk: Chunk, which: int, stages: Stages) -> Vec2:
        """The positions of a chunk's lanes in their pixels, (N,) in [0, 1)."""
        view = self.views[chunk.sensor]
        return stages(film_place)(view.camera.film.size_x, view.orders[which], *self.numbers(chunk), view.sample_keys[which])

    def numbers(self, chunk: Chunk) -> tuple[Tensor, Tensor]:
        """For each lane of a chunk the number of its pixel and of its sample, (N,) int32 each; pixel by pixel."""
        view, find = self.views[chunk.sensor], lane_numbers if chunk.lanes > FEW else known_lane_numbers
        return find(chunk.rows, chunk.first_sample, chunk.samples, view.window, view.camera.film.size_x.device)

    def of_derivative(self) -> Cameras:
        return Cameras([view._replace(sample_keys=view.sample_keys[1:] * 2, orders=view.orders[1:] * 2)
                        for view in self.views])

    def leaves_read(self, chunk: Chunk) -> range:
        counts = [len(leaves_of(camera)) for camera in self.tensors[:chunk.sensor + 1]]
        return range(sum(counts[:-1]), sum(counts))

    def clipping(self, chunk: Chunk) -> Camera | None:
        view = self.views[chunk.sensor]
        return view.camera if view.clips else None


def lane_numbers(rows: Rows, first_sample: int, samples: int, window: Window, device: torch.device) -> tuple[Tensor, Tensor]:
    """The pixel and sample numbers, as of `Cameras.numbers`, of some samples of some rows of a window."""
    with torch.inference_mode(False):  # they may be kept, for renderings that are differentiated
        pixel = rows.numbers(device, window.numbered) + window.numbers(0, 0)
        sample = torch.arange(samples, dtype=torch.int32, device=device) + first_sample
        return pixel.repeat_interleave(samples), sample.repeat(len(pixel))


known_lane_numbers = functools.lru_cache(maxsize=64)(lane_numbers)
