"""Boundary terms of discontinuities that the camera sees by way of ideal mirrors and glass.

After reflection and refraction into single directions, a point of the film sees something else, a ray of which the path is
attached to the camera, to all mirrors and to all glass on its way. Where what it meets changes, at an edge, the radiance L
jumps along a curve of the film. No edge is projected there: a curve has as many images as there are ways, and they are bent.
Instead the film is scanned, along short horizontal and vertical lines; steps between points on these that see different
things are divided, again and again. With g a level that is 0 on the curve, and n its normal, the curve moves by
-g' / |grad g|, and N horizontal lines of unit length for each square pixel, with as many vertical ones, cross a piece dl of
it N (|n_x| + |n_y|) dl times. So each crossing stands for

    dI = h (L_low - L_high) (-g') sign / (N (|g_x| + |g_y|))

with the sign by which g grows from the low to the high side of the curve.

Borders of shadows are such curves, too. Each scan has one light sample, and the difference at the border of its shadow is
the light of this sample: that of lamps of some extent is the mean over their points, as in `border.py`.

References: Loubet, Holzschuch and Jakob 2019, "Reparameterizing Discontinuous Integrands for Differentiable Rendering"
(discontinuities seen by way of ideal surfaces); Santalo 1976, "Integral Geometry and Geometric Probability", chapter 3
(lengths of curves by the lines that cross them).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.adjoint.attached import rays_reaching
from torch_radbp.adjoint.forward_mode import has_tangents
from torch_radbp.adjoint.scatter import Gradients
from torch_radbp.boundary.curve.outline import Outline
from torch_radbp.boundary.curve.places import FEWEST
from torch_radbp.boundary.curve.triangles_in_view import may_see_ideal_surfaces
from torch_radbp.boundary.eye.black_strips import has_black_strips
from torch_radbp.boundary.eye.deposit import Deposit, image_of
from torch_radbp.boundary.eye.differences import SHADOW, parted
from torch_radbp.boundary.eye.ideal_paths import ideal_at_first, only_ideal
from torch_radbp.boundary.eye.ideal_steps import LIT
from torch_radbp.boundary.eye.rays import Follows, adjoint_of_start, chains_of, following, follows_chains
from torch_radbp.boundary.eye.seen_on_film import camera_sample
from torch_radbp.boundary.eye.surfaces import LineTable, surfaces_of
from torch_radbp.boundary.eye.viewpoints import path_of
from torch_radbp.boundary.terms.covered_lights import Lights
from torch_radbp.boundary.terms.crossings import Crossings, curve_crossings
from torch_radbp.boundary.terms.curves import Curves, curves_crossed, level
from torch_radbp.boundary.terms.scans import MOST, SHARE, Searched, scans_of, turns_of, turns_together
from torch_radbp.call.render_call import RenderCall, integrand_of, started
from torch_radbp.path.direct_light import LightDraw, light_sent_back
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.trace import trace
from torch_radbp.tensors.differentiated import any_differentiated, detached, primal
from torch_radbp.tensors.record import joined, leaves_of, selected
from torch_radbp.tensors.vec import Ray, Vec2, Vec3, rows
from torch_radbp.tensors.vector_jacobian import vector_jacobian_product, zeros_unless
from torch_radbp.threads.workers import in_turns

BLOCK = 1 << 12  # places that are scanned together
BYTES_OF_CORNER = 700  # what is known of the path from there
BYTES_OF_PLACE = 12000  # and of those from points of the scans, while they are looked at
BYTES_OF_CROSSING = 2000  # where it lies, and what it crosses
BYTES_OF_BOUNCE, USUAL_VERTICES = 2500, 4  # what torch keeps of it for the backward pass where it records; of how many
CROSSINGS = 1  # of a place


class Reflected(NamedTuple):
    """The edges and texture lines for discontinuities that cameras see by way of mirrors and glass."""

    meshes: list[Outline]  # edges of all meshes, in the frames of their vertices
    lines: LineTable | None  # of textures
    surfaces: bool  # discontinuities of reflected radiance are computed
    shadows: bool  # and borders of shadows, of `Lights.mirrored`


def reflections_move(call: RenderCall) -> bool:
    """True if a vertex, a normal, an instance, a camera, or an index of ideal refraction is differentiated."""
    vertices = call.scene.triangles.vertices
    return call.scene.layout.bends_ideally or any_differentiated((
        vertices.p, vertices.n, call.scene.triangles.instances, [view.camera.lens for view in call.views]))


def bytes_of_reflections(call: RenderCall) -> int:
    """The usual memory in bytes of scans of the film and of the crossings that they find."""
    paths = call.spp * max(view.width * view.height for view in call.views)
    if not any(may_see_ideal_surfaces(view, call.still_scene, paths) for view in call.views):
        return 0
    corners = max((view.grid.columns + 1) * (view.grid.rows + 1) for view in call.views)
    corners *= turns_together(corners, turns_of(call))
    places = max(FEWEST, min(MOST, paths // SHARE))
    together = places if places <= BLOCK else min(places, BLOCK * call.workers)
    looked_at = max(corners * BYTES_OF_CORNER, together * BYTES_OF_PLACE)
    kept = BYTES_OF_BOUNCE * min(call.integrand.max_depth, USUAL_VERTICES) if call.adjoint.taped else 0
    return looked_at + places * CROSSINGS * (BYTES_OF_CROSSING + len(call.views) * kept)


def reflected_jumps(call: RenderCall, reflected: Reflected) -> Tensor:
    """(B, 3, H, W) zeros with the derivatives of discontinuities seen by way of ideal mirrors and glass.

    Args:
        call: the rendering, in which something moves.
        reflected: the edges and lines to look for.
    """
    images = []
    with torch.no_grad():
        still = call.still()
        surfaces = surfaces_of(still, reflected.meshes, detached(reflected.lines))
        tables, = call.stages(parted).taken(surfaces=surfaces)
        lights = Lights.mirrored(still) if reflected.shadows else Lights(False, False, False)
        strips = has_black_strips(still)
    for number in range(len(call.views)):
        integrand = ideal_at_first(integrand_of(still, still.integrand, number))
        searched = Searched(still, number, only_ideal(integrand), surfaces, tables, lights, strips)
        found = _jumps_in_view(call, searched, integrand, reflected)
        images.append(image_of(call, number, [] if found is None else [found]))
    return torch.stack(images)


class CurveCrossings(NamedTuple):
    """K points at which scans of the film cross identified discontinuity curves; detached."""

    crossed: Crossings
    curves: Curves
    follows: Follows  # how the curves' levels depend on the paths
    strength: Tensor  # (3, K) float64, gain of light in the image per unit of the level


def _jumps_in_view(call: RenderCall, searched: Searched, integrand: Integrand, reflected: Reflected) -> Deposit | None:
    """The derivative from a view's discontinuities seen in mirrors and glass, as a film deposit; None: there are none.

    Args:
        call: attached.
        searched: the view.
        integrand: for the view, detached.
        reflected: the edges and lines to look for.
    """
    with torch.no_grad():
        found = jumping(searched, integrand, reflected.surfaces)
    if found is None:
        return None
    middle = Vec2(*(0.5 * (low + high) for low, high in zip(found.crossed.low, found.crossed.high)))
    return Deposit(middle, found.strength.unbind(), moved(call, searched, found, reflected.lines))


def moved(call: RenderCall, searched: Searched, found: CurveCrossings, lines: LineTable | None) -> Tensor:
    """(K,) float64 zeros whose derivatives are those of the curves' level functions at fixed points of the film; args as of
    `_jumps_in_view`; `lines`: of surfaces, attached."""
    crossed, curves, follows, _ = found
    view, draw = call.views[searched.number], draw_of(crossed)
    sample = camera_sample(call, view, crossed.low, crossed.aperture, crossed.key)
    if call.adjoint.taped or has_tangents((call.scene, view.camera, lines)):
        integrand = ideal_at_first(integrand_of(call, call.make_integrand(call.scene), searched.number))
        ray = rays_reaching(follows_chains(integrand), started(call, sample), crossed.depth)
        seen = level(call.scene, lines, curves, ray, draw)
        return seen - primal(seen)
    change = following(follows, sample.ray, call.scene)
    if any_differentiated((call.scene, lines)):
        seen = level(call.scene, lines, curves, follows.chains.ray, draw)
        change = change + (seen - primal(seen))
    return change


def draw_of(crossed: Crossings) -> LightDraw | None:
    """The light samples whose shadow borders were crossed; None: none were searched."""
    return None if crossed.looks is None else crossed.looks.draw


def jumping(searched: Searched, integrand: Integrand, surfaces: bool) -> CurveCrossings | None:
    """The curves of a view, with the jumps across them; None: there are none. `surfaces`: not only shadow borders."""
    crossed = crossings_in_view(searched)
    if crossed is None:
        return None
    curves, known = curves_crossed(searched, crossed)
    own = (known if surfaces else known & (crossed.kind == SHADOW)).nonzero().squeeze(1)
    crossed, curves = rows((crossed, curves), own)
    jump = jumps_at(searched, integrand, crossed)
    own = (jump != 0).any(0).nonzero().squeeze(1)
    if not len(own):
        return None
    crossed, curves = rows((crossed, curves), own)
    follows = how_levels_follow(searched, integrand, crossed, curves)
    slope = slope_on_film(searched, crossed, follows.adj_start)
    step = Vec2(*(high - low for low, high in zip(crossed.low, crossed.high)))
    steepness = slope.x.abs() + slope.y.abs()
    known = (steepness > 0) & torch.isfinite(steepness)
    weight = -torch.sign(slope.x * step.x + slope.y * step.y) * crossed.times / torch.where(known, steepness, 1.0)
    return CurveCrossings(crossed, curves, follows, jump[:, own] * torch.where(known, weight, 0.0))


def crossings_in_view(searched: Searched) -> Crossings | None:
    """Finds the crossings of curves by all scans of a view; None: there are none."""
    scans = scans_of(searched)
    if scans is None:
        return None
    lots = torch.arange(len(scans.times), device=scans.times.device).split(BLOCK)

    def work(share: Iterable[int]) -> list[Crossings | None]:
        return [curve_crossings(searched, rows(scans, lots[lot]), lot) for lot in share]

    shares = in_turns(len(lots), searched.call.workers, work)
    parts = [shares[lot % len(shares)][lot // len(shares)] for lot in range(len(lots))]
    parts = [part for part in parts if part is not None]
    return joined(parts) if parts else None


def jumps_at(searched: Searched, integrand: Integrand, crossed: Crossings) -> Tensor:
    """(3, K) float64, the jumps at crossed curves: radiance on the scan's low side less that on its high side."""
    jump = torch.zeros(3, len(crossed.times), dtype=torch.float64, device=crossed.times.device)
    shadows = crossed.kind == SHADOW
    for chosen, of_some in ((~shadows, radiance_lost), (shadows, light_lost)):
        own = chosen.nonzero().squeeze(1)
        if len(own):
            jump[:, own] = of_some(searched, integrand, rows(crossed, own))
    return jump


def light_lost(searched: Searched, integrand: Integrand, crossed: Crossings) -> Tensor:
    """The jumps at shadow borders: the light of the light sample that one side lacks. Args and result as of `jumps_at`."""
    call, in_light = searched.call, (crossed.below.what & LIT) != 0
    lit = selected(in_light, crossed.below, crossed.above)
    state = path_of(call, lit.ray, crossed.key)._replace(cone=lit.cone)
    light = light_sent_back(integrand, state, lit.hit, crossed.looks.draw) * lit.beta
    weight = camera_sample(call, call.views[searched.number], crossed.low, crossed.aperture, crossed.key).weight
    light = torch.stack(tuple(light if weight is None else light * weight)).double()
    return torch.where(in_light, light, -light)


def radiance_lost(searched: Searched, integrand: Integrand, crossed: Crossings) -> Tensor:
    """The jumps at curves other than shadow borders, of the whole radiance. Args and result as of `jumps_at`."""
    call = searched.call
    film = joined([crossed.low, crossed.high])
    aperture, key = (joined([part] * 2) for part in (crossed.aperture, crossed.key))
    sample = camera_sample(call, call.views[searched.number], film, aperture, key)
    found = torch.stack(tuple(trace(integrand, started(call, sample)))).double()
    low, high = (found if sample.weight is None else found * sample.weight).chunk(2, 1)
    return low - high


def how_levels_follow(searched: Searched, integrand: Integrand, crossed: Crossings, curves: Curves) -> Follows:
    """The derivatives of the crossed curves' level functions by the rays that see the curves, and by the camera rays."""
    call, integrand = searched.call, follows_chains(integrand)
    sample = camera_sample(call, call.views[searched.number], crossed.low, crossed.aperture, crossed.key)
    chains = chains_of(integrand, started(call, sample), crossed.depth)
    with torch.enable_grad():
        leaves = [part.clone().requires_grad_() for part in leaves_of(chains.ray)]
        ray = Ray(Vec3(*leaves[:3]), Vec3(*leaves[3:]))
        found = level(call.scene, searched.surfaces.lines, curves, ray, draw_of(crossed))
        slopes = vector_jacobian_product([found], leaves, [torch.ones_like(found)])
    slopes = [zeros_unless(*parts) for parts in zip(slopes, leaves)]
    adj_ray, nothing = Ray(Vec3(*slopes[:3]), Vec3(*slopes[3:])), (False,) * len(leaves_of(call.scene))
    return Follows(integrand, chains, adj_ray, adjoint_of_start(integrand, chains, adj_ray, nothing, Gradients([])))


def slope_on_film(searched: Searched, crossed: Crossings, adj_start: Ray) -> Vec2:
    """The derivatives of level functions by film position, (K,) float64; `adj_start`: those by the paths' first rays."""
    call = searched.call
    with torch.enable_grad():
        film = Vec2(*(part.clone().requires_grad_() for part in crossed.low))
        sample = camera_sample(call, call.views[searched.number], film, crossed.aperture, crossed.key)
        slopes = vector_jacobian_product(leaves_of(sample.ray), list(film), leaves_of(adj_start))
    return Vec2(*(zeros_unless(*parts) for parts in zip(slopes, film)))
