"""Lights whose shadow borders a derivative may lack; see `warning.py`."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.rendering import MOVE_SHAPES, Rendering
from torch_radbp.boundary.sky import hidden_sky
from torch_radbp.plugin import Shape
from torch_radbp.scene.material_tables import one_sided

MOVE_LIGHTS = ("to_world", "position")
MOST_LIGHTS = 32  # that move, and that do not, whose shadows are searched
CLOSED = 1e-3  # ratio of the sum of area-weighted normals to the area below which a surface is closed


class ShadowingLight(NamedTuple):
    """A light that casts shadows with borders."""

    place: Tensor  # (4,) homogeneous: the position, or middle, of the light; or with 0 at the end the direction towards it
    axis: Tensor  # (3,) it shines only into this half space; 0: into all directions
    shape: Shape | None  # that emits the light
    moving: list[str]  # the differentiated parameters that move it


def lights_of(rendering: Rendering) -> Iterator[ShadowingLight]:
    """Yields all lights with a position or a direction."""
    scene, caster = rendering.scene, rendering.caster
    for emitter in scene.emitters:
        source = emitter.source()
        if source is not None:
            yield ShadowingLight(*source, None, rendering.moving(emitter, MOVE_LIGHTS))
    for shape, faces in zip(rendering.shapes, caster.faces.split(rendering.sizes)):
        if shape.emitter is not None:
            first, second, third = caster.vertices[faces.long()].unbind(1)
            normals = torch.linalg.cross(second - first, third - first)
            middle = ((first + second + third) / 3.0).mean(0)
            # The normals of a closed surface add up to zero, but for rounding.
            axis = normals.sum(0) * float(normals.sum(0).norm() > CLOSED * normals.norm(dim=1).sum())
            yield ShadowingLight(*shape.emitter.kind().source(middle, axis), shape, rendering.moving(shape, MOVE_SHAPES))


def _scattering(rendering: Rendering) -> Tensor:
    """(T,) bool: triangles of the caster with a material that has smooth lobes."""
    smooth = [any(bsdf.kind().smooth for bsdf in one_sided([shape.bsdf])) for shape in rendering.shapes]
    return torch.tensor(smooth, device=rendering.shape_of.device)[rendering.shape_of]


def soft_shadows(rendering: Rendering, cameras: list[list[str]]) -> set[str]:
    """The parameters that move occluders of the environment, or the surfaces below, in view.

    Args:
        rendering: that is about to start.
        cameras: for each sensor, the parameters that move it.
    """
    surrounded = any(emitter.kind().surround for emitter in rendering.scene.emitters)
    if not surrounded or not (any(rendering.movers) or any(cameras)):
        return set()
    found = hidden_sky(rendering, _scattering(rendering))
    pairs = torch.stack([rendering.shape_of[found.blocker], rendering.shape_of[found.receiver]], 1).unique(dim=0)
    shapes = {shape for pair in pairs.tolist() for shape in pair}
    return {*(name for shape in shapes for name in rendering.movers[shape]),
            *(name for view in found.view.unique().tolist() for name in cameras[view])}


def some_lights(lights: list[ShadowingLight]) -> list[ShadowingLight]:
    """Selects at most `MOST_LIGHTS` moving lights and as many others, spread over the scene."""
    groups = [light for light in lights if light.moving], [light for light in lights if not light.moving]
    return [light for group in groups for light in group[::max(1, -(-len(group) // MOST_LIGHTS))]]
