"""What edges and shadows contribute in media that no boundary term has."""

from __future__ import annotations

from torch_radbp.boundary.curve.outline import outlines_of
from torch_radbp.boundary.curve.rendering import Rendering
from torch_radbp.boundary.terms.call_traits import follows, follows_mirrors, glues


def left_out_in_media(rendering: Rendering) -> list[str]:
    """The edges and shadows, in words, that derivatives lack in scenes with media that scatter or whose boundaries rays
    pass; empty without such media."""
    call, layout = rendering.call, rendering.call.scene.layout
    later, segments = rendering.max_depth > 1, layout.traces_segments
    if not segments and not (layout.scattering_media and later):
        return []
    found = ["edges in view"] if segments and not rendering.primary else []
    if later and not (rendering.shadows and glues(call)):
        return [*found, "edges that surfaces and media see, and shadows"]
    if segments and later and follows(call):
        found.append("edges over which directions slide that carry derivatives, such as those of rough glass")
    if segments and follows_mirrors(call):
        found.append("edges that are seen in ideal mirrors and glass")
    if segments and layout.panes:
        found.append("edges of what light passes straight, such as panes and masks")
    if segments and later and outlines_of(rendering.scene).crossing(rendering, 0) is not None:
        found.append("curves along which surfaces pass through each other, as surfaces and media see them")
    if layout.scattering_media and rendering.light_paths == "all":
        found.append("edges that light of paths from lamps passes")
    return found
