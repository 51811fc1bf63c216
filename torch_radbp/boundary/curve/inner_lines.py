"""The film curves of straight lines inside of triangles, `segments.py`, and samples on them."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.boundary.curve.film_term import CurvesInView, ExaminedView, FilmTerm, film_term, lines_in_view
from torch_radbp.boundary.curve.geometry import Between, Geometry
from torch_radbp.boundary.curve.outline import Jumps
from torch_radbp.boundary.curve.places import (
    INTERSECTION,
    TEXTURE,
    Glued,
    Lot,
    Places,
    Sight,
    depth_of,
    length_in_view,
    on_film,
    picked,
    place_numbers,
    velocities_on_film,
)
from torch_radbp.boundary.curve.segments import Segments, faces_viewer, height_above, heights_by, level_on_lines, place_of
from torch_radbp.sensor.kind import Camera
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.stage import stage
from torch_radbp.tensors.vec import TINY, Vec2, interpolated, rows


@film_term
class InnerLines(FilmTerm):
    """The film curves of straight lines inside of triangles: texture lines, and intersections of surfaces."""

    rank = 2
    kinds = TEXTURE, INTERSECTION

    def in_view(self, viewed: ExaminedView, jumps: Jumps) -> list[CurvesInView]:
        return lines_in_view(viewed, jumps.segments, segment_weight, segment_place)

    def level(self, geometry: Geometry, camera: Camera, places: Places, kind: int) -> Tensor | None:
        if kind == INTERSECTION:
            return height_above(place_of(geometry, places.through, places.shown_by), places.at(geometry))
        if geometry.lines is None:
            return None
        return level_on_lines(geometry, places.between, places.u, places.v, places.line)


@stage("geometry", "sight")
def segment_weight(geometry: Geometry, sight: Sight, segments: Segments) -> Tensor:
    """The lengths of segments in view, (S,) float64 pixels.

    Args:
        geometry: of the scene, detached.
        sight: of the camera.
        segments: (S,) the segments.
    """
    corners = segments.corners(geometry)
    length = length_in_view(sight, *(interpolated(corners, end.x, end.y) for end in (segments.start, segments.end)))
    if segments.seen_from is None or sight.camera.kind.has_aperture:
        return length
    return torch.where(faces_viewer(geometry, segments, corners, lambda p: -sight.eye.towards(p)), length, 0.0)


@stage("geometry", "sight", "segments", "lot")
def segment_place(geometry: Geometry, sight: Sight, segments: Segments, lot: Lot, place: Tensor) -> Places:
    """Samples points on segments in proportion to their lengths on the film.

    Args:
        geometry, sight, segments: as for `segment_weight`.
        lot: the distribution of samples over the segments.
        place: (N,) int32, the numbers of the samples.
    """
    camera, numbers = sight.camera, place_numbers(sight, place, TEXTURE)
    aperture = numbers.aperture
    segment, share, times = picked(lot, place, numbers.along)
    own = rows(segments, segment)
    between, corners = Between(*lookup(geometry.triangles.corners, own.triangle)), own.corners(geometry)
    a, b = (interpolated(corners, end.x, end.y) for end in (own.start, own.end))
    enters, leaves = sight.frustum.clipped(a, b)
    along, run = enters + (leaves - enters) * share, own.end + own.start * -1.0
    at = own.start + run * along
    p = interpolated(corners, at.x, at.y)
    film, pace = on_film(camera, p, aperture), velocities_on_film(
        camera, p, [corner - corners[0] for corner in corners[1:]], aperture)
    # The density over `along` is 1 / (times reach); the length of the segment on the film per `along` is in `swift`.
    scale = times * (leaves - enters)
    scale = scale if own.share is None else scale / own.share
    if own.seen_from is not None:
        seen = faces_viewer(geometry, own, corners, lambda p: camera.kind.towards(camera.lens, p, aperture))
        scale = torch.where(seen, scale, 0.0)
    swift = (pace[0] * run.x + pace[1] * run.y) * scale
    normal = Vec2(-swift.y, swift.x)
    step = pace[0] * own.aside.x + pace[1] * own.aside.y
    ahead = torch.where(step.x * normal.x + step.y * normal.y >= 0.0, 1.0, -1.0)
    known = torch.where((own.aside.x != 0.0) | (own.aside.y != 0.0), own.triangle, -1)
    sides = (Glued(known, at.x + own.aside.x * way, at.y + own.aside.y * way) for way in (-ahead, ahead))
    passing = own.through >= 0
    passed = place_of(geometry, own.through, own.shown_by)
    heights = heights_by(passed, corners)
    rise = Vec2(*(torch.where(passing, height, line) for height, line in zip(heights, own.rise)))
    drift = drift_of(rise, pace, normal)
    kind = torch.where(passing, INTERSECTION, TEXTURE).to(torch.int32)
    return Places(kind, between, own.instance, at.x, at.y, p, film, normal, torch.ones_like(at.x), drift,
                  depth_of(camera, p, corners, aperture), *sides, own.through, own.shown_by, numbers.key, aperture,
                  camera.film.sees(film), own.line)


def drift_of(rise: Vec2, pace: list[Vec2], normal: Vec2) -> Tensor:
    """The motion of lines along their normals on the film per unit of their level function; (N,).

    Args:
        rise: the derivatives of the level by the coordinates u and v.
        pace: the derivatives of film positions by u and v.
        normal: of the lines, (N,) of any length, by which the result is scaled.
    """
    by_u, by_v = rise
    of_u, of_v = pace
    m = Vec2(of_v.y * by_u - of_u.y * by_v, of_u.x * by_v - of_v.x * by_u)
    volume = of_u.x * of_v.y - of_v.x * of_u.y
    return -volume * (normal.x * m.x + normal.y * m.y) / (m.x * m.x + m.y * m.y).clamp_min(TINY)
