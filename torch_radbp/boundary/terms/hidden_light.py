"""Boundary term of light that edges occlude from path vertices (soft shadows and indirect light).

At a vertex x of a path, surfaces around it end at edges, and what lies behind appears. Paths that are scattered there go on
to points z that are glued to surfaces; as an integral over the surfaces of z,

    L(x) = integral of f |cos x| |cos z| / r^2  L(z, x) dA

is cut off where an edge hides z from x. The border of the cut lies where the line from x through the point p of the edge
meets the surface of z. It moves over the points that are glued there, and changes L by

    dL = - integral of f |cos x| |cos z| / r^2  L(z, x)  v . n dl

with n into what is hidden no longer and v its velocity over these points; close to x they slide (`eye/slid.py`). What hides
z has no part in this: its own points move with its edge.
Where nothing lies behind, directions take the place of the points.

Light that the first surface receives straight from lamps is counted in `border.py`, that of later ones that are met by
chance in `bounced.py`, of those that cameras see by way of one coat in `reflections.py`, and that of vertices in
media in `shafts.py`; but what no light sample finds, and what comes evenly from all around, is better found here.

References: Li, Aittala, Durand and Lehtinen 2018, "Differentiable Monte Carlo Ray Tracing through Edge Sampling", section 4;
Zhang, Miller, Yan, Gkioulekas and Zhao 2020, "Path-Space Differentiable Rendering", section 5.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.curve.geometry import geometry_of
from torch_radbp.boundary.curve.outline import Outline
from torch_radbp.boundary.curve.rendering import Rendering
from torch_radbp.boundary.eye import film_density
from torch_radbp.boundary.eye.deposit import Deposit
from torch_radbp.boundary.eye.eyes import Eyes
from torch_radbp.boundary.eye.light_points import light_lobes, light_points
from torch_radbp.boundary.eye.lines_through_edges import scattered_towards, solid_angle
from torch_radbp.boundary.eye.past_edges import PastEdges, seen_past_edges
from torch_radbp.boundary.eye.seen_edges import Casting, Passed, places_seen, salted, uniform_numbers
from torch_radbp.boundary.eye.thinning import chances, thinned
from torch_radbp.boundary.eye.viewpoints import PathBatch, Viewpoints, eyes_at, path_of, vertex_at, viewpoints
from torch_radbp.boundary.terms import split
from torch_radbp.boundary.terms.border import most_samples
from torch_radbp.boundary.terms.call_traits import glues
from torch_radbp.boundary.terms.covered_lights import SOFT, Lights
from torch_radbp.boundary.terms.cuts import (
    CutsOfView,
    cuts_that_matter,
    joined_cuts,
    jumps_of_cuts,
    rise_of,
    some_cuts,
    with_used_viewpoints,
)
from torch_radbp.boundary.terms.shadow_term import ShadowTerm, TermSize, shadow_term
from torch_radbp.boundary.terms.split import ALL, Amount
from torch_radbp.call.render_call import RenderCall, integrand_of
from torch_radbp.call.view import View
from torch_radbp.path.event import Ends
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.trace import trace
from torch_radbp.sampling.sampler import SampleKey
from torch_radbp.tensors.vec import Ray, Vec3, masked, max_component, rows

SALT = 0x3C6EF372  # tells the random numbers of these places from others
SHARE, MOST = 16, 1 << 16  # one path for so many of the image; and at most at once
ROUNDS = 16  # of `MOST` paths, at most
LOOKS, PLACES = 8, 4  # for edges from each, and places on edges that were found
FEWEST_PATHS = 16
FEW = 1024  # paths of a warning
GRAZING = 0.1  # cosine with the normal below which a warning leaves edges out: all such give 1% of a uniform sky's light
TIMES_AS_MANY = 4  # paths whose vertices are wanted or not,
WANTED = 64.0  # and how much more those are that mirrors and glass lead to, where only these see lamps
BYTES_OF_WAY = 120  # down the tree of edges: where it is, and what it has found


class Straight(NamedTuple):
    """Which lights of some extent this term counts where path vertices see them directly; other terms count the rest."""

    from_surfaces: Lights  # of first vertices
    # Of later ones past edges that lie on no surface; all others see all here:
    by_chance: Lights  # that are met by chance
    behind_ideal: Lights  # that cameras see by way of one ideal vertex
    in_media: Lights

    @staticmethod
    def uncovered(call: RenderCall) -> Straight:
        """The lights whose occlusion by edges, as path vertices see it, no other boundary term computes."""
        shafts = Lights.with_shafts(call)
        by_chance, behind_ideal = (SOFT._replace(soft=not lights.soft)
                                   for lights in (Lights.bounced(call), Lights.mirrored(call)))
        return Straight(Lights.uncovered(call), by_chance, behind_ideal, Lights(False, not shafts.soft, not shafts.around))


EVERYTHING = Straight(SOFT, SOFT, SOFT, SOFT)


@shadow_term
class HiddenLight(ShadowTerm):
    """The boundary term of light that edges occlude from path vertices, whose next hits are fixed to surfaces."""

    rank = 3
    through_media = True
    is_split = True

    @classmethod
    def size(cls, call: RenderCall) -> TermSize:
        paths = most_paths(call)
        places = glues(call) * paths * PLACES
        # Those of a round beside those that others have kept. Where they are few, they are where places on borders were.
        more = places if any(view.width * view.height * call.spp > SHARE * MOST for view in call.views) else 0
        found = max(0, places - most_samples(call)) + more
        return TermSize(paths * LOOKS * BYTES_OF_WAY, found, found)

    def applies(self) -> bool:
        later = self.call.integrand.max_depth > (1 if self.call.scene.layout.emitting_media else 2)
        counted = Straight.uncovered(self.call)
        return glues(self.call) and (later or any(counted.from_surfaces) or any(counted.in_media))

    def samples(self, number: int, amount: Amount = ALL) -> CutsOfView | None:
        return cuts_of_view(self.still, number, self.casting, amount, counted=Straight.uncovered(self.still))

    def left_out(self, rendering: Rendering) -> set[str]:
        counted, outline = EVERYTHING._replace(from_surfaces=Lights.uncovered(self.still)), self.casting.outline
        names: set[str] = set()
        if rendering.shadows or not any(counted.from_surfaces):
            return names
        call = self.still._replace(integrand=self.still.integrand._replace(max_depth=2))  # light straight from lamps
        for number, view in enumerate(call.views):
            share = min(1.0, FEW / number_of_paths(call, view))
            found = cuts_of_view(call, number, self.casting, Amount(share), counted=counted)
            if found is None:
                continue
            cuts = rows(found.cuts, (rise_of(call, number, outline, found) > GRAZING).nonzero().squeeze(1))
            if len(cuts.edge):
                standing = rows(found.points.standing.prim, cuts.viewpoint)
                names |= rendering.movers_at(outline.triangle(cuts.edge), standing, cuts.hit.prim)
                names |= {*rendering.moving(view.sensor)}
        return names

    def jumps(self, number: int, found: CutsOfView) -> list[Deposit]:
        return [jumps_of_cuts(self.call, number, self.casting.outline, found)]


def cuts_of_view(call: RenderCall, number: int, casting: Casting, amount: Amount = ALL, *,
                 counted: Straight) -> CutsOfView | None:
    """Samples edges that occlude light from paths of view `number`; None: there are none.

    Args:
        call: detached.
        casting: the edges of everything that casts shadows.
        amount: the number of paths, as shares; samples of pilot paths are among the result.
        counted: the lights that count here where vertices see them directly.
    """
    view, integrand = call.views[number], integrand_of(call, call.integrand, number)
    paths, more, before = (number_of_paths(call, view, share, ROUNDS * MOST) for share in (
        amount.counted, amount.tried, amount.before))
    density, some = None, paths // film_density.SHARE
    if some >= film_density.FEWEST:
        trial = looks_at_edges(split.trying(call), number, integrand, casting, PathBatch(some), counted)
        density = None if trial is None else film_density.film_density(view, trial.points, trial.passed)
    rounds = -(-(paths + more) // MOST)
    count, found = paths // rounds, []
    for begun in range(before, before + rounds * count, count):
        batch = PathBatch(count, density, begun, more // rounds)
        looks = looks_at_edges(call, number, integrand, casting, batch, counted)
        cuts = None if looks is None else cuts_of_looks(call, integrand, casting, looks, counted)
        if cuts is not None:
            found.append(cuts if rounds == 1 else fewer(cuts, salted(view, SALT), begun, MOST * PLACES // rounds))
    return joined_cuts([(own, 1.0 / rounds) for own in found])


def cuts_of_looks(call: RenderCall, integrand: Integrand, casting: Casting, looks: EdgeSightings,
                  counted: Straight) -> CutsOfView | None:
    """The samples of edges that path vertices see, `looks`, at which an edge occludes light; None: there are none.

    Other args as for `looks_at_edges`.
    """
    geometry, (points, at, passed) = geometry_of(call.scene), looks
    layout, alone = call.scene.layout, torch.zeros_like(passed.edge, dtype=torch.bool)
    if layout.scattering_media or layout.emitting_media:
        alone = ~alone
    elif layout.surround is not None:
        alone = counted.from_surfaces.around | rows(points.depth > 0, passed.eye)
    passed, past = seen_past_edges(call, integrand, casting.outline, points, at, passed, alone)
    if not len(passed.edge):
        return None
    return cuts_that_matter(call.stages, geometry, casting, points, at, passed, past.fixed_to(call.scene),
                            lambda cuts: light_beyond(call, integrand, points, at, passed, past, counted,
                                                      on_no_surface(casting.outline, passed.edge)))


def fewer(found: CutsOfView, key: SampleKey, begun: int, most: int) -> CutsOfView:
    """Thins the samples of one round of paths at random to about `most`, reweighted so that they stand for all.

    Args:
        key: of random numbers.
        begun: the number of the round's first path.
    """
    chance = chances((found.strength * found.sweep).abs().amax(0), most)
    kept = thinned(chance, uniform_numbers(key, begun + found.cuts.edge.new_zeros(1), SALT, torch.float64))
    return with_used_viewpoints(some_cuts(found, kept)._replace(strength=found.strength[:, kept] / chance[kept]))


class EdgeSightings(NamedTuple):
    """Samples on edges as path vertices see them."""

    points: Viewpoints  # (M,)
    at: Vec3  # (M,) where they are
    passed: Passed  # (N,) samples, each with an equal share of angle


def looks_at_edges(call: RenderCall, number: int, integrand: Integrand, casting: Casting, batch: PathBatch,
                   counted: Straight) -> EdgeSightings | None:
    """Samples edges as seen from vertices of a batch of paths; None: they see none.

    Args:
        call, number, casting: as for `cuts_of_view`.
        integrand: for the view.
        batch: the paths.
        counted: as for `cuts_of_view`.
    """
    geometry = geometry_of(call.scene)
    more = wider(call, batch, counted)
    points = viewpoints(call, number, integrand, more)
    if not len(points.depth):
        return None
    if more is not batch:
        points = wanted(points, batch, salted(call.views[number], SALT + 1))
    if batch.begun:
        call = split.with_numbers(call, SALT + batch.begun)
    at = vertex_at(call, geometry, number, points)
    eyes = eyes_of(call, number, integrand, points, at, counted)
    passed = places_seen(call.stages, geometry, casting, eyes, salted(call.views[number], SALT), LOOKS,
                         PLACES * len(points.depth), points.tried)
    return None if passed is None else EdgeSightings(points, at, passed)


def wider(call: RenderCall, batch: PathBatch, counted: Straight) -> PathBatch:
    """A larger batch of paths where only vertices behind mirrors and glass see lamps; `wanted` thins their vertices."""
    narrow = any(look.kind.delta for look in call.scene.layout.appearances)
    if counted.by_chance.soft or not narrow:
        return batch
    times = max(1, min(TIMES_AS_MANY, MOST // (batch.count + batch.tried)))
    return PathBatch(batch.count * times, batch.density, batch.begun * times, batch.tried * times, WANTED)


def wanted(points: Viewpoints, batch: PathBatch, key: SampleKey) -> Viewpoints:
    """Thins viewpoints to the number of `batch`, preferring those behind mirrors and glass. `key`: of random numbers."""
    own = torch.ones_like(points.slides) if points.tried is None else ~points.tried
    after_ideal = (points.depth > 0) & ~points.by_chance
    size = max_component(points.beta).double() * torch.where(after_ideal, WANTED, 1.0)
    chance = torch.where(own, chances(torch.where(own, size, 0.0), batch.count),
                         chances(torch.where(own, 0.0, size), batch.tried))
    kept = thinned(chance, uniform_numbers(key, batch.begun + points.sample.new_zeros(1), SALT, torch.float64))
    points, chance = rows((points, chance), kept)
    return points._replace(beta=points.beta * (1.0 / chance).to(points.beta.x.dtype))


def eyes_of(call: RenderCall, number: int, integrand: Integrand, points: Viewpoints, at: Vec3, counted: Straight) -> Eyes:
    """The viewpoints, with weights of directions by BSDF and lights, from which edges are sampled.

    Args:
        call, number: the rendering, and the number of the view.
        integrand: for the view.
        points, at: the viewpoints, and their positions.
        counted: the lights that count here where vertices see them directly.
    """
    lobes = ()
    if call.scene.layout.lights:
        lights = light_points(call.stages, call.scene, call.views[number], len(points.depth))
        surfaces, by_chance, mirrors, media, everywhere = (some.of(call.scene)[lights.kind] for some in (*counted, SOFT))
        later = torch.where(points.by_chance, by_chance, torch.where(points.behind_ideal, mirrors, everywhere))
        meant = torch.where(points.in_medium, media, torch.where(points.depth > 0, later, surfaces))
        lobe = integrand.part(Ends.SURROUNDINGS).call(light_lobes, at, lights.draw)
        lobes = lobe._replace(narrow=torch.where(meant, lobe.narrow, 0.0)),
    return eyes_at(geometry_of(call.scene), points, at, lobes)


def number_of_paths(call: RenderCall, view: View, share: float = 1.0, most: int = MOST) -> int:
    """The number of a view's paths whose vertices sample edges: `share` / SHARE of all samples, within limits; for 0
    none."""
    return max(FEWEST_PATHS, int(share * min(most, view.width * view.height * call.spp // SHARE))) if share else 0


def most_paths(call: RenderCall) -> int:
    """The greatest number of paths whose vertices sample edges for a view."""
    return max(number_of_paths(call, view) for view in call.views)


def on_no_surface(outline: Outline, edge: Tensor) -> Tensor:
    """(N,) bool: parts of edges that do not lie on another body's surface; `edge`: (N,) int32, their indices."""
    return torch.ones_like(edge, dtype=torch.bool) if outline.parts is None else rows(outline.parts.counts, edge) == 1.0


def light_beyond(call: RenderCall, integrand: Integrand, points: Viewpoints, at: Vec3, passed: Passed, past: PastEdges,
                 counted: Straight, free: Tensor) -> Tensor:
    """(3, N) float64 light beyond edges that reaches the view, per unit of the coordinates in which borders move (`cut_at`).

    Args:
        points, at: the viewpoints, and their positions.
        passed: (N,) samples on edges, as the viewpoints `passed.eye` see them.
        past: (N,) the surfaces beyond, from which the light comes.
        counted: the lights that count here where vertices see them directly.
        free: (N,) bool: the edges lie on no surface.
    """
    scene, scatters = integrand.proposal, bool(call.scene.layout.scattering_media)
    own, start = rows((points, at), passed.eye)
    reach = passed.p - start
    beta = scattered_towards(call, integrand, own, reach)
    L = torch.zeros(3, len(passed.edge), dtype=torch.float64, device=scene.device)
    for depth in own.depth.unique().tolist():
        lanes = (own.depth == depth).nonzero().squeeze(1)
        (ray, met, medium, flight), key = rows((past, passed.key), lanes)
        state = path_of(call, ray, key)._replace(medium=medium)
        found = trace(integrand, state, hit=met, depth=depth + 1, flight=flight)
        surfaces = counted.from_surfaces if depth == 0 else counted.by_chance
        mirrors = counted.behind_ideal if depth == 1 else SOFT
        media = counted.in_media if scatters else SOFT
        if (surfaces, mirrors, media) != (SOFT, SOFT, SOFT):
            way = None if flight is None else flight._replace(emission=None)  # what media emit there counts
            straight = trace(integrand._replace(max_depth=depth + 2), state, hit=met, depth=depth + 1, flight=way)
            on_surfaces, behind_ideal, in_media = (torch.where(met.prim >= 0, not some.soft, not some.around)
                                                 for some in (surfaces, mirrors, media))
            if depth > 0:
                chance, mirror, off = rows((own.by_chance, own.behind_ideal, free), lanes)
                on_surfaces = (on_surfaces & chance | behind_ideal & mirror) & off
            found = found - masked(torch.where(rows(own.in_medium, lanes), in_media, on_surfaces), straight)
        L[:, lanes] = torch.stack(tuple(found)).double()
    angle = solid_angle(scene, past.fixed_to(scene), Ray(start, reach))
    return torch.stack(tuple(own.beta * beta)).double() * L * angle
