"""The warnings that a derivative lacks what silhouettes, shadows or jumps of a BSDF contribute.

A derivative of the image is a derivative of its pixels, plus what is gained and lost where one surface ends and another is
seen behind it. The second part is not computed yet. It is missing if a shape, or the camera, moves and silhouettes are in
view; of a surface that fills the view nothing is missing. Borders of shadows are silhouettes as a light sees them; looked
for are those of lights that have a place or a direction, not those of light from all around.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.edges import Edges, edges_of, spread
from torch_radbp.boundary.shadow import shadows_in_view
from torch_radbp.boundary.silhouette import Sight, silhouettes_in_view
from torch_radbp.plugin import Plugin, Sensor, Shape
from torch_radbp.raycast.protocol import RayCaster
from torch_radbp.scene import Scene
from torch_radbp.scene.differentiated import tangent_of
from torch_radbp.scene.material import followed
from torch_radbp.scene.pack import one_sided

MOVE_SHAPES = ("to_world", "vertex_positions")
MOVE_LIGHTS = ("to_world", "position")
MOVE_VIEWS = ("to_world", "x_fov", "principal_point_offset_x", "principal_point_offset_y")
FLAT = 1e-6  # thickness over extent
CLOSED = 1e-3  # the sum of a surface's normals over its area


class SilhouetteWarning(UserWarning):
    """Derivatives are asked for that lack what silhouettes contribute."""


class JumpWarning(SilhouetteWarning):
    """Derivatives are asked for that lack what the jump of a BSDF contributes, a silhouette of its microfacets."""


class Rendering(NamedTuple):
    """What is about to be rendered."""

    scene: Scene  # with the parameters of this rendering
    sensors: Sequence[Sensor]
    sights: Sequence[Sight]  # of the same
    caster: RayCaster  # of the scene as it is now
    sampling: str  # "detached", "hybrid" or "attached"

    def counts(self) -> list[int]:
        """How many triangles each shape has; those of the caster are in the order of the shapes."""
        return [len(shape.faces) for shape in self.scene.shapes]


class JumpWatch:
    """Looks at every rendering for jumps whose part is missing from the derivative; warns once of each sort."""

    def __init__(self) -> None:
        # Which have not warned yet.
        self.looks = [self.silhouettes_in_view, self.shadows_in_view, self.jumps_of_a_bsdf, self.edges_slid_over]
        self.known: dict[object, tuple[Tensor, Edges]] = {}  # edges of what was looked at, and the faces that made them
        self.looked_at: set[str] = set()  # what moves, in the shadows that were looked for

    def look(self, rendering: Rendering) -> None:
        """Warns if derivatives are asked for that lack something."""
        for look in self.looks:
            warning = look(rendering)
            if warning is not None:
                self.looks = [other for other in self.looks if other != look]  # not in place: other threads look too
                warnings.warn(warning, stacklevel=level_of_the_caller())

    def silhouettes_in_view(self, rendering: Rendering) -> SilhouetteWarning | None:
        """Of the shapes and cameras that move. Hidden silhouettes count as seen."""
        missing = self.missing(rendering)
        if not missing:
            return None
        return SilhouetteWarning(f"derivatives of {listed(missing)} lack what its silhouettes contribute: at least "
                                 f"{max(missing.values())} edges move in view, where the image changes by a jump. A loss "
                                 f"that depends on outlines, such as that of a shape before a background, has a biased "
                                 f"gradient; check_gradient tells by how much")

    def shadows_in_view(self, rendering: Rendering) -> SilhouetteWarning | None:
        """Of lights, shapes that cast them and shapes that they fall on, if these move and show no silhouettes.

        Looked for once for each parameter, because it casts rays.
        """
        scene, vertices, faces = rendering.scene, rendering.caster.vertices, rendering.caster.faces
        shapes = [moving(scene, shape, MOVE_SHAPES) for shape in scene.shapes]
        names = {name for plugin in scene.emitters for name in moving(scene, plugin, MOVE_LIGHTS)}.union(*shapes)
        if names <= self.looked_at:
            return None
        self.looked_at |= names
        lights, counts = list(lights_of(rendering)), rendering.counts()
        if not lights:
            return None
        edges = self.edges("world", vertices, faces, counts)
        shape_of = torch.repeat_interleave(torch.tensor(counts, device=faces.device))
        shape_at = shape_of.new_zeros(len(vertices)).index_copy(0, faces.flatten().long(), shape_of.repeat_interleave(3))
        missing: set[str] = set()
        for light in lights:
            found = shadows_in_view(edges, vertices, rendering.caster, light.place, light.axis, rendering.sights)
            casting = shape_at[edges.vertex[edges.a[found.edge]]]
            pairs = torch.stack([casting, shape_of[found.receiver]], 1).unique(dim=0)
            for casts, catches in pairs.tolist():
                if scene.shapes[casts] is not light.shape:
                    missing |= {*light.moving, *shapes[casts], *shapes[catches]}
        missing -= self.missing(rendering).keys()
        if not missing:
            return None
        return SilhouetteWarning(f"derivatives of {listed(sorted(missing))} lack what the borders of shadows contribute: "
                                 f"some in view move over the surface on which they fall. A loss that depends on where "
                                 f"shadows lie has a biased gradient; check_gradient tells by how much")

    def jumps_of_a_bsdf(self, rendering: Rendering) -> JumpWarning | None:
        """Directions turn at rough glass that jumps with them, and do not carry derivatives; see `Kind.jumps`."""
        scene, sensors, sampling = rendering.scene, rendering.sensors, rendering.sampling
        jumping = [bsdf for bsdf in one_sided(scene.bsdfs()) if bsdf.kind().jumps and sampling != "attached"]
        turning = [name for plugins, attributes in ((scene.shapes, MOVE_SHAPES), (sensors, MOVE_VIEWS), (jumping, ("eta",)))
                   for plugin in plugins for name in moving(scene, plugin, attributes)]
        if not (jumping and turning):
            return None
        bsdf = f"{jumping[0].type} `{scene.name_of(jumping[0])}`"
        return JumpWarning(f"derivatives of {listed(turning)} lack a part at the {bsdf}: light refracted by GGX facets "
                           f"ends with a jump, which directions that carry no derivative miss. Use sampling='attached', or "
                           f"the distribution 'beckmann', which has no jump")

    def edges_slid_over(self, rendering: Rendering) -> SilhouetteWarning | None:
        """Directions follow roughness, index or normals of a surface, and there are edges that they may slide over.

        At ideal mirrors and glass they follow the surface itself and the camera too; elsewhere attached directions do, which
        is not looked for.
        """
        scene, sampling = rendering.scene, rendering.sampling
        turning: dict[str, bool] = {}  # by name; whether the surface is ideal
        for bsdf in one_sided(scene.bsdfs()):
            if followed(bsdf.kind(), sampling):
                turning |= {f"{scene.name_of(bsdf)}.{bsdf.textures()[slot].place[1]}": bsdf.kind().delta
                            for slot in bsdf.kind().steering if asks_for_derivatives(bsdf.textures()[slot].texels())}
        for shape in scene.shapes:
            delta = [bsdf.kind().delta for bsdf in one_sided([shape.bsdf]) if followed(bsdf.kind(), sampling)]
            turning |= {name: all(delta) for name in moving(scene, shape, ("vertex_normals",)) if delta}
            turning |= {name: True for name in moving(scene, shape, MOVE_SHAPES) if any(delta)}
        if any(bsdf.kind().delta and followed(bsdf.kind(), sampling) for bsdf in one_sided(scene.bsdfs())):
            turning |= {name: True for sensor in rendering.sensors for name in moving(scene, sensor, MOVE_VIEWS)}
        named = self.missing(rendering) if turning else {}
        turning = {name: ideal for name, ideal in turning.items() if name not in named}
        if not turning or flat(rendering.caster.vertices):
            return None
        instead = "" if all(turning.values()) else " Where a surface is not ideal, sampling='hybrid' does not."
        return SilhouetteWarning(f"derivatives of {listed(turning)} lack what edges contribute where they are seen "
                                 f"reflected or refracted: directions follow the parameter and slide over the edges of "
                                 f"what they meet, where radiance changes by a jump.{instead} check_gradient tells by how "
                                 f"much it matters")

    def missing(self, rendering: Rendering) -> dict[str, int]:
        """The parameters that move silhouettes in view, and how many edges each that were looked at."""
        scene, missing = rendering.scene, {}
        vertices, faces, counts = rendering.caster.vertices, rendering.caster.faces, rendering.counts()
        for shape, own in zip(scene.shapes, faces.split(counts)):
            names = moving(scene, shape, MOVE_SHAPES)
            if names:
                count = number_in_view(self.edges(id(shape), vertices, own, [len(own)]), vertices, rendering.sights)
                missing |= {name: count for name in names}
        for sensor, sight in zip(rendering.sensors, rendering.sights):
            names = moving(scene, sensor, MOVE_VIEWS)
            if names:
                count = number_in_view(self.edges("world", vertices, faces, counts), vertices, [sight])
                missing |= {name: count for name in names}
        return {name: count for name, count in missing.items() if count}

    def edges(self, key: object, vertices: Tensor, faces: Tensor, counts: Sequence[int]) -> Edges:
        """Those of one or several shapes, all or some of them; found anew only where the faces are others.

        Args:
            key: what they are remembered by.
            vertices: (V, 3), detached.
            faces: (F, 3) of all of the shapes.
            counts: triangles of each of the shapes.
        """
        known = self.known.get(key)
        if known is None or not torch.equal(known[0], faces):
            known = self.known[key] = (faces, edges_of(vertices, faces, spread(counts, faces.device)))
        return known[1]


def number_in_view(edges: Edges, vertices: Tensor, sights: Sequence[Sight]) -> int:
    """How many edges are silhouettes in some views."""
    return sum(int(silhouettes_in_view(edges, vertices, sight).sum()) for sight in sights)


class Light(NamedTuple):
    """A light that casts shadows with a border."""

    place: Tensor  # (4,) homogeneous: a position, the middle of a light with extent; or with a 0 the direction towards it
    axis: Tensor  # (3,) it shines to this side only; 0: to all
    shape: Shape | None  # that emits
    moving: list[str]  # the parameters that move it and that derivatives are asked for


def lights_of(rendering: Rendering) -> Iterator[Light]:
    """All lights that have a place or a direction."""
    scene, caster = rendering.scene, rendering.caster
    for emitter in scene.emitters:
        if hasattr(emitter, "pose"):
            pose = emitter.pose()
            place = torch.cat([pose.place.detach(), pose.place.new_full((1,), float(emitter.type != "directional"))])
            axis = pose.to_local[2].detach() * float(emitter.type in ("spot", "projector"))
            yield Light(place, axis, None, moving(scene, emitter, MOVE_LIGHTS))
    for shape, faces in zip(scene.shapes, caster.faces.split(rendering.counts())):
        if shape.emitter is not None:
            first, second, third = caster.vertices[faces.long()].unbind(1)
            normals = torch.linalg.cross(second - first, third - first)
            middle = ((first + second + third) / 3.0).mean(0)
            # The normals of a closed surface add up to rounding errors.
            axis = normals.sum(0) * float(normals.sum(0).norm() > CLOSED * normals.norm(dim=1).sum())
            yield Light(torch.cat([middle, middle.new_ones(1)]), axis, shape, moving(scene, shape, MOVE_SHAPES))


def listed(names: Iterable[str]) -> str:
    """`a` and `b`."""
    return " and ".join(f"`{name}`" for name in dict.fromkeys(names))


def flat(vertices: Tensor) -> bool:
    """Whether all vertices, (V, 3), lie in one plane, so that no ray from one surface meets another."""
    centred = vertices.double() - vertices.double().mean(0)
    squared_extent = torch.linalg.eigvalsh(centred.T @ centred)
    return bool(squared_extent[0] <= FLAT**2 * squared_extent[-1])


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
