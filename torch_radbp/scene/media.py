"""What the media of a scene leave of light on its way."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.scene.light import FAR, LightSample
from torch_radbp.scene.tensors import SceneTensors
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
