"""The warnings that a derivative lacks what silhouettes, or jumps of a BSDF, contribute.

A derivative of the image is a derivative of its pixels, plus what is gained and lost where one surface ends and another is
seen behind it. The second part is not computed yet. It is missing if a shape, or the camera, moves and silhouettes are in
view; of a surface that fills the view nothing is missing.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterable, Sequence

import torch
from torch import Tensor

from torch_radbp.boundary.edges import Edges, edges_of
from torch_radbp.boundary.silhouette import silhouettes_in_view
from torch_radbp.bsdf.kind import Kind
from torch_radbp.plugin import BSDF, Plugin, Sensor
from torch_radbp.scene import Scene
from torch_radbp.scene.differentiated import tangent_of
from torch_radbp.scene.pack import geometry
from torch_radbp.sensor.perspective import PinholeTensors

MOVE_SHAPES = ("to_world", "vertex_positions")
MOVE_VIEWS = ("to_world", "x_fov", "principal_point_offset_x", "principal_point_offset_y")
FLAT = 1e-6  # thickness over extent


class SilhouetteWarning(UserWarning):
    """Derivatives are asked for that lack what silhouettes contribute."""


class JumpWarning(SilhouetteWarning):
    """Derivatives are asked for that lack what the jump of a BSDF contributes, a silhouette of its microfacets."""


class JumpWatch:
    """Looks at every rendering for jumps whose part is missing from the derivative; warns once of each sort."""

    def __init__(self) -> None:
        self.looks = [self.silhouettes_in_view, self.jumps_of_a_bsdf, self.edges_slid_over]  # which have not warned yet
        self.known: dict[object, tuple[Tensor, Edges]] = {}  # edges of what was looked at, and the faces that made them

    def look(self, scene: Scene, sensors: Sequence[Sensor], cameras: Sequence[PinholeTensors], sampling: str) -> None:
        """Warns if derivatives are asked for that lack something.

        Args:
            scene: with the parameters of this rendering.
            sensors: that are rendered.
            cameras: the same as tensors.
            sampling: "detached", "hybrid" or "attached".
        """
        for look in self.looks[:]:
            warning = look(scene, sensors, cameras, sampling)
            if warning is not None:
                self.looks.remove(look)
                warnings.warn(warning, stacklevel=level_of_the_caller())

    def silhouettes_in_view(self, scene: Scene, sensors: Sequence[Sensor], cameras: Sequence[PinholeTensors],
                            sampling: str) -> SilhouetteWarning | None:
        """Of the shapes and cameras that move. Hidden silhouettes count as seen."""
        missing = self.missing(scene, sensors, cameras)
        if not missing:
            return None
        return SilhouetteWarning(f"derivatives of {listed(missing)} lack what its silhouettes contribute: "
                                 f"{max(missing.values())} edges move in view, where the image changes by a jump. A loss "
                                 f"that depends on outlines, such as that of a shape before a background, has a biased "
                                 f"gradient; check_gradient tells by how much")

    def jumps_of_a_bsdf(self, scene: Scene, sensors: Sequence[Sensor], cameras: Sequence[PinholeTensors],
                        sampling: str) -> JumpWarning | None:
        """Directions turn at rough glass that jumps with them, and do not carry derivatives; see `Kind.jumps`."""
        jumping = [bsdf for bsdf in one_sided(scene) if bsdf.kind().jumps and sampling != "attached"]
        turning = [name for plugins, attributes in ((scene.shapes, MOVE_SHAPES), (sensors, MOVE_VIEWS), (jumping, ("eta",)))
                   for plugin in plugins for name in moving(scene, plugin, attributes)]
        if not (jumping and turning):
            return None
        bsdf = f"{jumping[0].type} `{scene.name_of(jumping[0])}`"
        return JumpWarning(f"derivatives of {listed(turning)} lack a part at the {bsdf}: light refracted by GGX facets "
                           f"ends with a jump, which directions that carry no derivative miss. Use sampling='attached', or "
                           f"the distribution 'beckmann', which has no jump")

    def edges_slid_over(self, scene: Scene, sensors: Sequence[Sensor], cameras: Sequence[PinholeTensors],
                        sampling: str) -> SilhouetteWarning | None:
        """Directions follow roughness, index or normals of a surface, and there are edges that they may slide over."""
        turning = [f"{scene.name_of(bsdf)}.{bsdf.textures()[slot].place[1]}" for bsdf in one_sided(scene)
                   if followed(bsdf.kind(), sampling)
                   for slot in bsdf.kind().steering if asks_for_derivatives(bsdf.textures()[slot].texels())]
        turning += [name for shape in scene.shapes for name in moving(scene, shape, ("vertex_normals",))
                    if any(followed(bsdf.kind(), sampling) for bsdf in one_sided(shape))]
        if not turning or flat(geometry(scene)[0]):
            return None
        rough = any(not followed(bsdf.kind(), "hybrid") for bsdf in one_sided(scene))
        instead = " Where a surface is not ideal, sampling='hybrid' does not." if rough and sampling == "attached" else ""
        return SilhouetteWarning(f"derivatives of {listed(turning)} lack what edges contribute where they are seen "
                                 f"reflected or refracted: directions follow the parameter and slide over the edges of "
                                 f"what they meet, where radiance changes by a jump.{instead} check_gradient tells by how "
                                 f"much it matters")

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
            vertices, faces = geometry(scene)
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


def one_sided(owner: Scene | Plugin) -> list[BSDF]:
    """The materials of a scene or a shape without their wrappers."""
    return [plugin for plugin in owner.modules() if isinstance(plugin, BSDF) and hasattr(plugin, "kind")]


def followed(kind: Kind, sampling: str) -> bool:
    """Whether the directions that a material scatters into carry derivatives."""
    return sampling == "attached" or (sampling == "hybrid" and kind.delta)


def listed(names: Iterable[str]) -> str:
    """`a` and `b`."""
    return " and ".join(f"`{name}`" for name in dict.fromkeys(names))


def flat(vertices: Tensor) -> bool:
    """Whether all vertices, (V, 3), lie in one plane, so that no ray from one surface meets another."""
    extent = torch.linalg.svdvals((vertices - vertices.mean(0)).double())
    return bool(extent[-1] <= FLAT * extent[0])


def moving(scene: Scene, plugin: Plugin, attributes: Sequence[str]) -> list[str]:
    """The names of those attributes of a plugin that derivatives are asked for."""
    asked = [name for name in attributes if asks_for_derivatives(getattr(plugin, name, None))]
    return [f"{scene.name_of(plugin)}.{name}" for name in asked]


def asks_for_derivatives(value) -> bool:
    """Whether an attribute is a tensor whose derivatives this rendering is to have, backward or forward."""
    if not isinstance(value, Tensor):
        return False
    return (value.requires_grad and torch.is_grad_enabled()) or tangent_of(value) is not None


def level_of_the_caller() -> int:
    """How many calls up, from the function that asks, the code outside of torch and this package is."""
    frame, level = sys._getframe(1), 1
    while frame.f_back is not None and frame.f_globals.get("__name__", "").split(".")[0] in ("torch", "torch_radbp"):
        frame, level = frame.f_back, level + 1
    return level
