"""Connections from the vertices of paths to lights: next-event estimation, and what comes without it weighted against it.

A connection begins at any reference point: what scatters there is told by a function of the direction. It is worth the
light's radiance times the share that reaches the point, which is 0 or 1 by the shadow ray, and by what media let through.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from torch_radbp.connection.light import LightSample
from torch_radbp.connection.media import attenuated, transmittance_to_light
from torch_radbp.interface.texture import TextureValue
from torch_radbp.path.light_share import meets_lamps
from torch_radbp.path.state import LIGHT_CHOICE, LIGHT_SPLIT, LIGHT_U, LIGHT_V, Arrival, Settings
from torch_radbp.sampling.mis import power_heuristic
from torch_radbp.sampling.sampler import BounceKey, random_bits
from torch_radbp.scene.tables.light_choice import LightNumbers
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.tensors.vec import Vec3, masked, max_component
from torch_radbp.vertex.emission import emitted, emitted_by_surface, emitted_pdf, pdf_of_surface
from torch_radbp.vertex.interaction import SurfaceInteraction

ScattersTo = Callable[[Vec3], tuple[Vec3, Tensor]]  # a direction to scattering times cosine, and the density of sampling it


def light_numbers(key: BounceKey) -> LightNumbers:
    """The random numbers of a bounce for sampling a light."""
    return LightNumbers(*(random_bits(key, dimension) for dimension in (LIGHT_CHOICE, LIGHT_SPLIT, LIGHT_U, LIGHT_V)))


def connected_to_light(scene: SceneTensors, p: Vec3, valid: Tensor, scatters_to: ScattersTo, light: LightSample,
              sampling: str) -> tuple[LightSample, Vec3]:
    """Next-event estimates without shadows, and their light samples, of density 0 where these cannot connect.

    Args:
        scene: attached; has the media.
        p: (N,) reference points, attached.
        valid: (N,) bool: there is a reference point.
        scatters_to: scattering times cosine and density for a direction.
        light: the samples, as seen from there.
        sampling: which sampled directions are differentiated: "attached" where the density of scattering is.
    """
    scattered, pdf = scatters_to(light.d)
    # Where scattering is not sampled and not zero the light counts in full; where it is zero but sampled it has derivatives.
    connects = valid & (light.pdf > 0) & ((pdf > 0) | (max_component(scattered.detach()) > 0))
    chance, connects = torch.where(connects, light.pdf, 1.0), connects.to(pdf.dtype)
    weighing = chance if light.weighing is light.pdf else torch.where(connects > 0, light.weighing, 1.0)
    weight = mis_weight(weighing, pdf * light.findable, sampling)
    Ld = attenuated(scattered * light.radiance * (connects * weight / chance), transmittance_to_light(scene, p, light))
    return light._replace(pdf=light.pdf.detach() * connects), Ld


def emission(scene: SceneTensors, proposal: SceneTensors, arrival: Arrival, si: SurfaceInteraction, settings: Settings,
             texture_values: tuple[TextureValue, ...]) -> Vec3:
    """The emission that rays meet, MIS-weighted against next-event estimation at their origins.

    Args as for `VertexKind.terms`. At the end of paths, emission includes the light of the environment.
    """
    ray, on_surfaces = arrival.state.ray, scene.layout.scatterer is not None
    Le = Vec3.full(ray.d.x, 0.0)
    if not settings.hide_emitters:
        Le = (emitted_by_surface(scene, si, texture_values) if on_surfaces else emitted(scene, ray, si, texture_values))
        ours = meets_lamps(settings, arrival.state, si.valid)
        Le = Le if ours is None else masked(ours, Le)
    if not settings.nee:
        return Le
    follows = settings.following and settings.moving
    geometry = scene if settings.sampling == "attached" or follows else proposal
    other = (pdf_of_surface(geometry, si, proposal, arrival.picked) if on_surfaces
             else emitted_pdf(geometry, ray, si, proposal, arrival.picked))
    weight = mis_weight(arrival.state.pdf, other, "attached" if follows else settings.sampling)
    return Le * (torch.where(arrival.state.followed, weight, weight.detach()) if follows else weight)


def mis_weight(pdf: Tensor, other: Tensor, sampling: str) -> Tensor:
    """The MIS weight by the power heuristic; attached only if the densities' derivative is needed."""
    weight = power_heuristic(pdf, other)
    return weight if sampling == "attached" else weight.detach()
