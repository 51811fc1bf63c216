"""Discontinuity curves inside of triangles (rims of shading normals, clipping planes), and samples on them.

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

from torch_radbp.boundary.curve.faces import Faces
from torch_radbp.boundary.curve.film_term import CurvesInView, ExaminedView, FilmTerm, film_term, lanes
from torch_radbp.boundary.curve.geometry import Between, Geometry, positions, vertex_normals
from torch_radbp.boundary.curve.outline import Jumps
from torch_radbp.boundary.curve.places import (
    FAR,
    NEAR,
    RIM,
    Glued,
    Lot,
    Places,
    Sight,
    depth_of,
    lot_of,
    on_film,
    picked,
    place_numbers,
    unknown,
    velocities_on_film,
)
from torch_radbp.call.render_call import RenderCall
from torch_radbp.jit.order import chosen
from torch_radbp.sampling.running_sum import running_sum
from torch_radbp.sensor.kind import Camera
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.stage import stage
from torch_radbp.tensors.vec import TINY, Vec2, Vec3, dot, interpolated, rows

PROBES = ((0.1, 0.15, 0.5), (0.3, 0.5, 0.15), (0.5, 0.5, 0.5), (0.7, 0.5, 0.85), (0.9, 0.85, 0.5))  # s, and the aperture
ASIDE = 1e-9  # share of its distance by which a rim is moved off the edges of triangles
ASTRIDE = 1e-4  # cosine between shading normal and line of sight at which a surface is looked at on either side of a rim
FARTHEST_ASTRIDE = 0.05  # the same as barycentric coordinates, at most
LEAST = 0.1  # of the mean length of curves in a triangle, that triangles count where no line meets a curve
LEAST_OF_LENS = 1.0  # the same where each point of a lens sees other curves, of which the lines meet few
MOST_TRIES = 16  # places that are looked for on a lens for one that is found
SIDES = ((0, 1), (0, 2), (1, 2))  # of triangles, by their corners

Level = Callable[[Camera, Vec3, Vec3 | None, Vec2 | None], Tensor]


class TriangleLevel(NamedTuple):
    """A quadratic level function on triangles, by its six coefficients F_ij, (N,) each."""

    corner: tuple[Tensor, Tensor, Tensor]  # F_00, F_11, F_22
    side: tuple[Tensor, Tensor, Tensor]  # F_01, F_02, F_12

    def crosses(self, margin: Tensor | float) -> Tensor:
        """(N,) bool: the level may vanish somewhere in the triangle, or come within `margin` of 0."""
        numbers = (*self.corner, *self.side)
        below, above = numbers[0] < margin, numbers[0] > -margin
        for number in numbers[1:]:
            below, above = below | (number < margin), above | (number > -margin)
        return below & above

    def gradient(self, u: Tensor, v: Tensor) -> tuple[Tensor, Tensor]:
        """The derivatives of the level by the barycentric coordinates of the second and the third corner."""
        (f0, f1, f2), (f01, f02, f12), w = self.corner, self.side, 1.0 - u - v
        at_0, at_1, at_2 = w * f0 + u * f01 + v * f02, w * f01 + u * f1 + v * f12, w * f02 + u * f12 + v * f2
        return 2.0 * (at_1 - at_0), 2.0 * (at_2 - at_0)


class OnTriangle(NamedTuple):
    """Points on curves inside of triangles, (N,) each."""

    u: Tensor  # barycentric coordinates: of the second corner
    v: Tensor  # of the third
    pace: Tensor  # t / |f_t|, for each step of the sampled s; 0 where a line does not meet the curve


class OnFilm(NamedTuple):
    """Points on curves inside of triangles as a camera sees them, (N,) each."""

    p: Vec3  # world
    film: Vec2  # pixels
    normal: Vec2  # m, times the pace
    drift: Tensor  # -det(J), times the pace
    uphill: Vec2  # step in u and v by which the level rises by one, along its gradient


def _facing(camera: Camera, p: Vec3, n: Vec3, aperture: Vec2 | None) -> Tensor:
    """The level function of rims, which is positive where the viewer is on the shading normal's side of the surface.

    A rim that runs along an edge is moved slightly into one of its two triangles.
    """
    towards = camera.kind.towards(camera.lens, p, aperture)
    return dot(n, towards) + ASIDE * torch.sqrt(dot(towards, towards)).detach()


def beyond_near(camera: Camera, p: Vec3, n: None, aperture: Vec2 | None) -> Tensor:
    """The level function that vanishes on the camera's near plane."""
    return camera.kind.beyond_planes(camera.lens, p)[0]


def beyond_far(camera: Camera, p: Vec3, n: None, aperture: Vec2 | None) -> Tensor:
    """The level function that vanishes on the camera's far plane."""
    return camera.kind.beyond_planes(camera.lens, p)[1]


LEVELS: dict[int, Level] = {RIM: _facing, NEAR: beyond_near, FAR: beyond_far}


@film_term
class Contours(FilmTerm):
    """The film curves of rims, where shading normals turn away from the camera, and of cuts by its near and far plane."""

    rank = 1
    kinds = RIM, NEAR, FAR

    def most(self, call: RenderCall) -> int:
        return 1 + (call.scene.triangles.vertices.n is not None) + any(view.clips for view in call.views)

    def in_view(self, viewed: ExaminedView, jumps: Jumps) -> list[CurvesInView]:
        if jumps.faces is None:
            return []
        kinds = (RIM,) * viewed.rims + (NEAR,) + (FAR,) * viewed.clips
        flags = viewed.stages(crosses)(viewed.geometry, viewed.sight, jumps.faces, kinds)
        crossed = [(kind, rows(jumps.faces, own)) for kind, own in zip(kinds, map(chosen, flags)) if len(own)]
        return [contours_in_view(viewed, faces, kind) for kind, faces in crossed]

    def level(self, geometry: Geometry, camera: Camera, places: Places, kind: int) -> Tensor:
        return level_at(geometry, camera, places, kind)


def contours_in_view(viewed: ExaminedView, faces: Faces, kind: int) -> CurvesInView:
    """The visible curves of one kind inside of `faces`, triangles that they may cross."""
    stages, geometry, sight, camera = viewed[:4]
    aperture = camera.kind.has_aperture
    inside, whole = stages(contour_length)(geometry, sight, faces, kind)
    length = torch.where(inside > 0.0, inside, whole)
    length = length + (LEAST_OF_LENS if aperture else LEAST) * length.mean() + float(not length.any())
    total = running_sum(length)

    def places(count: int) -> Places:
        if aperture:
            count = round(count / max(float((whole > 0.0).double().mean()), 1.0 / MOST_TRIES))
        lines = torch.full((), count, dtype=torch.int32, device=length.device)
        lot = lot_of(length, count, total)
        return stages(contour_place)(geometry, sight, faces, lot, lines, lanes(2 * count, length), kind)

    return CurvesInView(float(total[-1]), places)


@stage("geometry", "sight")
def crosses(geometry: Geometry, sight: Sight, faces: Faces, kinds: tuple[int, ...]) -> tuple[Tensor, ...]:
    """For each kind of curve, (F,) bool: triangles that may contain a curve visible from somewhere on the lens.

    Args:
        geometry: of the scene, detached.
        sight: of the camera.
        faces: (F,) the triangles.
        kinds: the kinds of curves: RIM, NEAR or FAR.
    """
    between, triangles = faces.between(geometry), geometry.triangles
    aperture = middle(sight, geometry, between)
    in_view = ~sight.frustum.misses(positions(geometry, between, faces.instance))

    def of_kind(kind: int) -> Tensor:
        found = net(geometry, sight.camera, between, faces.instance, kind, aperture).crosses(
            sight.eye.radius if kind == RIM and sight.eye.radius is not None else 0.0)
        if kind == RIM and triangles.smooth is not None:
            found = found & lookup(triangles.smooth, faces.triangle)
        return found & in_view

    return tuple(of_kind(kind) for kind in kinds)


@stage("geometry", "sight")
def contour_length(geometry: Geometry, sight: Sight, faces: Faces, kind: int) -> tuple[Tensor, Tensor]:
    """The estimated lengths of curves in triangles on the film, in view and in total; (F,) pixels.

    Args as for `crosses`, with one kind.
    """
    camera, film = sight.camera, sight.camera.film
    between, _ = from_apex(geometry, sight, faces, kind)
    inside = whole = torch.zeros_like(geometry_number(geometry, between))
    for s, x, y in PROBES:
        aperture = Vec2(torch.full_like(whole, x), torch.full_like(whole, y)) if camera.kind.has_aperture else None
        curve = OnView(geometry, camera, between, faces.instance, kind, aperture)
        for place in _met(curve.net, torch.full_like(whole, s)):
            seen = curve.at(place)
            length = torch.sqrt(seen.normal.x * seen.normal.x + seen.normal.y * seen.normal.y)
            own = torch.where(length >= 0.0, length, 0.0)  # NaN where there is no place
            own = torch.minimum(own, (film.columns + film.rows).double())
            inside = inside + torch.where(in_window(camera, seen.film, seen.normal), own, 0.0)
            whole = whole + own
    return inside * (1.0 / len(PROBES)), whole * (1.0 / len(PROBES))


@stage("geometry", "sight", "faces", "lot")
def contour_place(geometry: Geometry, sight: Sight, faces: Faces, lot: Lot, count: Tensor, lane: Tensor,
                  kind: int) -> Places:
    """Samples points on curves of one kind, in proportion to their lengths on the film.

    Args:
        geometry, sight, faces, kind: as for `contour_length`.
        lot: the distribution of samples over the triangles.
        count: () int32, the number of lines across triangles that are sampled.
        lane: (2 N,) int32, for each line its first intersection with the curve; then for each its second one.
    """
    camera, line = sight.camera, lane % count
    numbers = place_numbers(sight, line, kind)
    aperture = numbers.aperture
    face, s, times = picked(lot, line, numbers.along)
    faces = rows(faces, face)
    between, apex = from_apex(geometry, sight, faces, kind)
    curve = OnView(geometry, camera, between, faces.instance, kind, aperture)
    one, two = _met(curve.net, s)
    place = OnTriangle(*(torch.where(lane < count, here, there) for here, there in zip(one, two)))
    seen = curve.at(place)
    scale = times if faces.share is None else times / faces.share
    side = torch.sign(seen.drift) * (-1.0 if kind == RIM else 1.0)
    behind = ahead = unknown(place.u)
    if kind == RIM:
        reach = astride(camera, seen, aperture)
        behind, ahead = (glued(faces.triangle, apex, place.u + reach.x * side * way, place.v + reach.y * side * way)
                         for way in (-1.0, 1.0))
    normal = seen.normal * scale
    counts = in_window(camera, seen.film, normal) & camera.film.sees(seen.film)
    return Places(torch.full_like(apex, kind), between, faces.instance, place.u, place.v, seen.p, seen.film, normal, side,
                  seen.drift * scale, depth_of(camera, seen.p, curve.corners, aperture), behind, ahead,
                  torch.full_like(apex, -1), faces.instance, numbers.key, aperture, counts, torch.full_like(apex, -1))


def from_apex(geometry: Geometry, sight: Sight, faces: Faces, kind: int) -> tuple[Between, Tensor]:
    """The vertices of triangles, first the one whose level differs in sign from the others; and its index, (F,) int32."""
    first, second, third = between = faces.between(geometry)
    level = net(geometry, sight.camera, between, faces.instance, kind, middle(sight, geometry, between))
    a, b, c = (torch.sign(value) for value in level.corner)
    at_b, at_c = (a == c) & (b != a), (a == b) & (c != a)
    turns = (first, second, third), (second, third, first), (third, first, second)
    apex = at_b.to(torch.int32) + 2 * at_c.to(torch.int32)
    return Between(*(torch.where(at_b, two, torch.where(at_c, three, one)) for one, two, three in turns)), apex


def geometry_number(geometry: Geometry, between: Between) -> Tensor:
    """An (F,) float64 tensor, one entry for each triangle, as a template for tensors of that shape."""
    return lookup(geometry.triangles.vertices.p.x, between.first).double()


def middle(sight: Sight, geometry: Geometry, between: Between) -> Vec2 | None:
    """The centre of the lens, repeated for each triangle; None: the camera is a pinhole."""
    if not sight.camera.kind.has_aperture:
        return None
    half = torch.full_like(geometry_number(geometry, between), 0.5)
    return Vec2(half, half)


def net(geometry: Geometry, camera: Camera, between: Between, instance: Tensor | None, kind: int,
        aperture: Vec2 | None) -> TriangleLevel:
    """The six coefficients of a level function on triangles, from its values at corners and midpoints of sides."""
    p = positions(geometry, between, instance)
    n = vertex_normals(geometry, between, instance) if kind == RIM else (None,) * 3
    level = LEVELS[kind]
    corner = tuple(level(camera, p[i], n[i], aperture) for i in range(3))
    halfway = (level(camera, (p[i] + p[j]) * 0.5, None if n[i] is None else (n[i] + n[j]) * 0.5, aperture) for i, j in SIDES)
    return TriangleLevel(corner, tuple(2.0 * value - 0.5 * (corner[i] + corner[j]) for value, (i, j) in zip(halfway, SIDES)))


def _met(level: TriangleLevel, along: Tensor) -> list[OnTriangle]:
    """The intersections, at most two, of a curve with lines from the first corner to points on the opposite side.

    Args:
        level: of triangles.
        along: (N,) in [0, 1], the lines, such that equal steps are equal along the curve if the level is linear.
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


class OnView:
    """The curves of one kind inside of triangles as a camera sees them: the zeros of a level function.

    Args:
        geometry: of the scene, attached.
        between, instance: (N,) the triangles.
        kind: of the level function, a key of `LEVELS`.
        aperture: of the camera's rays; None: it has none.
    """

    def __init__(self, geometry: Geometry, camera: Camera, between: Between, instance: Tensor | None, kind: int,
                 aperture: Vec2 | None):
        self.camera, self.aperture = camera, aperture
        self.corners = positions(geometry, between, instance)
        self.net = net(geometry, camera, between, instance, kind, aperture)

    def at(self, place: OnTriangle) -> OnFilm:
        """Points on the curves as the camera sees them, with the curve's normal and motion on the film."""
        camera, corners, aperture = self.camera, self.corners, self.aperture
        p = interpolated(corners, place.u, place.v)
        of_u, of_v = velocities_on_film(camera, p, [corner - corners[0] for corner in corners[1:]], aperture)
        f_u, f_v = self.net.gradient(place.u, place.v)
        m = Vec2(of_v.y * f_u - of_u.y * f_v, of_u.x * f_v - of_v.x * f_u)
        volume = of_u.x * of_v.y - of_v.x * of_u.y
        steep = f_u**2 + f_v**2
        return OnFilm(p, on_film(camera, p, aperture), m * place.pace, -volume * place.pace, Vec2(f_u / steep, f_v / steep))


def astride(camera: Camera, seen: OnFilm, aperture: Vec2 | None) -> Vec2:
    """The step in u and v across a rim to where the shading normal faces the viewer; the opposite step: faces away."""
    towards = camera.kind.towards(camera.lens, seen.p, aperture)
    reach = seen.uphill * (ASTRIDE * torch.sqrt(dot(towards, towards)))
    return reach * (FARTHEST_ASTRIDE / torch.sqrt(reach.x * reach.x + reach.y * reach.y)).clamp_max(1.0)


def glued(triangle: Tensor, apex: Tensor, u: Tensor, v: Tensor) -> Glued:
    """Points fixed to triangles, from barycentric coordinates u and v that count from the vertex `apex`."""
    w = 1.0 - u - v
    return Glued(triangle, torch.where(apex == 0, u, torch.where(apex == 1, w, v)),
                 torch.where(apex == 0, v, torch.where(apex == 1, u, w)))


def in_window(camera: Camera, film: Vec2, normal: Vec2) -> Tensor:
    """(N,) bool: samples that contribute to some pixel and whose curve has a direction."""
    reach, squared = camera.film.kernel.radius, normal.x * normal.x + normal.y * normal.y
    across = (film.x >= -reach) & (film.x <= camera.film.columns + reach)
    return across & (film.y >= -reach) & (film.y <= camera.film.rows + reach) & torch.isfinite(squared) & (squared > 0.0)


def level_at(geometry: Geometry, camera: Camera, places: Places, kind: int) -> Tensor:
    """The level function at samples on its curve, which are fixed to triangles; (N,) attached, 0 up to rounding."""
    n = None
    if kind == RIM:
        n = interpolated(vertex_normals(geometry, places.between, places.instance), places.u, places.v)
    return LEVELS[kind](camera, places.at(geometry), n, places.aperture)
