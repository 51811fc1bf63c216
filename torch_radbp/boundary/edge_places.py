"""Places on edges, as a camera sees them."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.edges import Edges
from torch_radbp.boundary.faces import positions
from torch_radbp.boundary.outline import Outline
from torch_radbp.boundary.places import (
    CREASE,
    SILHOUETTE,
    Between,
    Glued,
    Places,
    camera_sample,
    depth_of,
    number_of_places,
    numbers_of,
    on_film,
    picked,
    window,
)
from torch_radbp.boundary.silhouette import is_silhouette, is_silhouette_from
from torch_radbp.rendering.call.render_call import RenderCall
from torch_radbp.rendering.call.view import View
from torch_radbp.vec import Vec2, Vec3, dot

STEP = 1e-5  # of the length of an edge in view, by which its direction on the film is found
INWARDS = 1e-3  # barycentric weight of the vertex opposite an edge where a triangle is looked at


class EdgesInView(NamedTuple):
    """The edges in a view, and how often each is picked."""

    enters: Tensor  # (E,) shares of the way from a to b between which it is in view
    leaves: Tensor
    weight: Tensor  # (E,) not normalised; 0: not at all
    silhouette: Tensor  # (E,) bool: it is one, from somewhere on the lens
    length: float  # of all edges in view on the film, those that may jump less counted as less, pixels


def places_on_edges(call: RenderCall, number: int, outline: Outline) -> Places:
    """Places on an outline as a camera sees it, in proportion to lengths on the film."""
    view, edges = call.views[number], outline.edges
    vertices = outline.vertices(call.scene).stack().double()
    choice = edges_in_view(view, outline, vertices)
    numbers = numbers_of(view, number_of_places(choice.length, call, view), SILHOUETTE)
    edge, share, times = picked(choice.weight, numbers.along)
    reach, aperture = choice.leaves[edge] - choice.enters[edge], numbers.aperture
    along = choice.enters[edge] + reach * share
    a, b = (Vec3.of(vertices[index[edge]]) for index in (edges.a, edges.b))
    before, at, after = (on_film(view, a + (b - a) * (along + step * reach), aperture) for step in (-STEP, 0.0, STEP))
    # The density over `along` is 1 / (times reach); the length of the edge on the film per `along` is in `normal`.
    scale = times / (2.0 * STEP * outline.share[edge])
    p = a + (b - a) * along
    silhouette = choice.silhouette[edge]
    if aperture is not None:
        eyes = camera_sample(call, view, at, aperture, numbers.key).ray.o.stack().double()
        silhouette = is_silhouette_from(edges, vertices, edge, eyes)
        scale = scale * (silhouette | (outline.crease[edge] > 0))
    first, second = (edges.vertex[index[edge]] for index in (edges.a, edges.b))
    nothing, normal = torch.zeros_like(along), Vec2(-(after.y - before.y) * scale, (after.x - before.x) * scale)
    instance = None if outline.instance is None else outline.instance[edges.a[edge]]
    sheets = [sheet_at(call, number, edges, vertices, edge, corner, instance, p, at, normal, aperture)
              for corner in corners_at(edges, edge)]
    side = torch.where(sum(sheet.ahead for sheet in sheets) >= 0.0, 1.0, -1.0)
    behind, ahead = in_order(sheets, silhouette, torch.bincount(edges.edge, minlength=len(edges.a))[edge] <= 2)
    depth = torch.maximum(depth_of(view, p, [a, b], aperture), torch.maximum(*(sheet.depth for sheet in sheets)))
    return Places(torch.where(silhouette, SILHOUETTE, CREASE), Between(first, second, second), instance, along, nothing, p,
                  at, normal, side, nothing, depth, behind, ahead, numbers.key, aperture)


class Sheet(NamedTuple):
    """A triangle at each of some edges, (N,)."""

    point: Glued  # the place, next to the edge
    ahead: Tensor  # how far it goes ahead of the edge on the film, of any scale
    nearness: Tensor  # how fast it comes nearer to the viewer with the distance from the edge on the film, likewise
    depth: Tensor  # how far it reaches from the place along the line of sight


def corners_at(edges: Edges, edge: Tensor) -> tuple[Tensor, Tensor]:
    """The corners opposite some edges, (N,) int64 which, of two of the triangles there, or twice of the one; (N,) int64."""
    order = edges.edge.argsort(stable=True)
    count = torch.bincount(edges.edge, minlength=len(edges.a))
    last = count.cumsum(0)[edge] - 1
    return order[last], order[last - count[edge] + 1]


def sheet_at(call: RenderCall, number: int, edges: Edges, vertices: Tensor, edge: Tensor, corner: Tensor,
             instance: Tensor | None, p: Vec3, film: Vec2, normal: Vec2, aperture: Vec2 | None) -> Sheet:
    """A triangle at each of some places on edges.

    Args:
        number: of the view.
        edges: between `vertices`, (U, 3) float64.
        edge: (N,) int64, which.
        corner: (N,) int64, the triangle's corner opposite it, of those of `edges`.
        instance, p, film, normal, aperture: of the places.
    """
    view = call.views[number]
    opposite = Vec3.of(vertices[edges.opposite[corner]])
    along, inwards = (Vec3.of(vertices[edges.b[edge]] - vertices[edges.a[edge]]), opposite - p)
    across = inwards - along * (dot(inwards, along) / dot(along, along))
    seen = on_film(view, p + across * STEP, aperture)
    ahead = (seen.x - film.x) * normal.x + (seen.y - film.y) * normal.y
    towards = view.camera.kind.towards(view.camera.lens, p, aperture)
    triangle, place = torch.div(edges.corner[corner], 3, rounding_mode="floor"), edges.corner[corner] % 3
    points = torch.stack([point.stack() for point in positions(
        call.scene, Between(*(row[triangle].long() for row in call.scene.triangles.corners)), instance)], 1)
    lanes = torch.arange(len(place), device=place.device)
    tip, start, end = (Vec3.of(points[lanes, (place + step) % 3]) for step in range(3))
    side = end - start
    of_tip, share = (dot(point - start, side) / dot(side, side) for point in (tip, p))
    # Normals at the edge itself may lie exactly across the line of sight.
    share = (share - INWARDS * of_tip).clamp(0.0, 1.0 - INWARDS)
    weights = torch.stack([torch.full_like(share, INWARDS), 1.0 - INWARDS - share, share], 1)
    u, v = (weights.gather(1, ((vertex - place) % 3)[:, None]).squeeze(1) for vertex in (1, 2))
    return Sheet(Glued(triangle.int(), u, v), ahead, dot(across, towards) / ahead.abs(),
                 depth_of(view, p, [opposite], aperture))


def in_order(sheets: list[Sheet], silhouette: Tensor, known: Tensor) -> tuple[Glued, Glued]:
    """What is seen of two triangles at edges behind and ahead of these: at silhouettes, (N,) bool, the one that hides the
    other on both sides; unknown where not `known`, (N,) bool."""
    one, two = sheets
    nearer, first = one.nearness >= two.nearness, one.ahead <= two.ahead
    found = []
    for of_crease in (first, ~first):
        pick = torch.where(silhouette, nearer, of_crease)
        point = Glued(*(torch.where(pick, here, there) for here, there in zip(one.point, two.point)))
        found.append(point._replace(prim=torch.where(known, point.prim, -1)))
    return tuple(found)


def edges_in_view(view: View, outline: Outline, vertices: Tensor) -> EdgesInView:
    """Which edges are in view, and how long they are there; `vertices` (U, 3) of the outline, float64."""
    camera, edges = view.camera, outline.edges
    silhouette = is_silhouette(edges, vertices, camera.kind.eye(camera.lens), camera.kind.aperture_radius(camera.lens))
    jump = torch.where(silhouette, 1.0, outline.crease.double())
    some, enters, leaves = clipped(view, edges, vertices, (jump > 0).nonzero().squeeze(1))
    a, b = (Vec3.of(vertices[index[some]]) for index in (edges.a, edges.b))
    middle = Vec2(*(torch.full_like(enters, 0.5),) * 2) if camera.kind.has_aperture else None
    ends = [on_film(view, a + (b - a) * along, middle) for along in (enters, leaves)]
    length = torch.hypot(ends[1].x - ends[0].x, ends[1].y - ends[0].y)
    weight = length * jump[some]
    every = torch.zeros(3, len(jump), dtype=torch.float64, device=vertices.device)
    enters, leaves, weights = every.index_copy(1, some, torch.stack([enters, leaves, weight]))
    return EdgesInView(enters, leaves, weights, silhouette, float(weight.sum()))


def clipped(view: View, edges: Edges, vertices: Tensor, some: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Those of some edges that are in view, (S,), and the shares of the way from a to b between which they are.

    Only edges that cross the border of the view are clipped.

    Args:
        view: where also counts what the filter reaches beyond the window.
        edges: between `vertices`, (U, 3) float64.
        some: (E',) int64, of the edges.
    """
    camera, (x, y) = view.camera, window(view)
    beyond = camera.kind.frustum(camera.lens, x, y, Vec3.of(vertices)) < 0
    bits = 1 << torch.arange(len(beyond), device=vertices.device)
    outside = (beyond * bits[:, None]).sum(0)  # a bit for each plane of the frustum, as Cohen and Sutherland have it
    at_a, at_b = (outside[index[some]] for index in (edges.a, edges.b))
    seen = (at_a & at_b) == 0
    some, crossing = some[seen], (at_a | at_b)[seen].nonzero().squeeze(1)
    enters = torch.zeros(len(some), dtype=torch.float64, device=vertices.device)
    a, b = (Vec3.of(vertices[index[some[crossing]]]) for index in (edges.a, edges.b))
    first, last = camera.kind.clipped(camera.lens, x, y, a, b)
    leaves = torch.ones_like(enters).index_copy(0, crossing, last)
    enters = enters.index_copy(0, crossing, first)
    seen = enters < leaves
    return some[seen], enters[seen], leaves[seen]
