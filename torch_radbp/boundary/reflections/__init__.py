"""What jumps that the camera sees by way of mirrors and glass add to derivatives of its image.

After reflection and refraction into single directions, a point of the film sees something else, a ray of which the path is
attached to the camera, to all mirrors and to all glass on its way. Where what it meets changes, at an edge, the radiance L
jumps along a curve of the film. No edge is projected there: a curve has as many images as there are ways, and they are bent.
Instead the film is scanned, along short horizontal and vertical lines; points on these that see different things are brought
together by bisection. With g a level that is 0 on the curve, and n its normal, the curve moves by -g' / |grad g|, and N
horizontal lines of unit length for each square pixel, with as many vertical ones, cross a piece dl of it N (|n_x| + |n_y|) dl
times. So each crossing stands for

    dI = h (L_low - L_high) (-g') sign / (N (|g_x| + |g_y|))

with the sign by which g grows from the low to the high side of the curve.

References: Loubet, Holzschuch and Jakob 2019, "Reparameterizing Discontinuous Integrands for Differentiable Rendering"
(discontinuities seen by way of ideal surfaces); Santalo 1976, "Integral Geometry and Geometric Probability", chapter 3 (lengths of
curves by the lines that cross them).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import torch
from torch import Tensor

from torch_radbp.boundary.geometry import Geometry, geometry_of
from torch_radbp.boundary.outline import Outline
from torch_radbp.boundary.reflections.crossings import Crossings, crossings
from torch_radbp.boundary.reflections.curves import Curves, curves_crossed, level
from torch_radbp.boundary.reflections.differences import continued
from torch_radbp.boundary.reflections.ideal_paths import only_ideal
from torch_radbp.boundary.reflections.rays import ray_after
from torch_radbp.boundary.reflections.scans import scans_of
from torch_radbp.boundary.shadows.border import camera_sample
from torch_radbp.boundary.shadows.film_jumps import FilmJumps, attached_geometry, image_of
from torch_radbp.call.render_call import RenderCall, integrand_of, started
from torch_radbp.call.workers import in_turns
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.wavefront import trace
from torch_radbp.tensors.differentiated import any_differentiated, detached, primal
from torch_radbp.tensors.record import joined
from torch_radbp.tensors.vec import Vec2, rows

BLOCK = 1 << 11  # places that are scanned together


def seen_by_way_of_others(call: RenderCall) -> bool:
    """True if the scene has mirrors or glass, and what is seen there may move."""
    settings, triangles, layout = call.integrand.settings, call.scene.triangles, call.scene.layout
    return (settings.moving and settings.sampling != "detached" and call.integrand.max_depth > 1
            and any(appearance.kind.delta for appearance in layout.appearances)
            and all(view.camera.kind.has_area for view in call.views)
            and (layout.bending or any_differentiated((triangles.vertices.p, triangles.vertices.n, triangles.instances,
                                                       [view.camera.lens for view in call.views]))))


def reflected_jumps(call: RenderCall, meshes: Sequence[Outline]) -> Tensor:
    """(B, 3, H, W) zeros with the derivatives of jumps that are seen by way of ideal mirrors and glass.

    Args:
        call: of which something moves.
        meshes: the edges of everything, in the frames of their vertices.
    """
    with torch.no_grad():
        continues = continued(detached(call.scene), meshes)
    return torch.stack([image_of(view, [jumps for jumps in (jumps_in_view(call, number, continues),) if jumps is not None],
                                 call.scene.dtype) for number, view in enumerate(call.views)])


def jumps_in_view(call: RenderCall, number: int, continues: Tensor) -> FilmJumps | None:
    """What they add to the derivative of view `number`; None: it sees none."""
    with torch.no_grad():
        found = strengths(call.still(), number, continues)
    if found is None:
        return None
    crossed, curves, strength = found
    seen = level_on_film(call, attached_geometry(call.scene), number, crossed, curves, crossed.low)
    return FilmJumps(middle(crossed), strength * (seen - primal(seen)))


def middle(crossed: Crossings) -> Vec2:
    """The points of the film at which curves are crossed."""
    return Vec2(*(0.5 * (low + high) for low, high in zip(crossed.low, crossed.high)))


def level_on_film(call: RenderCall, geometry: Geometry, number: int, crossed: Crossings, curves: Curves,
                  film: Vec2) -> Tensor:
    """The level at points of the film, (K,) float64, attached; args as before."""
    view = call.views[number]
    integrand = integrand_of(call, call.make_integrand(call.scene), call.chunks[0]._replace(sensor=number))
    sample = camera_sample(call, view, film, crossed.aperture, crossed.key)
    return level(geometry, curves, ray_after(call, integrand, sample, crossed.depth))


def strengths(call: RenderCall, number: int, continues: Tensor) -> tuple[Crossings, Curves, Tensor] | None:
    """Where view `number` sees jumps, what curves these are, and (3, K) float64 by how much more is seen where the level is
    less, for each change of the level; None: nowhere."""
    whole = integrand_of(call, call.integrand, call.chunks[0]._replace(sensor=number))
    integrand = only_ideal(whole)
    scans = scans_of(call, number, integrand, continues)
    if scans is None:
        return None
    lots = torch.arange(len(scans.times), device=scans.times.device).split(BLOCK)

    def work(share: Iterable[int]) -> list[tuple[Crossings, Curves, Tensor] | None]:
        return [part_of(call, number, whole, continues, crossings(call, number, integrand, continues,
                                                                  rows(scans, lots[lot]), lot)) for lot in share]

    shares = in_turns(len(lots), call.workers, work)
    parts = [shares[lot % len(shares)][lot // len(shares)] for lot in range(len(lots))]
    parts = [part for part in parts if part is not None]
    if not parts:
        return None
    return tuple(joined(list(column)) if not isinstance(column[0], Tensor) else torch.cat(column, -1)
                 for column in zip(*parts))


def part_of(call: RenderCall, number: int, integrand: Integrand, continues: Tensor,
            crossed: Crossings | None) -> tuple[Crossings, Curves, Tensor] | None:
    """What `strengths` says of some crossings."""
    if crossed is None:
        return None
    curves, known = curves_crossed(geometry_of(call.scene), crossed)
    own = known.nonzero().squeeze(1)
    if not len(own):
        return None
    crossed, curves = rows(crossed, own), rows(curves, own)
    view = call.views[number]
    sides = []
    for film in (crossed.low, crossed.high):
        sample = camera_sample(call, view, film, crossed.aperture, crossed.key)
        found = torch.stack(tuple(trace(integrand, started(call, sample)))).double()
        sides.append(found if sample.weight is None else found * sample.weight)
    jump = sides[0] - sides[1]
    kept = (jump != 0).any(0).nonzero().squeeze(1)
    if not len(kept):
        return None
    crossed, curves, jump = rows(crossed, kept), rows(curves, kept), jump[:, kept]
    slope = slope_on_film(call, number, crossed, curves)
    step = Vec2(*(high - low for low, high in zip(crossed.low, crossed.high)))
    rises = slope.x * step.x + slope.y * step.y
    steepness = slope.x.abs() + slope.y.abs()
    known = (steepness > 0) & torch.isfinite(steepness)
    weight = torch.where(known, -torch.sign(rises) * crossed.times / torch.where(known, steepness, 1.0), 0.0)
    return crossed, curves, jump * weight


def slope_on_film(call: RenderCall, number: int, crossed: Crossings, curves: Curves) -> Vec2:
    """How the level changes with the point of the film, (K,) float64."""
    with torch.enable_grad():
        film = Vec2(*(part.clone().requires_grad_() for part in crossed.low))
        found = level_on_film(call, geometry_of(call.scene), number, crossed, curves, film)
        slopes = torch.autograd.grad(found.sum(), tuple(film))
    return Vec2(*slopes)
