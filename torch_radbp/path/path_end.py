"""The end of the recursion, L_k = E_k: where nothing is scattered, only what is emitted counts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import torch

from torch_radbp.connection.light import FAR
from torch_radbp.connection.media import attenuated
from torch_radbp.interface.texture import Place, TextureValue
from torch_radbp.path.light_connection import emission
from torch_radbp.path.passage import shown_through, way_through
from torch_radbp.path.state import Arrival, Position, Settings
from torch_radbp.path.surface import surface_met
from torch_radbp.path.vertex import Terms, VertexKind
from torch_radbp.path.volume_emission import with_volume_emission
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.scene.tables.triangle_corners import Corners
from torch_radbp.tensors.vec import Vec3
from torch_radbp.vertex.emission import emission_places


@dataclass(frozen=True)
class PathEnd(VertexKind):
    """The last vertex of a path: on a surface, or in the surroundings."""

    scatters: ClassVar[bool] = False

    def places(self, scene: SceneTensors, proposal: SceneTensors, arrival: Arrival, at: Position,
               settings: Settings) -> tuple[Place, ...]:
        return emission_places(scene, surface_met(scene, arrival, settings)) if scene.layout.lit else ()

    def terms(self, scene: SceneTensors, proposal: SceneTensors, arrival: Arrival, at: Position, settings: Settings,
              texture_values: tuple[TextureValue, ...], here: Corners | None = None) -> Terms:
        si = surface_met(scene, arrival, settings, here)
        Le = emission(scene, proposal, arrival, si, settings, texture_values)
        distance = torch.where(si.valid, si.t, FAR)
        Le = attenuated(Le, shown_through(arrival, way_through(scene, arrival, distance)))
        Le = with_volume_emission(Le, scene, arrival, distance)
        return Terms(Le, Vec3.full(si.t, 0.0), None, None, None, None, torch.zeros_like(si.valid), si)


END = PathEnd()
