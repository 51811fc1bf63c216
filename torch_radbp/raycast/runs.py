"""Runs: a small mesh divided into sequences of consecutive faces, each with a bounding box, for `batches.py`.

Files list the triangles of a thing one after the other, so that such parts are compact without a search for better ones.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from torch_radbp.raycast.faces import MergedFaces

# What a ray costs, in tests of a triangle: a parallelogram, a corner that is seen along it; and what part of a batch is lost
# where a vector of rays is not full.
PARALLELOGRAM, CORNER, LOST = 1.3, 0.2, 1 / 64


class Costs(NamedTuple):
    """Estimated costs of a run of faces, in tests of one triangle."""

    box: float  # of the test of its box, for every ray
    visit: float  # of each ray that meets the box, beside its faces and corners


# Rays without an end meet whatever is around them. Segments end before what is around them, so that boxes spare more.
OF_RAYS, OF_SEGMENTS = Costs(box=0.8, visit=2.0), Costs(box=0.4, visit=1.5)
MOST, MOST_TRIANGLES = 32, 1000  # faces of a run, and triangles of a mesh
FEW = 64  # triangles that a processor which permutes vectors reads without gathers; so long columns are at least


class Runs(NamedTuple):
    """A mesh of F triangles (P faces) in R runs, as the loops over batches of rays read it."""

    corners: Tensor  # (C, 3) numbers in units of the mesh, run by run; corners of a run in the same place are one
    faces: Tensor  # (P, 6) int32, four rows of these and two triangles, as of `MergedFaces`
    by_triangle: Tensor  # (9, max(F, FEW)) the coordinates of the corners, by triangle
    columns: Tensor  # () int64, how long its rows are
    boxes: Tensor  # (1 + R + B, 6) centres and half extents: of all, of the runs, of B balls
    firsts: Tensor  # (R + 1, 3) int32, the first face and the first corner of each; behind the last, how many there are;
    # and 1 if the faces are parallelograms, else 0
    count: Tensor  # () int64, R
    scale: Tensor  # () the length of 1 in units of the mesh


def divisions(faces: MergedFaces, costs: Iterable[Costs]) -> list[tuple[list[int], float]]:
    """For each kind of rays the cheapest division into runs: the first face of each run and then P; and the cost of a ray.

    A ray is taken to meet boxes in proportion to their area. The faces of a run are all triangles, or all parallelograms.
    """
    p, kind = faces.points[faces.corners], faces.parallelogram.to(faces.points.dtype)
    most = min(MOST, len(p))
    low, high = (beginning_at_each(bound, most) for bound in (p.amin(1), p.amax(1)))
    extent = (high.cummax(2).values - low.cummin(2).values).transpose(1, 2)  # (P, most, 3) by first face and number
    scene = area(p.amax((0, 1)) - p.amin((0, 1))).clamp_min(torch.finfo(p.dtype).tiny)
    met = area(extent) / scene + LOST
    tests = (1 + (PARALLELOGRAM - 1) * kind)[:, None] * torch.arange(1, most + 1, device=p.device)
    tests = tests + CORNER * corners_from(faces.corners, most).to(p.dtype)
    mixed = (beginning_at_each(kind[:, None], most)[:, 0] != kind[:, None]).cummax(1).values
    per_run = [torch.where(mixed, torch.inf, box + met * (visit + tests)) for box, visit in costs]
    return cheapest(torch.stack(per_run).numpy())


def cheapest(costs: np.ndarray) -> list[tuple[list[int], float]]:
    """The cheapest division of P faces into runs, for each of K kinds of rays: the first face of each run and then P; and
    its cost.

    Args:
        costs: (K, P, most) of a run, by its first face and the number of its faces.
    """
    kinds, count, most = costs.shape
    least = np.zeros((kinds, count + most))  # of what follows a face
    least[:, count + 1:] = np.inf
    following = np.zeros((kinds, count), np.int64)
    for first in reversed(range(count)):
        totals = costs[:, first] + least[:, first + 1:first + 1 + most]
        following[:, first] = totals.argmin(1)
        least[:, first] = totals.min(1)
    divisions = []
    for steps, cost in zip((following + 1 + np.arange(count)).tolist(), least[:, 0].tolist()):
        firsts = [0]
        while firsts[-1] < count:
            firsts.append(steps[firsts[-1]])
        divisions.append((firsts, cost))
    return divisions


def corners_from(corners: Tensor, most: int) -> Tensor:
    """(P, most) int64: the number of distinct corners of a run, by its first face and its number of faces.

    Args:
        corners: (P, 4) of faces.
        most: the greatest number.
    """
    place, order = corners.flatten().sort(stable=True)
    before = torch.full_like(place, -1)  # the last face that had a corner
    before[order[1:]] = torch.where(place[1:] == place[:-1], order[:-1] // 4, -1)
    first = torch.arange(len(corners), device=corners.device)[:, None, None]
    return (beginning_at_each(before.reshape(-1, 4), most) < first).sum(1).cumsum(1)


def beginning_at_each(rows: Tensor, count: int) -> Tensor:
    """(P, K, count): for each of (P, K) rows itself and the rows that follow; past the end the last one again."""
    return torch.cat([rows, rows[-1:].expand(count - 1, *rows.shape[1:])]).unfold(0, count, 1)


def area(extent: Tensor) -> Tensor:
    """Half of the surface area of boxes of extents (..., 3)."""
    x, y, z = extent.unbind(-1)
    return x * y + y * z + z * x


def _boxes_around(low: Tensor, high: Tensor) -> Tensor:
    """Centres and half extents of boxes, (N, 6), from their least and greatest coordinates, (N, 3)."""
    centre = 0.5 * (low + high)
    return torch.cat([centre, torch.maximum(high - centre, centre - low)], 1)


def box_of_ball(placement: Tensor) -> tuple[Tensor, Tensor]:
    """Bounding boxes, as least and greatest coordinates (B, 3), of unit spheres transformed by (B, 3, 4) matrices."""
    centre, half = placement[:, :3, 3], placement[:, :3, :3].norm(dim=2)
    return centre - half, centre + half


def triangle_runs(p: Tensor, faces: MergedFaces, first: Tensor, scale: Tensor, balls: Tensor | None) -> Runs:
    """Builds the tables of a mesh divided into runs, from its faces and the first face of each run.

    Args:
        p: (F, 3, 3) their corners.
        faces: that they make up, of the same dtype.
        first: (R,) the first face of each run.
        scale: () the length of 1 in units of the mesh.
        balls: (B, 3, 4) the placements of balls beside them; None: none.
    """
    points = faces.points * scale
    corner = points[faces.corners]
    lengths = torch.cat([first, first.new_tensor([len(corner)])]).diff()
    borders = [torch.segment_reduce(values, how, lengths=lengths)
               for values, how in ((corner.amin(1), "min"), (corner.amax(1), "max"))]
    if balls is not None:
        borders = [torch.cat(pair) for pair in zip(borders, box_of_ball(balls.to(p.dtype) * scale))]
    low, high = borders
    boxes = _boxes_around(torch.cat([low.amin(0, keepdim=True), low]), torch.cat([high.amax(0, keepdim=True), high]))
    run = torch.zeros(len(corner), dtype=torch.int64, device=p.device)
    run[first[1:]] = 1
    named = run.cumsum(0)[:, None] * len(points) + faces.corners
    names, rows = torch.unique(named, return_inverse=True)  # sorted, and so run by run
    of_run = torch.searchsorted(names, torch.arange(len(first) + 1, device=p.device) * len(points))
    kinds = torch.cat([faces.parallelogram[first].long(), first.new_zeros(1)])
    firsts = torch.stack([torch.cat([first, first.new_tensor([len(corner)])]), of_run, kinds], 1)
    by_triangle = torch.nn.functional.pad((p * scale).reshape(-1, 9).T, (0, max(0, FEW - len(p)))).contiguous()
    return Runs(points[names % len(points)], torch.cat([rows.to(torch.int32), faces.prims], 1), by_triangle,
                torch.tensor(by_triangle.shape[1], device=p.device), boxes, firsts.to(torch.int32),
                torch.tensor(len(first), device=p.device), scale)
