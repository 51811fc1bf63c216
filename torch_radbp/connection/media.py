"""What the media of a scene leave of light on its way."""

from __future__ import annotations

from torch import Tensor

from torch_radbp.connection.light import LightSample, connection_of
from torch_radbp.interface.medium import MediumWay
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.tensors.differentiated import settled
from torch_radbp.tensors.vec import Ray, Vec3


def transmittance(scene: SceneTensors, ray: Ray, distance: Tensor) -> Vec3 | None:
    """The transmittance of the medium around everything over a distance along each ray, (N,); None: there is none.

    Attached to the table of the medium, the rays and the distances. For scenes whose media have no boundaries.
    """
    number = scene.layout.around
    if number is None:
        return None
    return scene.layout.media[number].transmittance(scene.media[number], ray, distance)


def transmittance_of(scene: SceneTensors, ray: Ray, ways: tuple[MediumWay, ...]) -> Vec3:
    """The product of the transmittances of all media along rays, (N,), attached to their tables.

    The derivative of a transmittance T over a length l is - T l times that of the extinction at a uniformly sampled point,
    however T was estimated. There is no division, so that it is right at an extinction of 0, too.

    Args:
        ray: (N,).
        ways: (N,) along the ray, through each of `Layout.media`.
    """
    through = Vec3.full(ray.d.x, 1.0)
    for kind, table, way in zip(scene.layout.media, scene.media, ways):
        if not kind.heterogeneous:
            through = through * kind.transmittance(table, ray, way.length)
            continue
        extinction = kind.extinction(table, ray.o + ray.d * way.place, ray.d)
        loss = extinction * way.length
        through = through * way.left * (loss - loss.map(settled)).map(lambda change: 1.0 - change)
    return through


def attenuated(light: Vec3, through: Vec3 | None) -> Vec3:
    """Light times a transmittance; None: 1."""
    return light if through is None else light * through


def transmittance_to_light(scene: SceneTensors, start: Vec3, light: LightSample) -> Vec3 | None:
    """The `transmittance` from points to light samples, (N,); None: without medium, or where media have boundaries."""
    if scene.layout.around is None or scene.layout.traces_segments:
        return None
    return transmittance(scene, *connection_of(start, light))
