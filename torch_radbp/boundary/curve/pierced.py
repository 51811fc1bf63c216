"""Self-intersections of bodies: segments along which their triangles meet, found by rays along edges.

A segment along which two triangles meet ends where an edge of one of them pierces the other one. So rays along all edges of
a body find each segment twice, once from either end. Of many edges some are looked at, in each rendering others, which count
for the rest, and each time that a segment is found by half: what that costs does not grow with the mesh, and in the mean of
several renderings nothing is left out. A long curve in a fine mesh is pierced by thousands of edges, of which some are
always found.

A body is a shape, or what one instance shows; how bodies pass through each other is found in `intersections.py`.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.curve.edges import Edges
from torch_radbp.boundary.curve.faces import Faces
from torch_radbp.boundary.curve.geometry import Geometry, in_world
from torch_radbp.boundary.curve.intersections import Pairs, segments_between
from torch_radbp.boundary.curve.segments import Segments
from torch_radbp.call.render_call import RenderCall
from torch_radbp.raycast.protocol import RayCaster
from torch_radbp.tensors.stage import Stages, stage
from torch_radbp.tensors.vec import Ray, rows

SHARE, FEWEST, MOST = 64, 1 << 11, 1 << 14  # edges that are looked at: one for so many paths, at least, at most
ENDS = 1e-4  # share of its length at either end of an edge that is not looked at: there its triangles meet others
MOST_PIERCED = 64  # triangles that are looked for along one edge


class BodyEdges(NamedTuple):
    """The E edges, in the world, of bodies that may intersect themselves."""

    edges: Edges
    instance: Tensor | None  # (E,) int32 instance as in a hit; None: the scene has none


class Probes(NamedTuple):
    """N edges that are tested for self-intersection."""

    edge: Tensor  # (N,) int64, which
    share: float  # probability of an edge's selection


def edges_looked_at(call: RenderCall) -> int:
    """The greatest number of edges that one rendering tests for self-intersection."""
    paths = call.spp * max(view.width * view.height for view in call.views)
    return max(FEWEST, min(MOST, paths // SHARE))


def probes(count: int, most: int, generator: torch.Generator) -> Probes:
    """Selects edges to test, spread evenly; `generator`: selects them if there are more than `most`; on the CPU."""
    if count <= most:
        return Probes(torch.arange(count, device="cpu"), 1.0)
    steps = torch.arange(most, dtype=torch.float64, device="cpu")
    place = steps + torch.rand(most, dtype=torch.float64, generator=generator, device="cpu")
    return Probes((place * (count / most)).long().clamp_max(count - 1), most / count)


@stage("geometry", "bodies")
def ray_along_edge(geometry: Geometry, bodies: BodyEdges, chosen: Tensor) -> Ray:
    """Rays along edges, in the dtype of the scene: from one end, t = 0, to the other, t = 1.

    Args:
        geometry: of the scene, detached.
        bodies: the edges.
        chosen: (N,) int64, indices of edges.
    """
    edges = bodies.edges
    a, b = in_world(geometry, (rows(edges.a, chosen), rows(edges.b, chosen)), rows(bodies.instance, chosen))
    dtype = geometry.triangles.vertices.p.x.dtype
    return Ray(*(part.map(lambda c: c.to(dtype)) for part in (a + (b - a) * ENDS, (b - a) * (1.0 - 2.0 * ENDS))))


def self_intersections(caster: RayCaster, stages: Stages, geometry: Geometry, bodies: BodyEdges, looked_at: Probes,
                       ends: Tensor) -> Segments | None:
    """Finds the segments along which bodies intersect themselves; None: there are none.

    Args:
        caster: of the scene.
        stages: runs the stages.
        geometry: of the scene, detached.
        bodies: the edges of the bodies.
        looked_at: the edges among them that are tested.
        ends: (S,) int64, the end of each shape's triangles among all.
    """
    chosen = looked_at.edge.to(ends.device)
    found = list(pierced(caster, stages(ray_along_edge)(geometry, bodies, chosen)))
    if not found:
        return None
    edge, other, shown_by = (None if column[0] is None else torch.cat(column) for column in zip(*found))
    edges, instance = rows(bodies, chosen[edge])
    ones = [torch.div(corner, 3, rounding_mode="floor") for corner in edges.corner]
    own = shape_of(ends, ones[0]) == shape_of(ends, other)
    if instance is not None:
        own = (instance == shown_by) & (own | (instance > 0))
    for one in ones:  # rays along a triangle meet it by rounding
        own = own & (one != other)
    if not own.any():
        return None
    parts = [rows((one, instance, other, shown_by), (own & (place < edges.count)).nonzero().squeeze(1))
             for place, one in enumerate(ones)]
    one, instance, other, shown_by = (None if column[0] is None else torch.cat(column) for column in zip(*parts))
    each = torch.full((2 * len(one),), 2.0 * looked_at.share, dtype=torch.float64, device=one.device)
    both = Faces(torch.cat([one, other]), None if instance is None else torch.cat([instance, shown_by]), each)
    first = torch.arange(len(one), device=one.device)
    segments = segments_between(geometry, both, Pairs(first, first + len(one)))
    if looked_at.share == 1.0:
        segments = once_each(segments)
    return segments if len(segments.triangle) else None


def once_each(segments: Segments) -> Segments:
    """Removes duplicate segments, which are found from both ends or from two edges."""
    low, high = torch.minimum(segments.triangle, segments.through), torch.maximum(segments.triangle, segments.through)
    pairs = torch.stack([low, high, *(() if segments.instance is None else [segments.instance])])
    found, which = torch.unique(pairs, dim=1, return_inverse=True)
    place = torch.arange(len(which), device=which.device)
    first = torch.full_like(found[0], len(which), dtype=torch.int64).scatter_reduce(0, which, place, "amin")
    return rows(segments, first)._replace(share=None)


def shape_of(ends: Tensor, triangle: Tensor) -> Tensor:
    """The shape of each triangle, (N,) int32; `ends`: the end of each shape's triangles."""
    return torch.bucketize(triangle, ends.to(triangle.dtype), right=True)


def pierced(caster: RayCaster, ray: Ray) -> Iterator[tuple[Tensor, Tensor, Tensor | None]]:
    """Yields the triangles that rays, (N,), cross up to t = 1: ray indices, int64, triangles, int32, and instances."""
    lane = caster.occluded(ray, torch.ones_like(ray.o.x)).nonzero().squeeze(1)
    passed, last = torch.zeros_like(ray.o.x[lane]), torch.full_like(lane, -1)
    for _ in range(MOST_PIERCED):
        if not len(lane):
            return
        own = rows(ray, lane)
        hit = caster.intersect(Ray((own.o + own.d * passed).map(Tensor.contiguous), own.d))
        t = passed + hit.t
        meets = (hit.prim >= 0) & (t < 1.0)
        fresh = (meets & (hit.prim != last)).nonzero().squeeze(1)
        if len(fresh):
            yield lane[fresh], hit.prim[fresh], None if hit.instance is None else hit.instance[fresh]
        kept = meets.nonzero().squeeze(1)
        lane, passed, last = lane[kept], t[kept] + ENDS, hit.prim[kept]
