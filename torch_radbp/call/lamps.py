"""The lamps of a scene as the source of a call's paths."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch

from torch_radbp.call.chunks import LaneRange
from torch_radbp.call.source import PathSource
from torch_radbp.interface.emitter import Surrounding
from torch_radbp.path.camera_rays import CameraSample
from torch_radbp.path.lamp_rays import LampTensors, sample_lamps
from torch_radbp.sampling.alias import alias_table
from torch_radbp.sampling.sampler import SampleKey
from torch_radbp.scene.tables.placement import power_of_two_above
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.scene.tables.triangle_corners import ROUNDINGS
from torch_radbp.tensors.stage import EAGER, Stages
from torch_radbp.tensors.vec import Ray, Vec3

MARGIN, LEAST_RADIUS = 1.001, 1e-6  # of the sphere around the scene


@dataclass(frozen=True)
class Lamps(PathSource):
    """The lights of a scene: each lane begins with a ray of one."""

    lamps: LampTensors
    keys: tuple[SampleKey, SampleKey]  # of the image, and of its derivative

    @property
    def tensors(self) -> LampTensors:
        return self.lamps

    def with_tensors(self, tensors: LampTensors) -> Lamps:
        return replace(self, lamps=tensors)

    def of_derivative(self) -> Lamps:
        return replace(self, keys=self.keys[1:] * 2)

    def samples(self, chunk: LaneRange, which: int, stages: Stages, cones: bool) -> CameraSample:
        lane = torch.arange(chunk.first, chunk.first + chunk.lanes, dtype=torch.int32, device=self.lamps.world.radius.device)
        return stages(sample_lamps)(self.lamps, lane, self.keys[which], ())

    @property
    def ray(self) -> Ray:
        """(1,) one of the rays: attached if they are, and not only their power."""
        return self.samples(LaneRange(0, 1), 0, EAGER, False).ray


def lamps_as_source(scene: SceneTensors, keys: tuple[SampleKey, SampleKey], light_paths: str) -> Lamps:
    """The lights of a packed scene as a source; unless paths bring "all" light, without the surroundings.

    Raises:
        ValueError: if a lamp's light is a network's, which is asked where surfaces are.
    """
    if scene.layout.lit:
        raise ValueError("paths cannot begin at lamps whose light is that of a network; give these a texture, or render "
                         "from the camera alone (light_paths=\"camera\")")
    lights = scene.lights
    if light_paths != "all" and scene.layout.surround is not None:
        pmf = lights.choice.pmf
        own = alias_table(torch.where(lights.kind == scene.layout.surround[0], torch.zeros_like(pmf), pmf))
        lights = lights._replace(choice=own)
    return Lamps(LampTensors(lights, scene.radiance, surrounding(scene), scene.layout), keys)


def surrounding(scene: SceneTensors) -> Surrounding:
    """A sphere around the box around the surfaces of a scene, detached."""
    points = scene.triangles.vertices.p.map(torch.Tensor.detach)
    instances = scene.triangles.casting_instances
    if instances is not None:
        own, boxes = int(instances.first_vertex[0]), Vec3.of(instances.boxes.flatten(0, 1))
        points = Vec3(*(torch.cat([vertices[:own], corners]) for vertices, corners in zip(points, boxes)))
    extremes = [part.aminmax() for part in points]
    middle = Vec3(*(0.5 * (least + most) for least, most in extremes))
    radius = 0.5 * MARGIN * torch.stack([most - least for least, most in extremes]).norm()
    largest = torch.stack([torch.maximum(-least, most) for least, most in extremes]).max()
    return Surrounding(middle, radius.clamp_min(LEAST_RADIUS), ROUNDINGS * 2.0**-24 * power_of_two_above(largest))
