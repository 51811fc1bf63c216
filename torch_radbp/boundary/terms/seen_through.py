"""Boundary term of edges that path vertices see through surfaces with null scattering (masks, thin panes).

Holes of a `mask`, a `null` surface and a thin pane let light pass as it came. Next-event estimation does not look through
them, so that the shadows of cut-outs are made of paths x, m, z: scattered at x, straight through m, on to a lamp or another
surface at z. The point m is glued to its surface: there the opacity is what it is, however the surface moves, and lines at
which it jumps, at the borders of holes, have no part in the derivative. But what is seen behind m follows the ray from x
through m, and jumps where this passes an edge at p. As an integral over the surface of m,

    L(x) = integral of f |cos x| |cos m| / r^2  L(m, x) dA

has an integrand that jumps along a curve, where the line from x to p meets the surface of m. It moves over the points that
are glued there, and changes L by

    dL = - integral of f |cos x| |cos m| / r^2  (L_beside - L_on)  v . n dl

with n away from what ends at the edge and v the curve's velocity. L_on is the radiance that m lets pass of this surface,
L_beside that of what lies beyond: both follow the ray. They are computed by two paths with the same random numbers, so that
what m itself scatters cancels out.

Reference: Zhang, Miller, Yan, Gkioulekas and Zhao 2020, "Path-Space Differentiable Rendering", section 5.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.curve.geometry import geometry_of
from torch_radbp.boundary.eye.deposit import Deposit
from torch_radbp.boundary.eye.lines_through_edges import scattered_towards, solid_angle
from torch_radbp.boundary.eye.seen_edges import BEFORE, BESIDE, Passed, places_seen, salted
from torch_radbp.boundary.eye.viewpoints import PathBatch, Viewpoints, eyes_at, path_of, vertex_at, viewpoints
from torch_radbp.boundary.terms import split
from torch_radbp.boundary.terms.call_traits import glues
from torch_radbp.boundary.terms.cuts import CutsOfView, cuts_that_matter, jumps_of_cuts
from torch_radbp.boundary.terms.hidden_light import LOOKS, PLACES, most_paths, number_of_paths
from torch_radbp.boundary.terms.shadow_term import ShadowTerm, TermSize, shadow_term
from torch_radbp.boundary.terms.split import ALL, Amount
from torch_radbp.call.render_call import RenderCall, integrand_of
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.sorting import queued
from torch_radbp.path.trace import trace
from torch_radbp.raycast.protocol import Hit
from torch_radbp.scene.tables.scene_tensors import SceneTensors, extent_of
from torch_radbp.tensors.vec import TINY, Ray, Vec3, dot, rows

SALT = 0x27D4EB2F  # tells the random numbers of these places from others
MOST_SURFACES = 4  # that light passes on the way from an edge


def passes_straight(scene: SceneTensors) -> bool:
    """True if a material of the scene lets light pass in the direction in which it came (null scattering)."""
    return any(look.kind.straight for look in scene.layout.appearances)


@shadow_term
class SeenThrough(ShadowTerm):
    """The boundary term of edges that path vertices see through surfaces which let light pass straight."""

    rank = 4
    is_split = True

    @classmethod
    def size(cls, call: RenderCall) -> TermSize:
        places = passes_straight(call.scene) * most_paths(call) * PLACES
        return TermSize(0, places, places)

    def applies(self) -> bool:
        return glues(self.call) and self.call.integrand.max_depth > 2 and passes_straight(self.call.scene)

    def samples(self, number: int, amount: Amount = ALL) -> CutsOfView | None:
        call, casting = self.still, self.casting
        geometry, view = geometry_of(call.scene), call.views[number]
        paths, tried, begun = (number_of_paths(call, view, share) for share in amount)
        integrand = integrand_of(call, call.integrand, number)
        shorter = integrand._replace(max_depth=integrand.max_depth - 1)
        points = viewpoints(call, number, shorter, PathBatch(paths, begun=begun, tried=tried))
        if not len(points.depth):
            return None
        call = split.with_numbers(call, SALT + begun) if begun else call
        at = vertex_at(call, geometry, number, points)
        eyes = eyes_at(geometry, points, at)
        passed = places_seen(call.stages, geometry, casting, eyes, salted(call.views[number], SALT), LOOKS,
                             PLACES * len(points.depth), points.tried)
        if passed is None:
            return None
        hidden = integrand.caster.occluded(passed.back, passed.distance).nonzero().squeeze(1)
        if not len(hidden):
            return None
        passed, off = rows(passed, hidden), BESIDE * extent_of(geometry)
        start = rows(at, passed.eye)
        beside, on = (through(integrand, start, passed.p + passed.outwards * (way * off)) for way in (1.0, -1.0))
        # On a curved surface light comes from nearer than the edge.
        reached = (beside.reaches & (beside.hit.prim == on.hit.prim)).nonzero().squeeze(1)
        if not len(reached):
            return None
        passed, beside, on = rows((passed, beside, on), reached)
        return cuts_that_matter(call.stages, geometry, casting, points, at, passed, beside.hit,
                                lambda cuts: _difference(call, integrand, points, at, passed, (beside, on)))

    def jumps(self, number: int, found: CutsOfView) -> list[Deposit]:
        return [jumps_of_cuts(self.call, number, self.casting.outline, found)]


class Through(NamedTuple):
    """N rays from path vertices straight through surfaces."""

    ray: Ray
    hit: Hit  # the first surface
    reaches: Tensor  # (N,) bool: light reaches the origin from the target


def through(integrand: Integrand, start: Vec3, target: Vec3) -> Through:
    """Traces rays from points, (N,) float64 world, straight through surfaces to targets behind these."""
    dtype, reach = integrand.proposal.dtype, target - start
    distance = torch.sqrt(dot(reach, reach)).clamp_min(TINY)
    d = reach * (1.0 / distance)
    passed = distance * BEFORE
    ray = Ray(*(part.map(lambda c: c.to(dtype).contiguous()) for part in (start, d)))
    first, way, left = None, torch.ones_like(distance, dtype=torch.bool), torch.zeros_like(distance, dtype=torch.bool)
    for _ in range(MOST_SURFACES + 1):
        origin = (start + d * passed).map(lambda c: c.to(dtype).contiguous())
        hit = integrand.caster.intersect(Ray(origin, ray.d))
        met = passed + hit.t.double()
        arrives = way & ((hit.prim < 0) | (met > distance * (1.0 - BEFORE)))
        first = hit._replace(t=met.to(dtype)) if first is None else first
        left, way = left | arrives, way & ~arrives & lets_pass(integrand, Ray(origin, ray.d), hit)
        if not way.any():
            break
        passed = met + distance * BEFORE
    return Through(ray, first, left & (first.prim >= 0) & (first.t.double() < distance * (1.0 - BEFORE)))


def lets_pass(integrand: Integrand, ray: Ray, hit: Hit) -> Tensor:
    """(N,) bool: rays that hit null-scattering surfaces."""
    found = torch.zeros_like(hit.prim, dtype=torch.bool)
    _, order, queues = queued(integrand, ray, hit, False)
    for queue in queues:
        if queue.event.scatters and integrand.scatterer(queue.event).kind.straight:
            found[order[queue.first:queue.last].long()] = True
    return found


def _difference(call: RenderCall, integrand: Integrand, points: Viewpoints, at: Vec3, passed: Passed,
                ways: Sequence[Through]) -> Tensor:
    """(3, N) float64, the light beside edges less that on them that reaches the view, per unit of the coordinates in which
    borders move (`cut_at`).

    Args:
        points, at: the viewpoints, of which `passed.eye` are used, and their positions.
        passed: (N,) the samples on edges.
        ways: the rays beside the edges, and those onto them.
    """
    own, start = rows((points, at), passed.eye)
    beside, on = ways
    line = Ray(start, passed.p - start)
    beta = scattered_towards(call, integrand, own, line.d)
    L = torch.zeros(3, len(passed.edge), dtype=torch.float64, device=passed.edge.device)
    for depth in own.depth.unique().tolist():
        lanes = (own.depth == depth).nonzero().squeeze(1)
        for sign, way in ((1.0, beside), (-1.0, on)):
            ray, key, hit = rows((way.ray, passed.key, way.hit), lanes)
            L[:, lanes] += sign * torch.stack(tuple(trace(integrand, path_of(call, ray, key), hit=hit, depth=depth + 1)))
    return torch.stack(tuple(own.beta * beta)).double() * L * solid_angle(integrand.proposal, beside.hit, line)
