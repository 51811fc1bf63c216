"""Discontinuity lines of textures as segments inside of triangles."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from torch_radbp.boundary.curve.faces import Faces
from torch_radbp.boundary.curve.rendering import Rendering
from torch_radbp.boundary.curve.segments import Segments, zero_crossings
from torch_radbp.boundary.curve.term import LinesTerm, boundary_term
from torch_radbp.call.render_call import RenderCall
from torch_radbp.plugin import Texture
from torch_radbp.plugin.jump_lines import JumpLines
from torch_radbp.scene.packing.attributes import textures_of
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.tensors.differentiated import any_differentiated
from torch_radbp.tensors.record import joined
from torch_radbp.tensors.vec import Vec2, Vec3, rows

ASIDE = 1e-5  # of the distance of two lines, by which a place lies on one side of one; so little that no light changes
ROUNDED = 2e-6  # the same for each of the lines that are counted up to it, for the rounding of coordinates in float32
LARGEST_STEP = 0.01  # the same as barycentric coordinates, at most
ON_EDGE = 1e-6  # of the rise of a triangle, below which a line runs along one of its edges; it counts for one neighbour


@boundary_term
class TextureLines(LinesTerm):
    """The lines on surfaces at which a shape's material or emission textures are discontinuous."""

    what = "lines at which textures jump"

    def slide(self, call: RenderCall) -> bool:
        return any_differentiated(call.scene.triangles.vertices.uv) and any(
            isinstance(part, Texture) and part.jumps() for part in call.module.modules())

    def lines(self, rendering: Rendering) -> list[tuple[JumpLines, ...]]:
        owners = [tuple(filter(None, (shape.bsdf, shape.emitter))) for shape in rendering.shapes]
        known = {owner: tuple(lines for _, texture in textures_of(owner) for lines in texture.jumps())
                 for owner in dict.fromkeys(owner for both in owners for owner in both)}
        return [tuple(dict.fromkeys(lines for owner in both for lines in known[owner])) for both in owners]

    def sliding(self, rendering: Rendering) -> list[list[str]]:
        return rendering.sliders


def texture_segments(scene: SceneTensors, faces: Faces, sizes: Sequence[int],
                     lines: Sequence[tuple[JumpLines, ...]]) -> Segments | None:
    """The segments of texture lines on triangles, in the world; None: there are none.

    Args:
        scene: detached.
        faces: the triangles.
        sizes: the number of triangles of each shape.
        lines: the lines on each shape.
    """
    triangles = scene.triangles
    if triangles.vertices.uv is None or not any(lines):
        return None
    shape_of = torch.repeat_interleave(torch.tensor(sizes, device=triangles.material.device))
    shape = rows(shape_of, faces.triangle)
    number, found = {line: row for row, line in enumerate(distinct(lines))}, []
    for own in dict.fromkeys(filter(None, lines)):
        like = torch.tensor([other == own for other in lines], device=shape.device)
        chosen = rows(faces, rows(like, shape).nonzero().squeeze(1))
        if len(chosen.triangle):
            uv = [rows(triangles.vertices.uv, rows(corner, chosen.triangle)) for corner in triangles.corners]
            found += [segments_along(chosen, tuple(_across(one, place) for place in uv), one, number[one]) for one in own]
    found = [own for own in found if len(own.triangle)]
    return joined(found) if found else None


def distinct(lines: Sequence[tuple[JumpLines, ...]]) -> list[JumpLines]:
    """All lines on some shapes, each once."""
    return list(dict.fromkeys(line for own in lines for line in own))


def _across(lines: JumpLines, uv: Vec2) -> Tensor:
    """The value x u + y v + z that is an integer on a texture's lines, (N,) float64."""
    return lines.x * uv.x.double() + lines.y * uv.y.double() + lines.z


def segments_along(faces: Faces, level: tuple[Tensor, Tensor, Tensor], lines: JumpLines, row: int = 0) -> Segments:
    """The segments inside of triangles on which a function, linear on each, is an integer.

    Args:
        faces: (F,) the triangles.
        level: (F,) the function at each corner.
        lines: which integers count.
        row: the index of the lines among all.
    """
    level = Vec3(*level)
    low, high = torch.minimum(torch.minimum(*level[:2]), level.z), torch.maximum(torch.maximum(*level[:2]), level.z)
    rise = high - low
    # A line along an edge of two triangles counts for the one above it.
    first = torch.ceil(low - ON_EDGE * rise).clamp_min(lines.first)
    last = (torch.ceil(high - ON_EDGE * rise) - 1.0).clamp_max(lines.last)
    count = torch.where(rise > 0.0, last - first + 1.0, 0.0).clamp_min(0.0).long()
    which = torch.repeat_interleave(count)
    place = torch.arange(len(which), device=which.device) - rows(count.cumsum(0) - count, which)
    own, number = rows(faces, which), rows(first, which) + place
    f0, f1, f2 = (value - number for value in rows(level, which))
    by_u, by_v = f1 - f0, f2 - f0
    steep, on_edge = by_u * by_u + by_v * by_v, rows(ON_EDGE * rise, which)
    runs_along = torch.stack([value.abs() <= on_edge for value in (f0, f1, f2)]).sum(0) > 1
    step = (ASIDE + ROUNDED * (number.abs() + abs(lines.z) + 1.0)) / steep
    step = step * (LARGEST_STEP / (step * torch.sqrt(steep))).clamp_max(1.0)
    step = torch.where(runs_along, 0.0, step)
    start, end = zero_crossings(f0, f1, f2)
    none = torch.full_like(own.triangle, -1)
    return Segments(own.triangle, own.instance, start, end, Vec2(by_u * step, by_v * step), Vec2(by_u, by_v),
                    torch.full_like(none, row), none, None if own.instance is None else torch.zeros_like(none), own.share)
