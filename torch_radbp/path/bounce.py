"""One bounce of path tracing.

With L_k the radiance that leaves vertex k towards vertex k-1,

    L_k = E_k + F_k L_{k+1}

where E_k is what the vertex emits plus the light that reaches it by next-event estimation, and F_k is BSDF times cosine over
the density of the sampled direction (and over the probability of surviving roulette). `bounce` computes E_k, F_k and the
next ray. The image is L_1: `wavefront.py` sums it forwards, with the throughput beta_k = F_1 ... F_{k-1}, and
`adjoint/sweep.py` walks it backwards.

A bounce is computed for lanes with one and the same event, such as meeting a surface of one appearance, so that none pays
for what others meet. What E_k and F_k are there says the kind of vertex: `surface.py`, `path_end.py`.

Reference: Li 2020, "Deriving Radiative Backpropagation using the Recursive Form of Path Tracing"; Kajiya 1986.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.connection.light import shadow_ray
from torch_radbp.interface.texture import Place, TextureValue
from torch_radbp.path.state import Arrival, PathState, Position, Settings
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.tensors.stage import stage
from torch_radbp.tensors.vec import Ray, Vec2, Vec3, masked, rows


class Vertex(NamedTuple):
    """A path vertex as the loop over bounces sees it: its terms, its shadow ray and its continuation."""

    Le: Vec3 | None  # None, as the next one, if radiance is not computed
    Ld: Vec3 | None
    F: Vec3 | None  # None unless `Settings.factors`
    shadow: Ray
    shadow_distance: Tensor  # 0: nothing to connect to
    shadow_medium: Tensor | None  # int32, in which it begins, -1: none; None: rays are not followed
    next: PathState  # undefined where the path ends
    survives: Tensor  # bool: the path goes on
    film: Vec2 | None = None  # where the camera sees it, as of `LightSample`; None: paths begin at the camera


@stage("scene", "arrival")
def places(scene: SceneTensors, arrival: Arrival, lanes: Tensor, at: Position, settings: Settings) -> tuple[Place, ...]:
    """The points at which a bounce's lanes look up network textures, as `VertexKind.places` lists them; detached. Args as
    for `bounce`."""
    return scene.layout.vertex.places(scene, scene, rows(arrival, lanes), at, Settings(nee=settings.nee))


@stage("scene", "proposal", "arrival")
def ending(scene: SceneTensors, proposal: SceneTensors, arrival: Arrival, lanes: Tensor, at: Position,
           settings: Settings, texture_values: tuple[TextureValue, ...]) -> Vec3:
    """Emission seen by M paths that end here, where nothing scatters: L_k = E_k, the end of the recursion; attached.

    Args as for `bounce`; `scene` is a part of the scene without scattering.
    """
    return scene.layout.vertex.terms(scene, proposal, rows(arrival, lanes), at, settings, texture_values).Le


@stage("scene", "proposal", "arrival")
def bounce(scene: SceneTensors, proposal: SceneTensors, arrival: Arrival, lanes: Tensor, at: Position,
           settings: Settings, texture_values: tuple[TextureValue, ...]) -> Vertex:
    """One step of the recursion L_k = E_k + F_k L_{k+1}: the terms at M path vertices, their shadow rays, and the next rays.

    Args:
        scene: attached; the part of it that these lanes read, with what scatters there.
        proposal: the same, detached; decides samples, densities, weights and survival.
        arrival: the paths that reach this bounce.
        lanes: (M,) int32, those of them that are computed, in this order.
        at: the depth of this bounce.
        settings: the integrand.
        texture_values: (M,) the values of network textures, which are evaluated beforehand.

    Returns:
        The M vertices. `Le`, `Ld` and `F`, and so the throughput, are attached to `scene`, everything else is detached.
    """
    arrival, kind = rows(arrival, lanes), scene.layout.vertex
    state = arrival.state
    terms = kind.terms(scene, proposal, arrival, at, settings, texture_values)

    # Aim the shadow ray at the light sample.
    shadow, distance = state.ray, torch.zeros_like(state.pdf)
    if terms.light is not None:
        shadow, distance = shadow_ray(kind.origin(terms, terms.light.d.detach()), terms.light)

    # Leave along the sampled direction.
    F = terms.weight * terms.thinning
    ahead = kind.ahead(terms, state, kind.ray(terms), state.beta * F, settings)
    if state.vantage is not None:
        ahead = ahead._replace(vantage=kind.vantage(terms))
    of_shadow = None
    if scene.layout.traces_segments:
        of_shadow, of_ray = (kind.medium(scene, terms, arrival, ray.d) for ray in (shadow, ahead.ray))
        ahead = ahead._replace(medium=of_ray)
    shown = (terms.Le, terms.Ld) if settings.shown else (None, None)
    film = terms.film(scene) if settings.shown else None
    return Vertex(*shown, F if settings.factors else None, shadow, distance, of_shadow, ahead, terms.survives, film)


def gathered(Le: Vec3, Ld: Vec3, visible: Tensor) -> Vec3:
    """E_k: emission `Le`, plus the next-event estimate `Ld` where the shadow ray is unoccluded."""
    return Le + masked(visible, Ld)
