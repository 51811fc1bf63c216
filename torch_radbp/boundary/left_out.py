"""What a derivative lacks without a term of lines: the parameters that move some of its lines in view."""

from __future__ import annotations

import torch

from torch_radbp.boundary.geometry import geometry_of
from torch_radbp.boundary.moving import Moving, moving_faces
from torch_radbp.boundary.rendering import Rendering
from torch_radbp.boundary.silhouette import crosses_view
from torch_radbp.boundary.term import LinesTerm
from torch_radbp.boundary.texture_lines import texture_segments
from torch_radbp.tensors.differentiated import detached
from torch_radbp.tensors.vec import interpolated, rows


def names_left_out(term: LinesTerm, rendering: Rendering) -> set[str]:
    """The names of the parameters that move lines of a term in view; hidden lines count as seen."""
    lines, scene, cameras = term.lines(rendering), detached(rendering.tensors), rendering.camera_movers
    names = [[*moving, *own] for moving, own in zip(rendering.movers, term.sliding(rendering))]
    wanted = tuple(bool(own) and (any(cameras) or bool(of)) for own, of in zip(lines, names))
    if not any(wanted):
        return set()
    moving = Moving(wanted, (False,) * len(rendering.moving_instances))
    faces = moving_faces(scene, rendering.sizes, moving, torch.Generator("cpu").manual_seed(0))
    segments = None if faces is None else texture_segments(scene, faces, rendering.sizes, lines)
    if segments is None:
        return set()
    corners = segments.corners(geometry_of(scene))
    ends = [interpolated(corners, end.x, end.y) for end in (segments.start, segments.end)]
    seen = torch.stack([crosses_view(*ends, sight) for sight in rendering.sights])
    shapes = rows(rendering.shape_of, segments.triangle)[seen.any(0)].unique().tolist()
    return {*(name for shape in shapes for name in names[shape]),
            *(name for view, own in zip(seen, cameras) if view.any() for name in own)}
