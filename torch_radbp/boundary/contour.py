"""Curves inside of triangles at which an image jumps, and places on them as a camera sees them.

Where interpolated shading normals n turn away from the viewer at e before the triangle does, a surface goes black: the image
jumps along the *rim* n . (e - p) = 0. The near and the far plane of a camera cut surfaces, along other curves.

All of them are where a *level* is zero, which is a polynomial of second degree on each triangle,

    f = sum of b_i b_j F_ij        (b barycentric coordinates, F symmetric)

and lies between the least and the greatest of the six numbers F, so that most triangles are left out at once. A line from
a corner A to the point Q that divides the opposite side by s meets the curve where

    (1 - t)^2 F_AA + 2 t (1 - t) F_AQ + t^2 F_QQ = 0

so that s picks a place, or two, in steps that would be equal along the curve if it were straight; the corner is one whose
sign differs from the other two, if there is any, and there is exactly one. Along the curve db = t ds / |f_t| (-f_v, f_u), u
and v the coordinates of the other corners, and on the film it
is seen at x(b), with the Jacobian J. With m = det(J) J^-T (f_u, f_v), a normal of the curve on the film, a change of f by df
at a fixed place, which itself is seen to move by dx, moves the curve by

    (m . dx - det(J) df) / |m|

along m, and |m| t / |f_t| is its length on the film for each s.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.faces import Faces, positions, vertex_normals
from torch_radbp.boundary.places import (
    FAR,
    NEAR,
    RIM,
    Between,
    Glued,
    Places,
    depth_of,
    number_of_places,
    numbers_of,
    on_film,
    picked,
    unknown,
    window,
)
from torch_radbp.record import joined
from torch_radbp.rendering.call.render_call import RenderCall
from torch_radbp.rendering.call.view import View
from torch_radbp.scene.tensors import SceneTensors
from torch_radbp.vec import TINY, Vec2, Vec3, dot, interpolated, rows

STEP = 1e-5  # of the smaller of a triangle and its distance, by which its Jacobian is found
PROBES = ((0.1, 0.15, 0.5), (0.3, 0.5, 0.15), (0.5, 0.5, 0.5), (0.7, 0.5, 0.85), (0.9, 0.85, 0.5))  # s, and the aperture
ASIDE = 1e-9  # share of its distance by which a rim is moved off the edges of triangles
ASTRIDE = 1e-4  # cosine between shading normal and line of sight at which a surface is looked at on either side of a rim
FARTHEST_ASTRIDE = 0.05  # the same as barycentric coordinates, at most
LEAST = 0.1  # of the mean length of curves in a triangle, that triangles count where no probe meets a curve
LEAST_OF_LENS = 1.0  # the same where each point of a lens sees other curves, of which the probes meet few
MOST_TRIES = 16  # places that are looked for on a lens for one that is found
SIDES = ((0, 1), (0, 2), (1, 2))  # of triangles, by their corners

Level = Callable[[View, Vec3, Vec3 | None, Vec2 | None], Tensor]


class Net(NamedTuple):
    """The six numbers F_ij of a level on triangles, (N,) each."""

    corner: tuple[Tensor, Tensor, Tensor]  # F_00, F_11, F_22
    side: tuple[Tensor, Tensor, Tensor]  # F_01, F_02, F_12

    def crosses(self, margin: Tensor | float) -> Tensor:
        """True if the level may be 0 somewhere in the triangle, or be so where it differs by a margin; (N,) bool."""
        numbers = torch.stack((*self.corner, *self.side))
        return (numbers.amin(0) < margin) & (numbers.amax(0) > -margin)

    def gradient(self, u: Tensor, v: Tensor) -> tuple[Tensor, Tensor]:
        """What the level changes by with the barycentric coordinates of the second and of the third corner."""
        (f0, f1, f2), (f01, f02, f12), w = self.corner, self.side, 1.0 - u - v
        at_0, at_1, at_2 = w * f0 + u * f01 + v * f02, w * f01 + u * f1 + v * f12, w * f02 + u * f12 + v * f2
        return 2.0 * (at_1 - at_0), 2.0 * (at_2 - at_0)


class OnTriangle(NamedTuple):
    """Places of curves on triangles, (N,) each."""

    u: Tensor  # barycentric coordinates: of the second corner
    v: Tensor  # of the third
    pace: Tensor  # t / |f_t|, for each step of what s is picked by; 0 where a line does not meet the curve


class OnFilm(NamedTuple):
    """Places on curves of triangles as a camera sees them, (N,) each."""

    p: Vec3  # world
    film: Vec2  # pixels
    normal: Vec2  # m, times the pace
    drift: Tensor  # -det(J), times the pace
    uphill: Vec2  # u and v by which the level rises by one, at the fastest


def facing(view: View, p: Vec3, n: Vec3, aperture: Vec2 | None) -> Tensor:
    """The level that is 0 on rims: positive where the viewer is on the side of the shading normal.

    A rim along an edge is moved into one of its two triangles, by next to nothing.
    """
    towards = view.camera.kind.towards(view.camera.lens, p, aperture)
    return dot(n, towards) + ASIDE * torch.sqrt(dot(towards, towards)).detach()


def beyond_near(view: View, p: Vec3, n: None, aperture: Vec2 | None) -> Tensor:
    """The level that is 0 on the near plane."""
    return view.camera.kind.beyond_planes(view.camera.lens, p)[0]


def beyond_far(view: View, p: Vec3, n: None, aperture: Vec2 | None) -> Tensor:
    """The level that is 0 on the far plane."""
    return view.camera.kind.beyond_planes(view.camera.lens, p)[1]


LEVELS: dict[int, Level] = {RIM: facing, NEAR: beyond_near, FAR: beyond_far}


def places_on_contours(call: RenderCall, number: int, faces: Faces, rims: bool) -> list[Places]:
    """Places on all curves inside of triangles in a view; `rims`: those at which shading normals turn away, too."""
    view, triangles = call.views[number], call.scene.triangles
    found = []
    if rims and triangles.vertices.n is not None:
        smooth = faces if triangles.smooth is None else rows(
            faces, triangles.smooth[faces.triangle].nonzero().squeeze(1))
        found.append(places_of_level(call, view, smooth, RIM))
    found.append(places_of_level(call, view, faces, NEAR))
    if view.clips:
        found.append(places_of_level(call, view, faces, FAR))
    return [places for places in found if places is not None]


def places_of_level(call: RenderCall, view: View, faces: Faces, kind: int) -> Places | None:
    """Places on the curves of one kind, in proportion to lengths on the film; None: there are none."""
    scene, aperture = call.scene, view.camera.kind.has_aperture
    faces = rows(faces, crossing(scene, view, faces, kind).nonzero().squeeze(1))
    if not len(faces.triangle):
        return None
    between, apex = from_apex(scene, view, faces, kind)
    instance = faces.instance
    probed = [probe(scene, view, between, instance, kind, s, Vec2(x, y) if aperture else None) for s, x, y in PROBES]
    inside, whole = (sum(lengths) / len(PROBES) for lengths in zip(*probed))
    length = torch.where(inside > 0.0, inside, whole)
    length = length + (LEAST_OF_LENS if aperture else LEAST) * length.mean() + float(not length.any())
    count = number_of_places(float(length.sum()), call, view)
    if aperture:
        share = float(sum((whole > 0.0).double().mean() for _, whole in probed)) / len(PROBES)
        count = round(count / max(share, 1.0 / MOST_TRIES))
    numbers = numbers_of(view, count, kind)
    face, s, times = picked(length, numbers.along)
    chosen, shows = rows(between, face), None if instance is None else instance[face]
    found, corners = [], positions(scene, chosen, shows)
    for place in met(net(scene, view, chosen, shows, kind, numbers.aperture), s):
        seen = on_view(scene, view, chosen, shows, kind, place, numbers.aperture)
        scale = times / faces.share[face]
        side = torch.sign(seen.drift) * (-1.0 if kind == RIM else 1.0)
        behind = ahead = unknown(place.u)
        if kind == RIM:
            reach = astride(view, seen, numbers.aperture)
            behind, ahead = (glued(faces.triangle[face], apex[face], place.u + reach.x * side * way,
                                   place.v + reach.y * side * way) for way in (-1.0, 1.0))
        found.append(Places(torch.full_like(face, kind), chosen, shows, place.u, place.v, seen.p, seen.film,
                            seen.normal * scale, side, seen.drift * scale,
                            depth_of(view, seen.p, corners, numbers.aperture), behind, ahead, numbers.key, numbers.aperture))
    both = joined(found)
    return rows(both, in_window(view, both.film, both.normal).nonzero().squeeze(1))


def crossing(scene: SceneTensors, view: View, faces: Faces, kind: int) -> Tensor:
    """True for triangles in which there may be a curve of a kind, in view from somewhere on the lens; (F,) bool."""
    camera, between = view.camera, faces.between(scene)
    radius = camera.kind.aperture_radius(camera.lens) if kind == RIM else None
    found = net(scene, view, between, faces.instance, kind, middle(view, faces.share)).crosses(
        0.0 if radius is None else float(radius))
    some = found.nonzero().squeeze(1)
    corners = positions(scene, rows(between, some), None if faces.instance is None else faces.instance[some])
    outside = torch.stack([camera.kind.frustum(camera.lens, *window(view), corner) < 0 for corner in corners]).all(0)
    return found.index_put((some,), ~outside.any(0))


def from_apex(scene: SceneTensors, view: View, faces: Faces, kind: int) -> tuple[Between, Tensor]:
    """The vertices of triangles, first one at which the sign of the level differs from that at the other two, if any; and
    (F,) int64 which one it is."""
    between = faces.between(scene)
    level = net(scene, view, between, faces.instance, kind, middle(view, faces.share))
    sign = torch.sign(torch.stack(level.corner, 1))
    apex = ((sign != sign.roll(1, 1)) & (sign != sign.roll(2, 1))).int().argmax(1, keepdim=True)
    vertices = torch.stack(between, 1)
    return Between(*(vertices.gather(1, (apex + step) % 3).squeeze(1) for step in range(3))), apex.squeeze(1)


def middle(view: View, like: Tensor) -> Vec2 | None:
    """The middle of the lens, for as many lanes as `like` has; None: rays meet in a point."""
    return Vec2(*(torch.full_like(like, 0.5, dtype=torch.float64),) * 2) if view.camera.kind.has_aperture else None


def net(scene: SceneTensors, view: View, between: Between, instance: Tensor | None, kind: int, aperture: Vec2 | None) -> Net:
    """The numbers F_ij of a level: its values at the corners, and what those in the middle of the sides follow from."""
    p = positions(scene, between, instance)
    n = vertex_normals(scene, between, instance) if kind == RIM else (None,) * 3
    level = LEVELS[kind]
    corner = tuple(level(view, p[i], n[i], aperture) for i in range(3))
    halfway = (level(view, (p[i] + p[j]) * 0.5, None if n[i] is None else (n[i] + n[j]) * 0.5, aperture) for i, j in SIDES)
    return Net(corner, tuple(2.0 * value - 0.5 * (corner[i] + corner[j]) for value, (i, j) in zip(halfway, SIDES)))


def met(level: Net, along: Tensor) -> list[OnTriangle]:
    """The two places, at most, where the lines from first corners to points of the opposite sides meet a curve.

    Args:
        level: of triangles.
        along: (N,) in [0, 1], which lines: in equal steps along the curve, if the level is linear.
    """
    (f0, f1, f2), (f01, f02, f12) = level
    # A straight curve divides the sides at the first corner by these shares.
    one, two = (torch.where(f0 * f < 0.0, f0 / (f0 - f), 1.0).clamp_min(TINY) for f in (f1, f2))
    total = (1.0 - along) * one + along * two
    s, stretch = along * two / total, one * two / total**2
    at_q, between = (1.0 - s) ** 2 * f1 + 2.0 * s * (1.0 - s) * f12 + s**2 * f2, (1.0 - s) * f01 + s * f02
    slope, bend = between - f0, f0 - 2.0 * between + at_q
    root = slope + torch.copysign(torch.sqrt(slope**2 - bend * f0), slope)  # NaN where there is no place
    found = []
    for t in (-root / bend, -f0 / root):
        pace = stretch * t / (2.0 * (slope + bend * t)).abs()
        pace = torch.where((t > 0.0) & (t < 1.0) & torch.isfinite(pace), pace, 0.0)
        t = torch.where(pace > 0.0, t, 0.5)
        found.append(OnTriangle(t * (1.0 - s), t * s, pace))
    return found


def on_view(scene: SceneTensors, view: View, between: Between, instance: Tensor | None, kind: int, place: OnTriangle,
            aperture: Vec2 | None) -> OnFilm:
    """Where a camera sees places of a curve, and how it runs there."""
    corners = positions(scene, between, instance)
    p = interpolated(corners, place.u, place.v)
    to_eye = view.camera.kind.towards(view.camera.lens, p, aperture)
    columns = []
    for corner in corners[1:]:
        edge = corner - corners[0]
        step = STEP * torch.sqrt((dot(to_eye, to_eye) / dot(edge, edge)).clamp_max(1.0))
        before, after = (on_film(view, p + edge * way, aperture) for way in (-step, step))
        columns.append(Vec2((after.x - before.x) / (2.0 * step), (after.y - before.y) / (2.0 * step)))
    of_u, of_v = columns
    f_u, f_v = net(scene, view, between, instance, kind, aperture).gradient(place.u, place.v)
    m = Vec2(of_v.y * f_u - of_u.y * f_v, of_u.x * f_v - of_v.x * f_u)
    volume = of_u.x * of_v.y - of_v.x * of_u.y
    steep = f_u**2 + f_v**2
    return OnFilm(p, on_film(view, p, aperture), m * place.pace, -volume * place.pace, Vec2(f_u / steep, f_v / steep))


def astride(view: View, seen: OnFilm, aperture: Vec2 | None) -> Vec2:
    """How far apart from a rim, u and v, the shading normal is surely turned to the viewer; on the other side away."""
    towards = view.camera.kind.towards(view.camera.lens, seen.p, aperture)
    reach = seen.uphill * (ASTRIDE * torch.sqrt(dot(towards, towards)))
    return reach * (FARTHEST_ASTRIDE / torch.hypot(reach.x, reach.y)).clamp_max(1.0)


def glued(triangle: Tensor, apex: Tensor, u: Tensor, v: Tensor) -> Glued:
    """Points of triangles whose barycentric coordinates u and v are those of the second and third vertex from the apex."""
    weights = torch.stack([1.0 - u - v, u, v], 1)
    u, v = (weights.gather(1, (vertex - apex[:, None]) % 3).squeeze(1) for vertex in (1, 2))
    return Glued(triangle.int(), u, v)


def probe(scene: SceneTensors, view: View, between: Between, instance: Tensor | None, kind: int, s: float,
          aperture: Vec2 | None) -> tuple[Tensor, Tensor]:
    """The lengths on the film of curves in triangles, by the places on one line through each: in view and on the whole.

    (F,) pixels each.
    """
    share = torch.full(between.first.shape, s, dtype=torch.float64, device=between.first.device)
    aperture = None if aperture is None else aperture.map(lambda part: torch.full_like(share, part))
    inside, whole = torch.zeros_like(share), torch.zeros_like(share)
    for place in met(net(scene, view, between, instance, kind, aperture), share):
        seen = on_view(scene, view, between, instance, kind, place, aperture)
        own = torch.hypot(seen.normal.x, seen.normal.y).nan_to_num(0.0).clamp_max(view.width + view.height)
        inside += torch.where(in_window(view, seen.film, seen.normal), own, 0.0)
        whole += own
    return inside, whole


def in_window(view: View, film: Vec2, normal: Vec2) -> Tensor:
    """True for places in view that stand for a piece of a curve; (N,) bool."""
    reach = view.camera.film.kernel.radius
    inside = [(place >= -reach) & (place <= pixels + reach) for place, pixels in zip(film, (view.width, view.height))]
    length = torch.hypot(normal.x, normal.y)
    return inside[0] & inside[1] & torch.isfinite(length) & (length > 0.0)


def level_at(scene: SceneTensors, view: View, places: Places, kind: int) -> Tensor:
    """The level at places of its curve, fixed to their triangles; (N,) attached, of value 0 but for rounding."""
    n = None
    if kind == RIM:
        n = interpolated(vertex_normals(scene, places.between, places.instance), places.u, places.v)
    return LEVELS[kind](view, places.at(scene), n, places.aperture)
