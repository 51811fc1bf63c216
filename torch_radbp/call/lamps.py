"""The lamps of a scene as the source of a call's paths."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torch_radbp.call.chunks import LaneRange
from torch_radbp.call.source import PathSource
from torch_radbp.interface.emitter import Surrounding
from torch_radbp.path.camera_rays import CameraSample
from torch_radbp.path.lamp_rays import LampTensors, MetFirst, sample_lamps
from torch_radbp.raycast.protocol import Hit
from torch_radbp.sampling.alias import alias_table
from torch_radbp.sampling.sampler import SampleKey
from torch_radbp.sampling.spheres import BoundingSphere
from torch_radbp.scene.tables.placement import points_in_world, power_of_two_above
from torch_radbp.scene.tables.scene_tensors import SceneTensors, of_triangles
from torch_radbp.scene.tables.triangle_corners import ROUNDINGS, at_corners
from torch_radbp.tensors.differentiated import any_differentiated
from torch_radbp.tensors.stage import EAGER, Stages
from torch_radbp.tensors.vec import Ray, Vec3, dot
from torch_radbp.vertex.interaction import corner_rows, is_met

MARGIN, LEAST_RADIUS = 1.001, 1e-6  # of spheres
MOST_TARGETS = 8  # spheres; code grows with them


@dataclass(frozen=True)
class Lamps(PathSource):
    """The lights of a scene as the source of paths: each lane begins with a ray that a light emits."""

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
        device = self.lamps.world.clearance.device
        lane = torch.arange(chunk.first, chunk.first + chunk.lanes, dtype=torch.int32, device=device)
        return stages(sample_lamps)(self.lamps, lane, self.keys[which], (), cones, None)

    def pilots(self, lanes: int, stages: Stages, cones: bool) -> CameraSample:
        return self.samples(LaneRange(0, lanes), 0, stages, cones)

    def glued(self, chunk: LaneRange, which: int, scene: SceneTensors, hit: Hit) -> CameraSample:
        device = self.lamps.world.clearance.device
        lane = torch.arange(chunk.first, chunk.first + chunk.lanes, dtype=torch.int32, device=device)
        corners = at_corners(scene.triangles.vertices.p, corner_rows(scene, hit))
        prim = torch.where(is_met(scene, hit), hit.prim, -1)
        met, cones = MetFirst(points_in_world(scene, hit, corners), hit._replace(prim=prim)), scene.layout.traces_cones
        return sample_lamps(self.lamps, lane, self.keys[which], (), cones, met)

    @property
    def ray(self) -> Ray:
        """One ray of a lamp, (1,): attached if rays, and not only their power, have derivatives."""
        if not any_differentiated(self.lamps):
            nothing = Vec3.buffer(self.lamps.world.clearance[None])
            return Ray(nothing, nothing)
        return self.samples(LaneRange(0, 1), 0, EAGER, False).ray


def lamps_as_source(scene: SceneTensors, keys: tuple[SampleKey, SampleKey], light_paths: str) -> Lamps:
    """The lights of a packed scene as a source of paths; without the environment, unless `light_paths` is "all".

    Raises:
        ValueError: if a lamp has a network texture, which can be evaluated at hit points only.
    """
    if scene.layout.lit:
        raise ValueError("paths cannot begin at lamps whose light is that of a network; give these a texture, or render "
                         "from the camera alone (light_paths=\"camera\")")
    lights = scene.lights
    if light_paths != "all" and scene.layout.surround is not None:
        pmf = lights.choice.pmf
        own = alias_table(torch.where(lights.kind == scene.layout.surround[0], torch.zeros_like(pmf), pmf))
        lights = lights._replace(choice=own)
    return Lamps(LampTensors(lights, scene.radiance, surrounding(scene, light_paths), scene.layout), keys)


def surrounding(scene: SceneTensors, light_paths: str) -> Surrounding:
    """The bounding spheres that rays of lamps must hit: of the scene, and, for caustics, of surfaces with ideal lobes."""
    points = scene.triangles.vertices.p.map(torch.Tensor.detach)
    instances = scene.triangles.casting_instances
    if instances is not None:
        own, boxes = instances.first_vertex[0], Vec3.of(instances.boxes.flatten(0, 1))
        points = Vec3(*(torch.cat([vertices[:own], corners]) for vertices, corners in zip(points, boxes)))
    extremes = [part.aminmax() for part in points]
    largest = torch.stack([torch.maximum(-least, most) for least, most in extremes]).max()
    around = sphere_around(*(Vec3(*side) for side in zip(*extremes)))
    targets = ideal_surfaces(scene) if light_paths == "caustics" and instances is None else ()
    return Surrounding(around, targets, ROUNDINGS * 2.0**-24 * power_of_two_above(largest))


def ideal_surfaces(scene: SceneTensors) -> tuple[BoundingSphere, ...]:
    """Bounding spheres of the surfaces of each material with ideal lobes, or one around all if there are many."""
    triangles, some = scene.triangles, narrow_triangles(scene)
    material = triangles.material[some].long()
    met, group = material.unique(return_inverse=True)
    if not len(met):
        return ()
    if len(met) > MOST_TARGETS:
        met, group = met[:1], torch.zeros_like(group)
    points = torch.stack([torch.stack([part.detach()[corner[some].long()] for part in triangles.vertices.p])
                          for corner in triangles.corners])  # (3 corners, 3 coordinates, triangles)
    first, groups = points.new_zeros(3, len(met)), group.expand(3, -1)
    least, most = (first.scatter_reduce(1, groups, getattr(points, side)(0), side, include_self=False)
                   for side in ("amin", "amax"))
    middle = 0.5 * (least + most)  # of the box, around which a ball needs a smaller sphere than around the box
    squared = (points - middle[:, group]).square().sum(1).amax(0)
    squared = squared.new_zeros(len(met)).scatter_reduce(0, group, squared, "amax", include_self=False)
    radii = (MARGIN * squared.sqrt()).clamp_min(LEAST_RADIUS)
    return tuple(BoundingSphere(Vec3(*at), radius) for at, radius in zip(middle.t(), radii))


def narrow_triangles(scene: SceneTensors) -> Tensor:
    """(T,) bool: triangles whose material has an ideal lobe, invisible ones aside, or a small roughness throughout."""
    materials = scene.materials
    ideal = [look for look, of in enumerate(scene.layout.appearances) if of.kind.delta and not of.kind.invisible]
    of_rows = torch.isin(materials.appearance, torch.tensor(ideal, device=scene.device))
    return of_triangles(scene, of_rows if materials.narrow is None else of_rows | materials.narrow)


def sphere_around(low: Vec3, high: Vec3) -> BoundingSphere:
    """The bounding sphere of a box, () each, slightly enlarged."""
    size = high - low
    return BoundingSphere((low + high) * 0.5, (0.5 * MARGIN * torch.sqrt(dot(size, size))).clamp_min(LEAST_RADIUS))
