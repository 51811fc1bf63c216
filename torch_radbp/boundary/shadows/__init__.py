"""Boundary terms of light that edges occlude: shadow borders of direct and indirect light.

Four integrals are cut off at edges. Direct light on surfaces that the camera sees, at borders on the film (`border.py`);
light without extent on surfaces that paths meet later (`bounced.py`); all other light that vertices of paths receive
(`hidden_light.py`); and what they receive through surfaces that let light pass straight (`seen_through.py`). In each, places
are sampled on edges that are silhouettes, from a light or from a vertex of a path; what the border sweeps follows from the
points that move. A fifth is cut off where surfaces pass through each other (`crossed_surfaces.py`), and a sixth where they
touch (`under_edges.py`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.contacts import resting_among
from torch_radbp.boundary.edge_order import GROUP
from torch_radbp.boundary.geometry import geometry_of
from torch_radbp.boundary.outline import Outline, outlines_of
from torch_radbp.boundary.places import FEWEST, taken_by
from torch_radbp.boundary.segments import Segments
from torch_radbp.boundary.shadows import (
    border,
    bounced,
    crossed_surfaces,
    followed_borders,
    followed_light,
    hidden_light,
    pictures,
    seen_through,
    split,
    under_edges,
)
from torch_radbp.boundary.shadows.edge_tree import edge_tree
from torch_radbp.boundary.shadows.film_jumps import FilmJumps, image_of
from torch_radbp.boundary.shadows.followed_light import directions_turn
from torch_radbp.boundary.shadows.hidden_light import as_worth
from torch_radbp.boundary.shadows.seen_edges import Casting
from torch_radbp.boundary.shadows.segment_tree import SegmentTree, segment_tree
from torch_radbp.boundary.term import LineNumbers
from torch_radbp.call.render_call import RenderCall
from torch_radbp.tensors.differentiated import any_differentiated, detached

BYTES_OF_EDGE = 300, 900  # nodes of the tree, and what they are made of: in fused loops, in plain torch
BYTES_OF_WAY = 120  # down the tree: where it is, and what it has found
BYTES_OF_TRIED = 20, 240  # an edge that is tried from a light sample: in fused loops, in plain torch
BYTES_OF_PLACE = 1200  # where it lies, what it is made of, and how it moves, while it is found
BYTES_OF_JUMP = 800  # what is kept of it for the backward pass


class ShadowIntegral(NamedTuple):
    """One of the integrals of light that edges cut off: how to sample its boundary, and its derivative."""

    found: Callable[..., Any]  # of a detached call, a view and edges: the samples; None: there are none
    jumps: Callable[..., FilmJumps]  # of a call, a view's number, edges and the samples
    is_split: bool = False  # `found` also takes a `split.Amount`; its samples are a `SampledIntegral`


def shadows_move(call: RenderCall) -> bool:
    """True if a vertex, an instance, a camera, or the position or direction of a light is differentiated."""
    triangles, tables = call.scene.triangles, zip(call.scene.layout.lights, call.scene.lights.tables)
    return any_differentiated((triangles.vertices.p, triangles.instances, [view.camera.lens for view in call.views],
                               [table for kind, table in tables if not (kind.surround or kind.on_surface)]))


def slides_over_edges(call: RenderCall) -> bool:
    """True if shadow borders move, or directions that carry derivatives turn."""
    return shadows_move(call) or directions_turn(call)


def bytes_of_shadows(call: RenderCall) -> int:
    """The greatest memory of samples on shadow borders."""
    paths = call.spp * max(view.width * view.height for view in call.views)
    edges = outlines_of(call.module).edges_expected(len(call.scene.triangles.material))
    vertices = max(hidden_light.FEWEST_PATHS, min(hidden_light.MOST, paths // hidden_light.SHARE))
    samples = max(FEWEST, min(border.MOST, paths // border.share_of(call.scene)))
    of_edge, tried = (sizes[not call.stages.is_compiled] for sizes in (BYTES_OF_EDGE, BYTES_OF_TRIED))
    ways = max(samples * border.LOOKS * GROUP * tried, vertices * hidden_light.LOOKS * BYTES_OF_WAY)
    looked_for = vertices * hidden_light.PLACES * glues(call)
    places = max(samples, looked_for)
    if paths > hidden_light.SHARE * hidden_light.MOST:  # those of a round, beside those that others have kept
        places += looked_for
    places += seen_through.passes_straight(call.scene) * vertices * hidden_light.PLACES
    if not glues(call) or call.integrand.settings.following:
        places += vertices * followed_light.PLACES * followed_light.TIMES_AS_LARGE
    places += bool(pictures.lines_of_pictures(call)) * samples
    kept = places + int(2 * crossed_surfaces.PLACES * crossed_surfaces.PATHS * vertices)  # fewer than others while found
    of_places = places * BYTES_OF_PLACE + kept * BYTES_OF_JUMP * len(call.views)
    return edges * of_edge + ways + taken_by(call.stages, of_places)


def shadow_jumps(call: RenderCall, casting: Outline | None, crossing: Segments | None,
                 lines: LineNumbers | None = None) -> Tensor:
    """(B, 3, H, W) zeros whose derivative is what borders of shadows contribute to the image.

    Lights without extent have shadows where lights are sampled. What light samples miss of the others is found by vertices
    of paths, and what comes evenly from all around, with a hundredth of the variance. Where directions follow parameters
    (`sampling` "attached"), points that they lead to are not glued to surfaces: then vertices find those borders on which
    directions slide.

    Args:
        call: of which something moves.
        casting: the edges of all that casts shadows; None: nothing moves these.
        crossing: where surfaces pass through each other, of which something moves, and lines that slide; None: nowhere.
        lines: what those follow, attached.
    """
    stages, geometry = call.stages, geometry_of(detached(call.scene))
    with torch.no_grad():
        edges = None if casting is None else Casting(casting, edge_tree(stages, geometry, casting))
        seen = crossing is not None and sees_curves(call, crossing)
        parts = _parts_of(call, segment_tree(stages, geometry, crossing) if seen else None,
                          None if crossing is None else resting_among(crossing), lines)
        parts = parts if edges is not None else parts[-1:] if seen else []
    still, jumps = call.still(), []
    for number in range(len(call.views)):
        with torch.no_grad():
            found = found_of_view(still, number, edges, parts)
        jumps.append([part.jumps(call, number, edges, own) for part, own in zip(parts, found) if own is not None])
    return torch.stack([image_of(view, own, call.scene.dtype) for view, own in zip(call.views, jumps)])


def glues(call: RenderCall) -> bool:
    """True if random hits of paths are fixed to surfaces, except behind rough glass."""
    return call.integrand.settings.sampling != "attached"


def sees_curves(call: RenderCall, crossing: Segments) -> bool:
    """True if path vertices may see intersections of surfaces."""
    return glues(call) and (call.integrand.max_depth > 2 or crossed_surfaces.surfaces_shine(call.scene, crossing))


def _parts_of(call: RenderCall, curves: SegmentTree | None, contacts: Segments | None,
              lines: LineNumbers | None) -> list[ShadowIntegral]:
    """The integrals of a call that are cut off.

    Args:
        call: of which something moves.
        curves: along which surfaces pass through each other; None: unseen.
        contacts: segments at edges that lie on surfaces; None: there are none.
        lines: what lines that slide follow, attached.
    """
    settings, deep = call.integrand.settings, call.integrand.max_depth > 2
    on_film = all(view.camera.kind.has_area for view in call.views)  # along a ray there is no border to be seen
    surfaces, around = aimed_at(call) if on_film else (False, False)
    first = hidden_light.FirstVertex(not surfaces, not around)
    sharp = settings.nee and deep and any(kind.delta for kind in call.scene.layout.lights)
    parts = []
    if on_film:
        lights = border.Lights(settings.nee, surfaces, around)
        parts.append(ShadowIntegral(partial(border.borders_in_view, lights=lights), border.jumps_of_borders))
    if on_film and settings.nee:
        parts += [ShadowIntegral(partial(pictures.picture_borders_in_view, kind=kind, lines=lines),
                                 partial(pictures.jumps_of_pictures, kind=kind))
                  for kind, lines in pictures.lines_of_pictures(call).items()]
    if on_film and settings.nee and contacts is not None:
        parts.append(ShadowIntegral(lambda still, number, _: under_edges.strips_in_view(still, number, contacts),
                                    lambda attached, number, _, found: under_edges.jumps_of_strips(attached, number, found)))
    if glues(call) and (deep or not (surfaces and around)):
        parts.append(ShadowIntegral(partial(hidden_light.cuts_of_view, first=first), hidden_light.jumps_of_cuts,
                                    is_split=True))
    if glues(call) and deep and seen_through.passes_straight(call.scene):
        parts.append(ShadowIntegral(seen_through.cuts_seen_through, hidden_light.jumps_of_cuts, is_split=True))
    if glues(call) and sharp:
        parts.append(ShadowIntegral(bounced.connected_borders_of_paths, bounced.jumps_of_connected_borders))
    if not glues(call) or settings.following:
        parts.append(ShadowIntegral(partial(followed_light.followed_cuts_of_view, first=first),
                                    followed_light.jumps_of_followed_cuts))
        if sharp:
            parts.append(ShadowIntegral(followed_borders.followed_borders_of_paths,
                                        followed_borders.jumps_of_followed_borders))
    if curves is not None:
        parts.append(ShadowIntegral(lambda still, number, _: crossed_surfaces.curves_of_view(still, number, curves),
                                    lambda attached, number, _, found: crossed_surfaces.jumps_of_crossed_surfaces(
                                        attached, number, found, lines)))
    return parts


def found_of_view(still: RenderCall, number: int, edges: Casting, parts: Sequence[ShadowIntegral]) -> list[Any]:
    """The samples of each integral for a view; of the first all, of the others as many as pay off.

    Args:
        still: without derivatives.
        number: of the view.
        edges: of all that casts shadows.
        parts: of the derivative.
    """
    found = [part.found(still, number, edges) for part in parts[:1]]
    splits = any(part.is_split for part in parts[1:]) and split.is_worth_trying(still, number)
    first = split.variance(found[0]) if splits else 0.0
    for part in parts[1:]:
        own = partial(part.found, still, number, edges)
        found.append(as_worth(first, own) if part.is_split and first > 0.0 else own())
    return found


def aimed_at(call: RenderCall) -> tuple[bool, bool]:
    """Whether shadow borders of area lights, and of the environment, are sampled from light samples."""
    emitters, lights = call.module.emitters, call.scene.lights
    surfaces, around = (all(emitter.sampled_whole() for emitter in emitters if emitter.kind().surround == around)
                        for around in (False, True))
    if call.scene.layout.surround is None:
        return surfaces, True
    number, kind = call.scene.layout.surround
    return surfaces, around and not kind.even(detached(lights.tables[number]))
