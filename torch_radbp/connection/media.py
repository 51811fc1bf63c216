"""What the media of a scene leave of light on its way."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.connection.light import FAR, LightSample
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.tensors.differentiated import detached, settled
from torch_radbp.tensors.vec import TINY, Ray, Vec3, dot


def transmittance(scene: SceneTensors, ray: Ray, distance: Tensor) -> Vec3 | None:
    """The share of light that all media together let through over a distance along each ray, (N,); None: there are no media.

    Attached to the tables of the media, the rays and the distances.
    """
    through: Vec3 | None = None
    for kind, table in zip(scene.layout.media, scene.media):
        share = kind.transmittance(table, ray, distance)
        through = share if through is None else through * share
    return through


def way_through(scene: SceneTensors, proposal: SceneTensors, ray: Ray, distance: Tensor, flown: bool) -> Vec3 | None:
    """What light that surfaces send along rays counts by, (N,), for paths that have met them; None: there are no media.

    In a medium that scatters only some flights reach the surface, so that those count by transmittance over the probability
    to get there.

    Args:
        scene, ray, distance: as for `transmittance`.
        proposal: the scene, detached; has the probability.
        flown: whether flights were sampled.
    """
    through, number = transmittance(scene, ray, distance), scene.layout.scattering_medium
    if not flown or number is None:
        return through
    _, reaches = scene.layout.media[number].flight_pdf(proposal.media[number], detached(ray), distance.detach(),
                                                         distance.detach())
    return through / settled(reaches).clamp_min(TINY)


def attenuated(light: Vec3, through: Vec3 | None) -> Vec3:
    """Light of which a share is let through; None: all of it."""
    return light if through is None else light * through


def transmittance_to_light(scene: SceneTensors, start: Vec3, light: LightSample) -> Vec3 | None:
    """The same from points to light samples, (N,)."""
    if not scene.layout.media:
        return None
    reach = light.target - start
    distance = torch.sqrt(dot(reach, reach).clamp_min(TINY))
    if light.distant is not None:
        distance = torch.where(light.distant, FAR, distance)
    return transmittance(scene, Ray(start, light.d), distance)
