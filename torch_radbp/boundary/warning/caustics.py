"""Looks for caustics of lights without extent, which paths from the camera cannot find.

Next-event estimation connects a surface with such a light in a straight line, and scattering by a smooth mirror or smooth
glass never meets it by chance: what it lights by way of those is missing from the image, unless paths begin at the lights.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.curve.rendering import Rendering
from torch_radbp.boundary.warning.view_rays import ray_from
from torch_radbp.interface.bsdf import Kind
from torch_radbp.interface.emitter import ShadowSource
from torch_radbp.plugin import Emitter, SceneWarning
from torch_radbp.scene.packing.material_tables import one_sided

FAR_AWAY = 1e4  # extents of the scene: the distance at which a light in a direction is placed
APART = 1e-4  # distance from a surface at which a ray starts, as a share of the scene's extent
MOST_TARGETS = 1 << 12  # triangles of mirrors and glass at which rays are aimed
MOST_SURFACES = 4  # of glass, through which a ray is followed
SHORTEST = 3  # depth of the shortest path with a caustic


class Caustic(NamedTuple):
    """A light without extent that lights surfaces by way of a smooth mirror or smooth glass."""

    light: str  # names, and its type
    type: str
    mirror: str

    @property
    def text(self) -> str:
        return (f"the light of `{self.light}`, of type {self.type}, reaches surfaces by way of `{self.mirror}`, a smooth "
                f"mirror or smooth glass")

    def lacking(self) -> SceneWarning:
        """The warning that the image lacks the caustic."""
        return SceneWarning(f"{self.text}: paths from the camera cannot find such caustics of lights without extent, and "
                            f"the image lacks them. Take light_paths=\"caustics\", whose paths begin at the lamps, too, or "
                            f"give the light an extent, such as a small sphere with an area emitter")

    def traced(self) -> SceneWarning:
        """The note that paths from the lamps bring the caustic."""
        return SceneWarning(f"{self.text}: as many paths as from the camera begin at the lamps, which find such caustics "
                            f"(light_paths=\"auto\"). Say light_paths=\"caustics\" to have them, or \"camera\" to do "
                            f"without, and without this note. What of them is seen in mirrors and through glass is missing")


def caustic_of(rendering: Rendering) -> Caustic | None:
    """A light without extent that lights surfaces by way of smooth mirrors or glass; None: none is found.

    It is searched by rays from the light, which pass glass unbent.
    """
    kinds = [[bsdf.kind() for bsdf in one_sided([shape.bsdf])] for shape in rendering.shapes]
    ideal = [all(kind.delta and not kind.smooth and not kind.invisible for kind in sides) for sides in kinds]
    if rendering.max_depth < SHORTEST or not any(ideal) or not any(kind.smooth for sides in kinds for kind in sides):
        return None
    for emitter, source in delta_lights(rendering):
        number = first_on_a_way(rendering, source, kinds, ideal)
        if number is not None:
            lamp, mirror = (rendering.names[id(plugin)] for plugin in (emitter, rendering.shapes[number]))
            return Caustic(lamp, emitter.type, mirror)
    return None


def delta_lights(rendering: Rendering) -> Iterator[tuple[Emitter, ShadowSource]]:
    """Yields the emitters without extent, each with its position or direction."""
    caster = rendering.call.caster
    for emitter in rendering.scene.emitters:
        source = emitter.source()
        if source is not None and emitter.kind().delta:
            yield emitter, source
    for shape, faces in zip(rendering.shapes, caster.faces.split(rendering.sizes)):
        if shape.emitter is not None and shape.emitter.kind().delta:
            first, second, third = caster.vertices[faces.long()].unbind(1)
            axis = torch.linalg.cross(second - first, third - first).sum(0)
            yield shape.emitter, shape.emitter.kind().source(((first + second + third) / 3.0).mean(0), axis)


def first_on_a_way(rendering: Rendering, source: ShadowSource, kinds: list[list[Kind]], ideal: list[bool]) -> int | None:
    """The number of the first mirror or glass shape by way of which light reaches a surface that shows it; None: none.

    Args:
        rendering: that is about to start.
        source: the position or direction of the light.
        kinds: for each shape, the kinds of BSDF of its sides.
        ideal: True for shapes that only reflect or refract as ideal mirrors and glass do.
    """
    vertices, faces, counts = rendering.seen
    device = faces.device
    extent = float((vertices.amax(0) - vertices.amin(0)).max())
    is_ideal, passes, shows = (torch.tensor(flags, device=device) for flags in (
        ideal, [any(kind.transmits for kind in sides) for sides in kinds],
        [any(kind.smooth for kind in sides) for sides in kinds]))
    targets = is_ideal[torch.repeat_interleave(torch.tensor(counts, device=device))].nonzero().squeeze(1)
    corners = vertices[faces[targets[::max(1, -(-len(targets) // MOST_TARGETS))]].long()].double()
    p, normal = corners.mean(1), torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal = torch.nn.functional.normalize(normal, dim=1, eps=1e-300)
    d = torch.nn.functional.normalize(p - viewpoint(source.place.double(), vertices.double()), dim=1)
    met = shapes_met(rendering, p - d * extent * 2 if not source.place[3] else source.place[:3].double().expand_as(p), d)
    lit = (d @ source.axis.double() >= 0) & (met >= 0) & is_ideal[met.clamp_min(0)]
    first, p, d, normal = met[lit], p[lit], d[lit], normal[lit]

    # Follow what is reflected to the next surface, and what passes through glass as far as it goes.
    reflected = d - 2.0 * (d * normal).sum(1, keepdim=True) * normal
    for o, towards, some in ((p, reflected, torch.ones_like(first, dtype=torch.bool)), (p, d, passes[first])):
        for _ in range(MOST_SURFACES):
            hit = rendering.call.caster.intersect(ray_from(o + APART * extent * towards, towards))
            met = _shapes_of(rendering, hit.prim)
            found = some & (met >= 0) & shows[met.clamp_min(0)]
            if found.any():
                return int(first[found][0])
            some = some & (met >= 0) & passes[met.clamp_min(0)]
            o = o + (APART * extent + hit.t[:, None].double()) * towards
    return None


def viewpoint(place: Tensor, vertices: Tensor) -> Tensor:
    """The position of a light, (3,); for a directional light one far away from the mesh.

    Args:
        place: (4,) homogeneous: a position, or with 0 at the end the direction towards it; float64.
        vertices: (V, 3) of the mesh, float64.
    """
    if place[3]:
        return place[:3]
    extent = (vertices.amax(0) - vertices.amin(0)).max()
    return vertices.mean(0) + FAR_AWAY * extent * place[:3]


def shapes_met(rendering: Rendering, o: Tensor, d: Tensor) -> Tensor:
    """The number of the shape that each ray hits, (N,) int64; -1: a miss."""
    return _shapes_of(rendering, rendering.call.caster.intersect(ray_from(o, d)).prim)


def _shapes_of(rendering: Rendering, prim: Tensor) -> Tensor:
    """The number of the shape to which each triangle belongs, (N,) int64; -1 for -1."""
    return torch.where(prim >= 0, rendering.shape_of[prim.clamp_min(0).long()], -1)
