"""The interface between vertices and the recursion: what happens to light at one, as the terms of

    L_k = E_k + F_k L_{k+1},    E_k = Le + visible Ld

A surface is one kind of vertex (`surface.py`), the end of a path another (`path_end.py`). A kind is a hashable value without
fields that names the functions; the part of a scene that lanes read says which kind theirs is (`Layout.vertex`).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import torch
from torch import Tensor

from torch_radbp.connection.light import LightSample
from torch_radbp.interface.texture import Place, TextureValue
from torch_radbp.path.light_share import next_first
from torch_radbp.path.state import Arrival, PathState, Position, Settings
from torch_radbp.raycast.protocol import Hit
from torch_radbp.scene.tables.light_tree import Vantage
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.scene.tables.triangle_corners import Corners
from torch_radbp.tensors.vec import Ray, Vec2, Vec3
from torch_radbp.vertex.cone import Cone


class Terms(NamedTuple):
    """The terms of L_k = (Le + visible Ld) + F L_{k+1} at one vertex per lane, and the choices behind them.

    F = weight * thinning.
    """

    Le: Vec3  # emission, weighted against next-event estimation, as Ld and F after the way through media
    Ld: Vec3  # light by next-event estimation if the shadow ray is free
    light: LightSample | None  # None without next-event estimation, which ideal lobes and the ends of paths have not
    weight: Vec3 | None  # scattering times cosine over the density of the sampled direction
    thinning: Tensor | Vec3 | None  # what F has from media, and from roulette: 1 / survival probability
    pdf: Tensor | None  # density of the sampled direction over solid angle
    survives: Tensor  # bool: the path goes on
    place: Any  # what the kind knows of the vertex
    narrow: Tensor | None = None  # bool: all of it scatters narrowly, see `light_share.py`; None: only ideal lobes do

    def film(self, scene: SceneTensors) -> Vec2 | None:
        """The film positions of vertices of paths from lamps, see `LightSample`; arbitrary for those not connected to the
        camera."""
        if not scene.layout.from_lamps:
            return None
        return Vec2(torch.zeros_like(self.pdf), torch.zeros_like(self.pdf)) if self.light is None else self.light.film


@dataclass(frozen=True)
class VertexKind(ABC):
    """The formulas at one kind of path vertex; all tensors are (N,)."""

    scatters: ClassVar[bool] = True  # paths may go on from it

    @abstractmethod
    def places(self, scene: SceneTensors, proposal: SceneTensors, arrival: Arrival, at: Position,
               settings: Settings) -> tuple[Place, ...]:
        """The points at which network textures are evaluated, attached to the scene, and to the ray if it moves.

        Args as for `terms`. In order: for each network texture of the material, the vertex; for each network texture of
        emitters, the point where the ray hits an emitter, and, if light is scattered, that of the light sample.
        """

    @abstractmethod
    def terms(self, scene: SceneTensors, proposal: SceneTensors, arrival: Arrival, at: Position, settings: Settings,
              texture_values: tuple[TextureValue, ...], here: Corners | None = None) -> Terms:
        """The terms of the recursion L_k = E_k + F_k L_{k+1} at the vertices.

        Args:
            scene: attached; the part of it that these lanes read.
            proposal: the same, detached; decides samples, densities, weights and survival.
            arrival: the paths that reach the vertices.
            at: the depth.
            settings: the integrand.
            texture_values: the values of network textures at the `places`.
            here: the corners of the triangles that are hit; None: as the scene has them.
        """

    def origin(self, terms: Terms, d: Vec3) -> Vec3:
        """The origins of rays that leave the vertices in direction `d`."""
        raise TypeError(f"nothing leaves a {type(self).__name__}")

    def vantage(self, terms: Terms) -> Vantage:
        """The vertices as reference points, on which the selection of lights depends."""
        raise TypeError(f"nothing leaves a {type(self).__name__}")

    def medium(self, scene: SceneTensors, terms: Terms, arrival: Arrival, d: Vec3) -> Tensor:
        """The numbers of the media that rays enter in direction `d`, int32, where media have boundaries."""
        raise TypeError(f"nothing leaves a {type(self).__name__}")

    def ray(self, terms: Terms) -> Ray:
        """The rays along which paths go on."""
        raise TypeError(f"nothing leaves a {type(self).__name__}")

    def attached_ray(self, scene: SceneTensors, terms: Terms, following: Hit, sampling: str,
                     there: Corners | None = None) -> tuple[Vec3, Ray]:
        """The factor of light from the next vertex, and the rays towards it, with the derivatives that `sampling` includes.

        Args:
            scene: attached; gives the geometry of the next vertex.
            terms: of this vertex, attached.
            following: what the ray hits.
            sampling: "detached", "hybrid" or "attached".
            there: the corners of the triangles that it hits; None: as the scene has them.
        """
        raise TypeError(f"nothing leaves a {type(self).__name__}")

    def cone(self, terms: Terms, cone: Cone) -> Cone:
        """The ray cones around the next rays; attached. `cone`: around the rays that arrive."""
        raise TypeError(f"nothing leaves a {type(self).__name__}")

    def follows(self, terms: Terms) -> bool:
        """True if hybrid sampling differentiates the next direction."""
        return False

    def ahead(self, terms: Terms, state: PathState, ray: Ray, beta: Vec3, settings: Settings) -> PathState:
        """The states of paths that go on along a ray in the same medium, without `vantage`.

        Args:
            terms: of the vertices.
            state: of the paths that arrive.
            ray: the next.
            beta: the next throughput.
            settings: the integrand.
        """
        return PathState(
            ray, beta, terms.pdf, state.key, state.lane, None,
            torch.full_like(state.followed, self.follows(terms)) if settings.following else None,
            None if state.cone is None else self.cone(terms, state.cone), state.medium,
            next_first(state, terms.pdf, terms.narrow))
