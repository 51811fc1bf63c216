"""Boundary terms of light that edges occlude: shadow borders of direct and indirect light.

What light an image has is cut off at edges and curves. Each way in which that happens is one term, one class in one file of
this folder (`shadow_term.py`): in each, places are sampled on edges that are silhouettes, from a light or from a vertex of a
path, or on curves along which surfaces touch or pass through each other; what the border sweeps follows from the points that
move. Lights without extent have shadows where lights are sampled. What light samples miss of the others is found by vertices
of paths, and what comes evenly from all around, with a hundredth of the variance.
"""

from __future__ import annotations

from functools import cache, partial

import torch
from torch import Tensor

from torch_radbp.boundary.curve.geometry import geometry_of
from torch_radbp.boundary.curve.outline import Outline, outlines_of
from torch_radbp.boundary.curve.places import taken_by
from torch_radbp.boundary.curve.rendering import Rendering, whole_sight
from torch_radbp.boundary.curve.segments import Segments
from torch_radbp.boundary.curve.term import LineNumbers
from torch_radbp.boundary.eye.deposit import image_of
from torch_radbp.boundary.eye.edge_tree import edge_tree
from torch_radbp.boundary.eye.seen_edges import Casting
from torch_radbp.boundary.terms.lit_edges import EdgesFromLights
from torch_radbp.boundary.terms.shadow_term import SHADOW_TERMS, ShadowSearch, terms_of
from torch_radbp.boundary.terms.split import samples_of_view
from torch_radbp.call.render_call import RenderCall
from torch_radbp.scene.cache.common_work import once
from torch_radbp.tensors.differentiated import any_differentiated, detached
from torch_radbp.tensors.stage import EAGER

PATHS, MOST_EDGES = 1 << 14, 1 << 14  # of a view at least, and of all shapes, for a warning
BYTES_OF_EDGE = 300, 900  # nodes of the tree, and what they are made of: in fused loops, in plain torch
BYTES_OF_PLACE = 1200  # where it lies, what it is made of, and how it moves, while it is found
BYTES_OF_JUMP = 800  # what is kept of it for the backward pass


def shadows_move(call: RenderCall) -> bool:
    """True if a vertex, an instance, a camera, or the position or direction of a light is differentiated."""
    triangles = call.scene.triangles
    return call.scene.lights_move or any_differentiated((triangles.vertices.p, triangles.instances,
                                                          [view.camera.lens for view in call.views]))


def slides_over_edges(call: RenderCall) -> bool:
    """True if shadow borders move, or scattered directions that carry derivatives turn."""
    return shadows_move(call) or any(term.turns(call) for term in SHADOW_TERMS)


def bytes_of_shadows(call: RenderCall) -> int:
    """The greatest memory in bytes of samples on shadow borders."""
    sizes = [term.size(call) for term in SHADOW_TERMS]
    edges = outlines_of(call.module).edges_expected(len(call.scene.triangles.material))
    found, kept = (sum(numbers) for numbers in list(zip(*sizes))[1:])
    return (edges * BYTES_OF_EDGE[not call.stages.is_compiled] + max(size.search for size in sizes)
            + taken_by(call.stages, found * BYTES_OF_PLACE + kept * BYTES_OF_JUMP * len(call.views)))


def shadow_jumps(call: RenderCall, casting: Outline | None, crossing: Segments | None,
                 lines: LineNumbers | None = None) -> Tensor:
    """(B, 3, H, W) zeros with the derivatives that shadow borders contribute to the images.

    Args:
        call: the rendering, in which something moves.
        casting: the edges of everything that casts shadows; None: nothing moves shadows.
        crossing: intersections of surfaces that move, and texture lines that slide; None: there are none.
        lines: the coefficients of those lines, attached.
    """
    still, images = call.still(), []
    facts = cache(still.facts)
    with torch.no_grad():
        edges = None if casting is None else once("edges that cast shadows", lambda: (facts(), casting),
                                                  lambda: Casting(casting, edge_tree(call.stages, geometry_of(still.scene),
                                                                                     casting)))
        terms = terms_of(ShadowSearch(call, still, edges, crossing, lines, edges and EdgesFromLights(still, edges)))
    for number in range(len(call.views)):
        with torch.no_grad():
            found = once(("borders of shadows", number), lambda: (
                facts(), list(map(type, terms)), casting, crossing, detached(lines)),
                partial(samples_of_view, still, number, terms))
        deposits = [deposit for term, own in zip(terms, found) if own is not None for deposit in term.jumps(number, own)]
        images.append(image_of(call, number, deposits))
    return torch.stack(images)


def shadows_left_out(rendering: Rendering) -> set[str]:
    """The parameters that move shadow borders of terms that are off, anywhere on the films, found by a few samples."""
    call = rendering.call.still()
    views = [view._replace(window=view.sensor.film.window(), camera=whole_sight(view, view.camera.lens).camera)
             for view in call.views]
    spp = max(1, PATHS // min(view.width * view.height for view in views))
    call = call._replace(stages=EAGER, spp=spp, integrand=call.integrand.with_stages(EAGER)).with_views(views)
    edges = outlines_of(rendering.scene).of_everything(rendering, 0, MOST_EDGES)
    if edges is None:
        return set()
    casting = Casting(edges, edge_tree(EAGER, geometry_of(call.scene), edges))
    search = ShadowSearch(call, call, casting, None, None, EdgesFromLights(call, casting))
    return set().union(*(term(search).left_out(rendering) for term in SHADOW_TERMS))
