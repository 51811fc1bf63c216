"""What a derivative lacks without its boundary terms: the parameters that move silhouettes and lines in view.

Hidden ones count as seen. The terms of shadows name what they leave out by themselves (`terms/shadow_term.py`).
"""

from __future__ import annotations

from collections import Counter

import torch
from torch import Tensor

from torch_radbp.boundary.curve.geometry import Geometry, geometry_of, in_world
from torch_radbp.boundary.curve.moving import Moving, moving_faces
from torch_radbp.boundary.curve.outline import Outline, moving_in, outlines_of
from torch_radbp.boundary.curve.rendering import Rendering
from torch_radbp.boundary.curve.silhouette import CameraSight, Eye, crosses_view, is_silhouette
from torch_radbp.boundary.curve.term import LinesTerm
from torch_radbp.boundary.curve.texture_lines import texture_segments
from torch_radbp.tensors.vec import interpolated, rows

MOST_EDGES = 1 << 18  # that are looked at


def silhouettes_left_out(rendering: Rendering) -> dict[str, int]:
    """The differentiated parameters that move silhouettes in view, each with the number of edges."""
    scene, own, missing = rendering.call.still_scene, moving_in(rendering), Counter()
    everything, geometry = Moving(*((True,) * len(part) for part in own)), geometry_of(scene)
    for moving in (own, everything) if any(rendering.camera_movers) else (own,):
        generator = torch.Generator("cpu").manual_seed(0)
        outline = outlines_of(rendering.scene).of(scene, rendering.sizes, moving, generator)
        if outline is None:
            continue
        shape = rows(rendering.shape_of, torch.div(outline.edges.corner[0], 3, rounding_mode="floor"))
        of_shape = torch.zeros(len(rendering.shapes), dtype=torch.int64)
        for sight, cameras in zip(rendering.sights, rendering.camera_movers):
            edge = silhouettes_in_view(geometry, outline, sight)
            of_shape += shape[edge].bincount(minlength=len(of_shape)).cpu()
            missing |= Counter(dict.fromkeys(cameras, len(edge)) if moving is everything else {})
        if moving is own:
            for names, count in zip(rendering.movers, of_shape.tolist()):
                missing |= Counter(dict.fromkeys(names, count))
    return missing


def silhouettes_in_view(geometry: Geometry, outline: Outline, sight: CameraSight) -> Tensor:
    """The indices of edges that are silhouettes in view of a camera, int64; of many edges only some are tested.

    `geometry`: of the scene, detached.
    """
    camera, count = sight.camera, len(outline.crease)
    some = torch.arange(0, count, max(1, count // MOST_EDGES), device=outline.crease.device)
    edges, instance = rows((outline.edges, outline.instance), some)
    a, b, *opposite = in_world(geometry, (edges.a, edges.b, *edges.opposite), instance)
    found = is_silhouette(a, b, opposite, Eye.of(camera.kind.eye(camera.lens)).towards(a)).nonzero().squeeze(1)
    return some[found[crosses_view(*rows((a, b), found), sight)]]


def lines_left_out(term: LinesTerm, rendering: Rendering) -> set[str]:
    """The differentiated parameters that move lines of a term in view."""
    scene, cameras = rendering.call.still_scene, rendering.camera_movers
    names = [[*moving, *own] for moving, own in zip(rendering.movers, term.sliding(rendering))]
    if not any(names) and not any(cameras):
        return set()
    lines = term.lines(rendering)
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
