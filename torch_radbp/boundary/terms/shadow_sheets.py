"""Sheets between light and shadow in media: surfaces that lines from a light without extent through edges sweep.

A point of a sheet is q + k (p - q), with p on an edge and q the light, or p + k d in parallel light of direction d. With a
the position along the edge it covers |dy/da x dy/dk| da dk of the sheet.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.curve.geometry import Geometry, geometry_of
from torch_radbp.boundary.curve.outline import Outline
from torch_radbp.boundary.eye.light_points import light_line
from torch_radbp.boundary.eye.past_edges import hides_all
from torch_radbp.boundary.eye.seen_edges import FAR, Casting, Passed, point_of_edge, salted, unhidden, uniform_numbers
from torch_radbp.boundary.terms.lit_edges import LitEdges
from torch_radbp.call.render_call import RenderCall
from torch_radbp.path.direct_light import LightDraw
from torch_radbp.path.event import Ends
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.tensors.vec import TINY, Ray, Vec3, cross, dot, rows

SALT = 0x4CF5AD43  # tells the random numbers of distances from others


class SheetPoints(NamedTuple):
    """N points on sheets between light and shadow in media; detached."""

    edge: Tensor  # (N,) int32, of the outline
    along: Tensor  # (N,) float64, position along it
    draw: LightDraw
    share: Tensor  # (N,) float64, k

    def at(self, scene: SceneTensors, geometry: Geometry, outline: Outline, step: float = 0.0) -> Vec3:
        """The positions of the points, (N,) world, attached; `step`: a shift along the edges, a share of their lengths."""
        start, d, _ = light_line(scene, point_of_edge(geometry, outline, self.edge, self.along + step), self.draw)
        return start + d * self.share


class SampledSheets(NamedTuple):
    """N points on sheets between light and shadow in media, with the area for which each stands; detached."""

    points: SheetPoints
    p: Vec3  # where they are, world, float64
    area: Vec3  # across the sheet, away from the light: the area for which a point stands
    lit: Vec3  # the point beside the sheet that is in the light, in the scene's dtype
    passed: Passed  # the edges, as lights see them
    number: Tensor  # (N,) int64, of these, which of those that were asked for


def sampled_sheets(call: RenderCall, number: int, casting: Casting, lit: LitEdges, seen_from: Vec3) -> SampledSheets | None:
    """Samples points on sheets between light and shadow, up to the surfaces beyond; None: there are none.

    Distances from the edges are sampled uniformly in the angle seen from `seen_from`.

    Args:
        call: detached.
        number: the number of the view.
        casting: the edges.
        lit: N samples on these as lights see them.
        seen_from: (N,) world points, float64, the viewpoints.

    Reference: Kulla and Fajardo 2012, "Importance Sampling Techniques for Path Tracing in Participating Media", section 3
    (equiangular sampling).
    """
    scene, geometry, passed = call.scene, geometry_of(call.scene), lit.passed
    integrand, place = call.integrand, torch.arange(len(lit.passed.edge), dtype=torch.int32, device=scene.device)
    turn = uniform_numbers(salted(call.views[number], SALT), place, SALT, torch.float64)
    if scene.layout.traces_segments:  # who is behind boundaries of media is found out on the way from there
        shown = integrand.part(Ends.SURROUNDINGS).call(hides_all, casting.outline.triangle(passed.edge)).nonzero().squeeze(1)
        reach = torch.full_like(passed.along[shown], FAR)
    else:
        shown = unhidden(integrand, passed)
        hit = integrand.caster.intersect(rows(passed.onwards, shown))
        reach = torch.where(hit.prim >= 0, hit.t.double(), FAR)
    if not len(shown):
        return None
    passed, seen_from, turn = rows((passed, seen_from, turn), shown)
    draw = rows(lit.draw, passed.eye)
    start, d, parallel = light_line(scene, passed.p, draw)
    length = torch.sqrt(dot(d, d)).clamp_min(TINY)
    beyond, density = evenly_turned(Ray(passed.p, d / length), seen_from, reach, turn)
    points = SheetPoints(passed.edge, passed.along, draw, beyond / length + torch.where(parallel, 0.0, 1.0))
    outline = casting.outline
    p, next_p = (points.at(scene, geometry, outline, step) for step in (0.0, 1.0))
    across = cross(next_p - p, d)
    away = across * -torch.sign(dot(across, passed.outwards))
    area = away * (passed.times / (lit.count * density * length))
    beside = passed.onwards.o.map(torch.Tensor.double) + passed.onwards.d.map(torch.Tensor.double) * beyond
    return SampledSheets(points, p, area, beside.map(lambda c: c.to(scene.dtype)), passed, shown)


def evenly_turned(ray: Ray, seen_from: Vec3, reach: Tensor, turn: Tensor) -> tuple[Tensor, Tensor]:
    """Distances along rays of unit direction up to `reach`, uniform in the angle seen from points `seen_from`, and their
    density over distance, (N,) each; `turn`: uniform random numbers."""
    nearest = dot(seen_from - ray.o, ray.d)
    off = seen_from - ray.o - ray.d * nearest
    height = torch.sqrt(dot(off, off)).clamp_min(TINY)
    first, last = (torch.atan2(distance - nearest, height) for distance in (torch.zeros_like(reach), reach))
    distance = (nearest + height * torch.tan(first + (last - first) * turn)).clamp_min(0.0)
    squared = height * height + (distance - nearest) * (distance - nearest)
    return torch.minimum(distance, reach), height / ((last - first).clamp_min(TINY) * squared)
