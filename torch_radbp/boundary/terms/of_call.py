"""The boundary terms of a rendering: their edges, and their derivatives."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.curve.outline import Jumps, Outline, Outlines, outlines_of
from torch_radbp.boundary.curve.rendering import Rendering
from torch_radbp.boundary.curve.segments import Segments, joined_segments
from torch_radbp.boundary.curve.term import LineNumbers, lines_on_shapes, lines_slide
from torch_radbp.boundary.eye.surfaces import line_table
from torch_radbp.boundary.terms.call_traits import follows_mirrors
from torch_radbp.boundary.terms.covered_lights import Lights
from torch_radbp.boundary.terms.primary import bytes_of_jumps, image_jumps, moves
from torch_radbp.boundary.terms.reflections import (
    Reflected,
    bytes_of_reflections,
    reflected_jumps,
    reflections_move,
)
from torch_radbp.boundary.terms.shadows import bytes_of_shadows, shadow_jumps, shadows_move, slides_over_edges
from torch_radbp.boundary.warning.slid_over import lamps_beside_mirrors, slid_over
from torch_radbp.call.render_call import RenderCall
from torch_radbp.tensors.differentiated import primal


class EdgesOfCall(NamedTuple):
    """The edges and curves that the boundary terms of a call need; None for terms that are off, or if nothing moves."""

    in_view: list[Jumps] | None  # of each view
    casting: Outline | None  # the edges of all that casts shadows
    crossing: Segments | None  # where surfaces pass through each other, and lines that slide, as surfaces see them
    reflected: Reflected | None  # what is seen by way of mirrors and glass
    lines: LineNumbers | None = None  # of those among `crossing`
    lamps_in_mirrors: bool = False  # edges of lamps that surfaces see there move, which no term has

    def added_to(self, images: Tensor, call: RenderCall, interior: bool) -> Tensor:
        """The images, (B, 3, H, W), with the derivatives of all boundary terms; `interior`: in addition to those that the
        images carry, which are dropped otherwise."""
        images = images if interior else primal(images)
        if self.in_view is not None:
            images = images + image_jumps(call, self.in_view)
        if self.casting is not None or self.crossing is not None:
            images = images + shadow_jumps(call, self.casting, self.crossing, self.lines)
        if self.reflected is not None:
            images = images + reflected_jumps(call, self.reflected)
        return images


def bytes_of_edges(call: RenderCall, primary: bool, shadows: bool) -> int:
    """The greatest memory of boundary terms, for edges in view (`primary`) and shadows, as far as these are on."""
    in_view = bytes_of_jumps(call) if primary and moves(call) else 0
    reflected = bytes_of_reflections(call) if any(mirror_terms_on(call, primary, shadows)) else 0
    casts = shadows and (slides_over_edges(call) or lines_slide(call))
    return max(in_view, bytes_of_shadows(call) if casts else 0) + reflected


def mirror_terms_on(call: RenderCall, primary: bool, shadows: bool) -> tuple[bool, bool]:
    """Whether discontinuities, and shadow borders, seen in mirrors and glass are on; args as for `bytes_of_edges`."""
    if not follows_mirrors(call) or call.scene.layout.traces_segments:
        return False, False
    moving = reflections_move(call) or lines_slide(call)
    has_borders = shadows and (moving or shadows_move(call)) and any(
        map(Lights.mirrored(call).covers, call.scene.layout.lights))
    return primary and moving, has_borders


def edges_of_call(rendering: Rendering, seed: int) -> EdgesOfCall:
    """Finds the edges and curves that the boundary terms of a rendering need; `seed`: of the choice of instances."""
    outlines, call = outlines_of(rendering.scene), rendering.call
    casts = rendering.shadows and rendering.max_depth > 1 and slides_over_edges(call)
    casting = outlines.of_everything(rendering, seed) if casts else None
    # What casts rays comes last: the tree of a large mesh may still be built.
    in_view = outlines.of_views(rendering, seed) if rendering.primary and moves(call) else None
    segments = call.scene.layout.traces_segments  # through which nobody looks for these
    crossing = outlines.crossing(rendering, seed) if casts and not segments else None
    lines = None
    if rendering.shadows and rendering.max_depth > 1 and lines_slide(call) and not segments:
        sliding, lines = outlines.sliding(rendering, seed)
        crossing = joined_segments([part for part in (crossing, sliding) if part is not None])
    return EdgesOfCall(in_view, casting, crossing, reflected_of(rendering, outlines), lines, lamps_are_slid_over(rendering))


def lamps_are_slid_over(rendering: Rendering) -> bool:
    """True if surfaces see lamps in ideal mirrors or glass whose scattered directions turn with parameters; also under
    `torch.no_grad()`, so that images have the same samples there."""
    if not lamps_beside_mirrors(rendering):
        return False
    with torch.enable_grad():
        slid = slid_over(replace(rendering))
    return bool(slid.names) and slid.lamps


def reflected_of(rendering: Rendering, outlines: Outlines) -> Reflected | None:
    """The edges and lines for discontinuities by way of mirrors and glass; None: these terms are off, or nothing moves."""
    surfaces, shadows = mirror_terms_on(rendering.call, rendering.primary, rendering.shadows)
    if rendering.sampling == "detached" or not (surfaces or shadows):
        return None
    lines = line_table(lines_on_shapes(rendering), rendering.sizes, rendering.call.scene.device)
    return Reflected(outlines.of_meshes(rendering), lines, surfaces, shadows)
