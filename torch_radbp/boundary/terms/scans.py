"""Scans: short lines across pixels on which discontinuities are searched, mostly where corners see different things.

First a path is followed from every corner of the pixels. A pixel is then scanned in proportion to how likely its corners see
different things by way of mirrors and glass, and a little more, for what is smaller.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.curve.places import FEWEST, key_of_places, lot_of, picked
from torch_radbp.boundary.curve.triangles_in_view import may_see_ideal_surfaces
from torch_radbp.boundary.eye.differences import CHANCE, SHADOW, SURFACE, Difference, Pairing, path_difference
from torch_radbp.boundary.eye.ideal_paths import IdealPath, LightLooks, begins, ideal_path, with_light
from torch_radbp.boundary.eye.light_points import light_points
from torch_radbp.boundary.eye.seen_edges import salted
from torch_radbp.boundary.eye.seen_on_film import aperture_of, camera_sample
from torch_radbp.boundary.eye.surfaces import Surfaces
from torch_radbp.boundary.terms.covered_lights import Lights
from torch_radbp.call.render_call import RenderCall, started
from torch_radbp.path.integrand import Integrand
from torch_radbp.sampling.running_sum import running_sum
from torch_radbp.sampling.sampler import CAMERA_COUNTER, LaneKey, bounce_key, fine_unit, lane_key, random_bits
from torch_radbp.tensors.record import joined, selected
from torch_radbp.tensors.vec import Vec2, rows

STEPS = 8  # of a scan; what is narrower than one is likely missed
SHARE, MOST = 64, 1 << 15  # one place for so many paths of the image; and at most
FLOOR = 0.25  # of the mean likelihood, by which each pixel with a mirror or glass in view is scanned
OUTLINE = 0.5  # likelihood of a jump right beside the outline of a curved mirror, if some have black strips there
PENUMBRA = 0.25  # the same of a border of the shadow of one point of a lamp, where some of these are hidden
PASSES, SAMPLES_OF_PASS = 4, 16  # paths from each corner, at most; and one for so many samples of a pixel
CORNERS = 1 << 13  # paths from corners that are looked at together: of small images all, since each look takes its time
SALT = 0x3C6EF372  # tells the random numbers of these paths from others
ACROSS, DOWN = 0, 1  # the random numbers of a place


class FilmPoints(NamedTuple):
    """N points of the film, with the random numbers of the paths from there."""

    film: Vec2  # pixels from the upper left corner of the window; float64
    aperture: Vec2 | None  # on the lens
    key: LaneKey
    looks: LightLooks | None  # light samples whose shadow borders are searched; None: none are


class Searched(NamedTuple):
    """A view whose film is scanned for discontinuities, without derivatives."""

    call: RenderCall
    number: int  # of the view
    integrand: Integrand  # from `only_ideal`
    surfaces: Surfaces
    tables: Any  # the same, prepared for the stages
    lights: Lights  # whose shadow borders are searched: of lights of some extent after one ideal vertex alone
    strips: bool  # curved mirrors or glass have black strips beside their outlines, whose borders are searched


class Scans(NamedTuple):
    """M pixels to scan: the position of a horizontal and a vertical scan in each."""

    column: Tensor  # (M,) float64, left edge of the pixel, from the window's left edge
    row: Tensor  # (M,) float64, upper edge, likewise
    at: Vec2  # position of the scans in the pixel
    times: Tensor  # (M,) float64, square pixels per scan
    aperture: Vec2 | None
    key: LaneKey
    looks: LightLooks | None


def paths_from(searched: Searched, points: FilmPoints) -> IdealPath:
    """Traces ideal paths from points of the film, with light samples if these have any."""
    call = searched.call
    sample = camera_sample(call, call.views[searched.number], points.film, points.aperture, points.key)
    path = ideal_path(searched.integrand, started(call, sample), searched.tables)
    return path if points.looks is None else with_light(searched.integrand, path, points.looks)


def parting(searched: Searched, path: IdealPath, pairs: Pairing) -> Difference:
    """The first vertex at which the two camera paths of each pair differ, and in what."""
    return path_difference(searched.call.stages, searched.tables, path, pairs)


def looks_of(searched: Searched, count: int) -> LightLooks | None:
    """`count` light samples whose shadow borders are searched; None: no shadow borders are."""
    if not any(searched.lights):
        return None
    scene = searched.call.scene
    points = light_points(searched.call.stages, scene, searched.call.views[searched.number], count)
    wanted, sharp = (lights.of(scene)[points.kind] for lights in (searched.lights, Lights(True, False, False)))
    return LightLooks(points.draw, wanted, sharp)


def scans_of(searched: Searched) -> Scans | None:
    """Samples the scans of a view; None: it sees neither mirrors nor glass."""
    call = searched.call
    view = call.views[searched.number]
    paths = view.width * view.height * call.spp
    if not may_see_ideal_surfaces(view, call.scene, paths):
        return None
    columns, weight = view.grid.columns, pixel_weights(searched)
    total = running_sum(weight)
    if not float(total[-1]) > 0.0:
        return None
    count = max(FEWEST, min(MOST, paths // SHARE, int(float(total[-1]) * call.spp)))
    place = torch.arange(count, dtype=torch.int32, device=weight.device)
    key = key_of_places(salted(view, SALT), place)
    numbers = bounce_key(key, CAMERA_COUNTER)
    across, down = (fine_unit(random_bits(numbers, dimension)) for dimension in (ACROSS, DOWN))
    pixel, left, times = picked(lot_of(weight, count, total), place, across)
    row = torch.div(pixel, columns, rounding_mode="floor")
    before = view.window.columns.before, view.window.rows.before
    return Scans((pixel - row * columns - before[0]).double(), (row - before[1]).double(), Vec2(left, down), times,
                 aperture_of(view, key), key, looks_of(searched, count))


def pixel_weights(searched: Searched) -> Tensor:
    """The expected number of scans in each pixel, (P,) float64, row by row; 0 where no mirror or glass is in view."""
    call, most, shows, corners = searched.call, None, None, corners_of_pixels(searched)
    turns = turns_of(call)
    looks, together = looks_of(searched, turns * (1 + len(corners.x))), turns_together(len(corners.x), turns)
    for first in range(0, turns, together):
        some = range(first, min(turns, first + together))
        found, seen = corner_passes(searched, some, corners, looks_of_corners(looks, turns, some, len(corners.x)))
        most = found if most is None else torch.maximum(most, found)
        shows = seen if shows is None else shows | seen
    shows = shows.double()[None, None]
    near = torch.nn.functional.max_pool2d(shows, 2, stride=1)[0, 0] > 0
    near = torch.nn.functional.max_pool2d(near.double()[None, None], 3, stride=1, padding=1)[0, 0] > 0
    count = near.sum().clamp_min(1)
    return torch.where(near, most + FLOOR * most.sum() / count + 1e-3, 0.0).flatten()


def turns_of(call: RenderCall) -> int:
    """The number of paths from each corner of a pixel."""
    return max(1, min(PASSES, call.spp // SAMPLES_OF_PASS))


def turns_together(corners: int, turns: int) -> int:
    """The number of turns, each a path from every corner of the pixels, that are traced together for so many corners."""
    return max(1, min(turns, CORNERS // corners))


def corners_of_pixels(searched: Searched) -> Vec2:
    """The film positions of the corners of a view's pixels, row by row, ((R + 1) (C + 1),) float64."""
    view = searched.call.views[searched.number]
    width, height = view.grid.columns + 1, view.grid.rows + 1
    corner = torch.arange(width * height, dtype=torch.int32, device=searched.call.scene.device)
    row = torch.div(corner, width, rounding_mode="floor")
    return Vec2((corner - row * width - view.window.columns.before).double(), (row - view.window.rows.before).double())


def looks_of_corners(looks: LightLooks | None, turns: int, some: range, count: int) -> LightLooks | None:
    """The light samples of pixel corners in some of several turns, turn by turn: for a light without extent one that all
    corners share, beside whose shadow they see different things; for other lights one each, which differ wherever a part of
    the lamp is hidden.

    Args:
        looks: one for each turn, and one for each corner in each.
        turns: the number of all turns.
        count: the number of corners.
    """
    if looks is None:
        return None
    place = torch.arange(some.start * count, some.stop * count, device=looks.wanted.device)
    shared, own = rows(looks, torch.div(place, count, rounding_mode="floor")), rows(looks, turns + place)
    return selected(shared.anywhere, shared, own)


def corner_passes(searched: Searched, turns: range, film: Vec2, looks: LightLooks | None) -> tuple[Tensor, Tensor]:
    """Traces a path from each pixel corner in each of some turns, and compares those of neighbouring corners.

    Args:
        searched: the view.
        turns: the numbers of the turns.
        film: the positions of the corners.
        looks: the light samples of all corners, turn by turn; None: there are none.

    Returns:
        (R, C) float64, the greatest likelihood in any turn that the image jumps in the pixel; and (R + 1, C + 1) bool:
        a path from the corner hits an ideal surface.
    """
    call, count = searched.call, len(film.x)
    view, device = call.views[searched.number], call.scene.device
    width, height = view.grid.columns + 1, view.grid.rows + 1
    salt, shape = salted(view, SALT + 1), (len(turns), height, width)
    corner = torch.arange(count, dtype=torch.int32, device=device).repeat(len(turns))
    turn = torch.arange(turns.start, turns.stop, dtype=torch.int32, device=device).repeat_interleave(count)
    shared, aperture = lane_key(salt, torch.full_like(corner, -1), turn), aperture_of(view, lane_key(salt, corner, turn))
    path = paths_from(searched, FilmPoints(joined([film] * len(turns)), aperture, shared, None))
    lit = None if looks is None else with_light(searched.integrand, path, looks)
    place, begin = torch.arange(count * len(turns), device=device).view(shape), begins(path)
    ways = (place[..., :-1], place[..., 1:]), (place[:, :-1], place[:, 1:])  # from left to right, and down
    pairs = Pairing(*(torch.cat([part.flatten() for part in ends]) for ends in zip(*ways)))
    found = parting(searched, path, pairs)
    likelihood = torch.where((found.depth > 0) & (found.kind != CHANCE), found.likelihood, 0.0)
    if searched.strips:
        outline = (found.kind == SURFACE) & (found.depth == 0) & (begin[pairs.first] | begin[pairs.second])
        likelihood = torch.where(outline, OUTLINE, likelihood)
    if lit is not None:
        border = torch.where(looks.anywhere[pairs.first], 1.0, PENUMBRA) * (parting(searched, lit, pairs).kind == SHADOW)
        likelihood = torch.maximum(likelihood, border)
    across, down = (part.view(way[0].shape).amax(0) for part, way in zip(
        likelihood.split([way[0].numel() for way in ways]), ways))
    likely = torch.maximum(torch.maximum(across[:-1], across[1:]), torch.maximum(down[:, :-1], down[:, 1:]))
    return likely, begin.view(shape).any(0)


def points_of(scans: Scans) -> FilmPoints:
    """The points on the film at which scans look: M of each step of the horizontal scans, from left to right, then of the
    vertical ones, downwards."""
    shares = [step / STEPS for step in range(STEPS + 1)]
    x = [scans.column + share for share in shares] + [scans.column + scans.at.x] * len(shares)
    y = [scans.row + scans.at.y] * len(shares) + [scans.row + share for share in shares]
    times = 2 * len(shares)
    return FilmPoints(Vec2(torch.cat(x), torch.cat(y)), *(joined([part] * times) for part in (
        scans.aperture, scans.key, scans.looks)))


def neighbours(count: int, device: torch.device) -> Pairing:
    """The indices of both end points of each step of `count` scans, (2 STEPS count,) int64 each."""
    first = torch.arange(2 * (STEPS + 1) * count, device=device).view(2, STEPS + 1, count)
    return Pairing(first[:, :-1].flatten(), first[:, 1:].flatten())
