"""Samples on shadow borders, distributed as path vertices see them.

What a vertex x of a path receives from a piece of a border falls with the square of its distance. Were places spread along
an edge as its light has it, those whose border comes close to x would be rare and large: their variance is infinite. So one
of three stays where it is, and two are moved along the edge, to where the border is seen from x after an even share of the
turn from one of its ends to the other, as if it lay on the plane on which the shadow of the edge falls at its one end, or at
its other. With densities p_0, p_1 and p_2 of these over the edge, each counts 3 / (p_0 + p_1 + p_2).

The light of an edge meets a plane in a line. With s the share of the way along the edge, and a and b the heights of its ends
over the light across the plane, that is met at the share b s / (a (1 - s) + b s) of the line.

Reference: Veach and Guibas 1995, "Optimally Combining Sampling Techniques for Monte Carlo Rendering", section 3 (the
balance heuristic).
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.curve.geometry import Corners, Geometry, geometry_of
from torch_radbp.boundary.curve.outline import Outline
from torch_radbp.boundary.eye.light_points import light_line
from torch_radbp.boundary.eye.seen_edges import (
    Passed,
    corners_of,
    density_seen,
    evenly_seen,
    passed_at,
    point_of_edge,
)
from torch_radbp.boundary.terms.lit_edges import LitEdges
from torch_radbp.call.render_call import RenderCall
from torch_radbp.path.direct_light import LightDraw
from torch_radbp.scene.tables.scene_tensors import SceneTensors, extent_of
from torch_radbp.tensors.vec import Frame, Ray, Vec3, cross, dot, normalize, rows

ENDS = 0.02, 0.98  # shares of the way along an edge at which it is asked where its shadow falls


class LightOfEdges(NamedTuple):
    """The rays of light that pass both ends of N edges; float64."""

    a: Ray  # starts at the light, unless that is parallel
    b: Ray
    parallel: Tensor  # (N,) bool

    def density(self, along: Tensor) -> Tensor:
        """The density of positions along edges that are sampled as the light sees them, p_0."""
        return torch.where(self.parallel, 1.0, density_seen(self.a.d, self.b.d, along))


class EdgeShadow(NamedTuple):
    """The shadows of N edges on planes, relative to a point from which they are seen."""

    a: Vec3  # vector from the point to the shadow of the edge's a
    b: Vec3
    height_a: Tensor  # height of the edge's a over the light's origin, across the plane
    height_b: Tensor
    exists: Tensor  # (N,) bool

    def along(self, turn: Tensor) -> Tensor:
        """The positions on edges whose shadows lie at a fraction `turn` of the angle seen from the point."""
        met, _ = evenly_seen(self.a, self.b, turn)
        one, other = met * self.height_a, (1.0 - met) * self.height_b
        return torch.where(self.exists, one / torch.where(self.exists, one + other, 1.0), turn)

    def density(self, along: Tensor) -> Tensor:
        """The density along edges of the positions that `along` returns for uniform fractions."""
        one, other = along * self.height_b, (1.0 - along) * self.height_a
        total = torch.where(self.exists, one + other, 1.0)
        return density_seen(self.a, self.b, one / total) * (self.height_a * self.height_b / (total * total))


def spread_borders(call: RenderCall, outline: Outline, lit: LitEdges, start: Vec3, choice: Tensor, turn: Tensor) -> Passed:
    """Moves samples along their edges, so that their shadow borders lie closer to path vertices; (N,), detached.

    Args:
        call: detached.
        outline: the edges.
        lit: the samples on edges as lights see them.
        start: (N,) world, the path vertices to which they are connected.
        choice, turn: (N,) uniform numbers.
    """
    planes = planes_met(call, geometry_of(call.scene), outline, lit)
    return spread_on_planes(call, outline, lit, planes, start, (choice, turn))


def spread_sheets(call: RenderCall, outline: Outline, lit: LitEdges, start: Vec3, choice: Tensor, turn: Tensor) -> Passed:
    """Moves samples along their edges, so that sheets of shadow pass closer to path vertices, by the shadows on planes
    through these, across the light. Args as for `spread_borders`."""
    frame = Frame.of(normalize(lit.passed.onwards.d.map(torch.Tensor.double)))
    plane = (start, start + frame.s, start + frame.t), torch.ones_like(lit.passed.edge, dtype=torch.bool)
    return spread_on_planes(call, outline, lit, [plane], start, (choice, turn))


def spread_on_planes(call: RenderCall, outline: Outline, lit: LitEdges, planes: list[tuple[Corners, Tensor]], start: Vec3,
                     numbers: tuple[Tensor, Tensor]) -> Passed:
    """Moves samples along their edges by the shadows of these on planes, as from `planes_met`; `numbers`: `choice` and
    `turn`. Other args as for `spread_borders`."""
    geometry, passed, (choice, turn) = geometry_of(call.scene), lit.passed, numbers
    draw = rows(lit.draw, passed.eye)
    light = light_of_edges(call.scene, geometry, outline, passed, draw)
    spans = [span_on(corners, exists, light, start) for corners, exists in planes]
    along, place = passed.along, torch.floor(choice * (1 + len(spans)))
    for number, span in enumerate(spans):
        along = torch.where((place == number + 1.0) & span.exists, span.along(turn), along)
    before, here = light.density(passed.along), light.density(along)
    density = here + sum(torch.where(span.exists, span.density(along), here) for span in spans)
    times = passed.times * before * ((1 + len(spans)) / density)
    p = point_of_edge(geometry, outline, passed.edge, along)
    return passed_at(rows(lit.eyes, passed.eye), passed._replace(along=along, times=times, p=p), extent_of(geometry),
                     call.scene.dtype)


def light_of_edges(scene: SceneTensors, geometry: Geometry, outline: Outline, passed: Passed,
                   draw: LightDraw) -> LightOfEdges:
    """The light of samples, (N,), that passes both ends of their edges."""
    ends = [point_of_edge(geometry, outline, passed.edge, torch.full_like(passed.along, end)) for end in (0.0, 1.0)]
    (start_a, to_a, parallel), (start_b, to_b, _) = (light_line(scene, end, draw) for end in ends)
    return LightOfEdges(Ray(start_a, to_a), Ray(start_b, to_b), parallel)


def planes_met(call: RenderCall, geometry: Geometry, outline: Outline, lit: LitEdges) -> list[tuple[Corners, Tensor]]:
    """The triangles on which the shadows of both ends of edges fall, and whether there are any, (N,) bool."""
    own, found = rows(lit.eyes, lit.passed.eye), []
    for end in ENDS:
        p = point_of_edge(geometry, outline, lit.passed.edge, torch.full_like(lit.passed.along, end))
        hit = call.integrand.caster.intersect(passed_at(own, lit.passed._replace(p=p), extent_of(geometry),
                                                        call.scene.dtype).onwards)
        found.append((corners_of(geometry, hit), hit.prim >= 0))
    return found


def span_on(corners: Corners, exists: Tensor, light: LightOfEdges, start: Vec3) -> EdgeShadow:
    """The shadows of edges on the planes of triangles; they exist if both ends lie on one side of the light's origin."""
    n = cross(corners[1] - corners[0], corners[2] - corners[0])
    heights = [dot(n, ray.d) for ray in (light.a, light.b)]
    exists = exists & (heights[0] * heights[1] > 0.0)
    met = [ray.o + ray.d * (dot(n, corners[0] - ray.o) / torch.where(exists, height, 1.0))
           for ray, height in zip((light.a, light.b), heights)]
    return EdgeShadow(met[0] - start, met[1] - start, *heights, exists)
