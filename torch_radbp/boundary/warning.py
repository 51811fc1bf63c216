"""The warnings that a derivative lacks what silhouettes, or jumps of a BSDF, contribute.

A derivative of the image is a derivative of its pixels, plus what is gained and lost where one surface ends and another is
seen behind it. The second part is not computed yet. It is missing if a shape, or the camera, moves and silhouettes are in
view; of a surface that fills the view nothing is missing.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence

import torch
from torch import Tensor

from torch_radbp.boundary.edges import Edges, edges_of
from torch_radbp.boundary.silhouette import silhouettes_in_view
from torch_radbp.plugin import BSDF, Plugin, Sensor
from torch_radbp.scene import Scene
from torch_radbp.scene.differentiated import tangent_of
from torch_radbp.sensor.perspective import PinholeTensors

MOVE_SHAPES = ("to_world", "vertex_positions")
MOVE_VIEWS = ("to_world", "x_fov", "principal_point_offset_x", "principal_point_offset_y")


class SilhouetteWarning(UserWarning):
    """Derivatives are asked for that lack what silhouettes contribute."""


class JumpWarning(SilhouetteWarning):
    """Derivatives are asked for that lack what the jump of a BSDF contributes, a silhouette of its microfacets."""


class SilhouetteWatch:
    """Looks at every rendering until there is something to warn of; then it has warned, once of each kind."""

    def __init__(self) -> None:
        self.warned = self.warned_of_jumps = False
        self.known: dict[object, tuple[Tensor, Edges]] = {}  # edges of what was looked at, and the faces that made them

    def look(self, scene: Scene, sensors: Sequence[Sensor], cameras: Sequence[PinholeTensors]) -> None:
        """Warns if derivatives are asked for of what moves silhouettes that are seen. Hidden ones count as seen.

        Args:
            scene: with the parameters of this rendering.
            sensors: that are rendered.
            cameras: the same as tensors.
        """
        if self.warned:
            return
        missing = self.missing(scene, sensors, cameras)
        if missing:
            self.warned = True
            named = " and ".join(f"`{name}`" for name in missing)
            warnings.warn(f"derivatives of {named} lack what its silhouettes contribute: {max(missing.values())} edges move "
                          f"in view, where the image changes by a jump. A loss that depends on outlines, such as that of a "
                          f"shape before a background, has a biased gradient; check_gradient tells by how much",
                          SilhouetteWarning, stacklevel=level_of_the_caller())

    def look_for_jumps(self, scene: Scene, sensors: Sequence[Sensor]) -> None:
        """Warns if directions turn at rough glass that jumps with them, and do not carry derivatives; see `Kind.jumps`."""
        if self.warned_of_jumps:
            return
        one_sided = [plugin for plugin in scene.modules() if isinstance(plugin, BSDF) and hasattr(plugin, "kind")]
        jumping = [bsdf for bsdf in one_sided if bsdf.kind().jumps]
        turning = [name for plugins, attributes in ((scene.shapes, MOVE_SHAPES), (sensors, MOVE_VIEWS), (jumping, ("eta",)))
                   for plugin in plugins for name in moving(scene, plugin, attributes)]
        if jumping and turning:
            self.warned_of_jumps = True
            named = " and ".join(f"`{name}`" for name in turning)
            warnings.warn(f"derivatives of {named} lack a part at the {jumping[0].type} "
                          f"`{scene.name_of(jumping[0])}`: light refracted by GGX facets ends with a jump, which directions "
                          f"that carry no derivative miss. Use sampling='attached', or the distribution 'beckmann', which "
                          f"has no jump", JumpWarning, stacklevel=level_of_the_caller())

    def missing(self, scene: Scene, sensors: Sequence[Sensor], cameras: Sequence[PinholeTensors]) -> dict[str, int]:
        """The parameters that move silhouettes in view, and how many edges each."""
        missing: dict[str, int] = {}
        for shape in scene.shapes:
            names = moving(scene, shape, MOVE_SHAPES)
            if names:
                surface = shape.oriented()
                count = self.count(id(shape), surface.vertices.detach(), surface.faces, sensors, cameras)
                missing |= {name: count for name in names}
        turned = [(sensor, camera) for sensor, camera in zip(sensors, cameras) if moving(scene, sensor, MOVE_VIEWS)]
        if turned:
            vertices, faces = world(scene)
            for sensor, camera in turned:
                count = self.count("world", vertices, faces, [sensor], [camera])
                missing |= {name: count for name in moving(scene, sensor, MOVE_VIEWS)}
        return {name: count for name, count in missing.items() if count}

    def count(self, key: object, vertices: Tensor, faces: Tensor, sensors: Sequence[Sensor],
              cameras: Sequence[PinholeTensors]) -> int:
        """The silhouettes of a mesh in some views."""
        if key not in self.known or not torch.equal(self.known[key][0], faces):
            self.known[key] = (faces, edges_of(vertices, faces))
        edges = self.known[key][1]
        return sum(int(silhouettes_in_view(edges, vertices, camera, sensor.film.crop_width, sensor.film.crop_height).sum())
                   for sensor, camera in zip(sensors, cameras))


def moving(scene: Scene, plugin: Plugin, attributes: Sequence[str]) -> list[str]:
    """The names of those attributes of a plugin that derivatives are asked for."""
    asked = [name for name in attributes if asks_for_derivatives(getattr(plugin, name, None))]
    return [f"{scene.name_of(plugin)}.{name}" for name in asked]


def asks_for_derivatives(value) -> bool:
    """Whether an attribute is a tensor whose derivatives this rendering is to have, backward or forward."""
    if not isinstance(value, Tensor):
        return False
    return (value.requires_grad and torch.is_grad_enabled()) or tangent_of(value) is not None


def world(scene: Scene) -> tuple[Tensor, Tensor]:
    """All vertices (V, 3), detached, and faces (F, 3) of a scene."""
    surfaces = [shape.oriented() for shape in scene.shapes]
    firsts = torch.tensor([0] + [len(surface.vertices) for surface in surfaces]).cumsum(0).tolist()
    return (torch.cat([surface.vertices.detach() for surface in surfaces]),
            torch.cat([surface.faces + first for surface, first in zip(surfaces, firsts)]))


def level_of_the_caller() -> int:
    """How many calls up, from the function that asks, the code outside of torch and this package is."""
    frame, level = sys._getframe(1), 1
    while frame.f_back is not None and frame.f_globals.get("__name__", "").split(".")[0] in ("torch", "torch_radbp"):
        frame, level = frame.f_back, level + 1
    return level
