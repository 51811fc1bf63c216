"""Runs: a small mesh in parts of triangles that follow each other, each with a box, for `batches.py`.

Files list the triangles of a thing one after the other, so that such parts are compact without a search for better ones.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

# What a ray costs, in tests of a triangle: the box of a run; a run whose box it meets, beside its triangles; and what part
# of a batch is lost where a vector of rays is not full.
BOX, VISIT, LOST = 0.4, 3.0, 1 / 64
MOST, MOST_TRIANGLES = 32, 1000  # triangles of a run, and of a mesh
FEW = 64  # triangles that a processor which permutes vectors reads without gathers; so long columns are at least


class Runs(NamedTuple):
    """What loops over batches of rays read of a mesh of F triangles in R runs."""

    corners: Tensor  # (C, 3) numbers in units of the mesh, run by run; corners of a run in the same place are one
    triangles: Tensor  # (F, 3) int32, rows of these
    by_triangle: Tensor  # (9, max(F, FEW)) the coordinates of the corners, by triangle
    columns: Tensor  # () int64, how long its rows are
    boxes: Tensor  # (1 + R + B, 6) centres and half extents: of all, of the runs, of B balls
    firsts: Tensor  # (R + 1, 2) int32, the first triangle and the first corner of each; behind the last, how many there are
    count: Tensor  # () int64, R
    scale: Tensor  # () the length of 1 in units of the mesh


def runs_of(p: Tensor) -> tuple[list[int], float]:
    """The first triangle of each run, behind them F, and about what a ray costs: of all divisions the cheapest.

    A ray is taken to meet boxes in proportion to their area.

    Args:
        p: (F, 3, 3) the corners of triangles.
    """
    most = min(MOST, len(p))
    low, high = (torch.cat([found, found[-1:].expand(most - 1, 3)]).unfold(0, most, 1) for found in (p.amin(1), p.amax(1)))
    extent = (high.cummax(2).values - low.cummin(2).values).transpose(1, 2)  # (F, most, 3) by first triangle and number
    scene = area(p.amax((0, 1)) - p.amin((0, 1))).clamp_min(torch.finfo(p.dtype).tiny)
    met = area(extent) / scene + LOST
    costs = (BOX + met * (VISIT + torch.arange(1, most + 1, device=p.device))).numpy()
    least, following = np.zeros(len(p) + most), [0] * len(p)  # of what follows a triangle
    least[len(p) + 1:] = np.inf
    for first in reversed(range(len(p))):
        found = costs[first] + least[first + 1:first + 1 + most]
        following[first] = first + 1 + int(found.argmin())
        least[first] = found[following[first] - first - 1]
    firsts = [0]
    while firsts[-1] < len(p):
        firsts.append(following[firsts[-1]])
    return firsts, float(least[0])


def area(extent: Tensor) -> Tensor:
    """Half of the area of boxes, (..., 3)."""
    x, y, z = extent.unbind(-1)
    return x * y + y * z + z * x


def boxes_around(low: Tensor, high: Tensor) -> Tensor:
    """(N, 6) centres and half extents of boxes, from their least and greatest coordinates, (N, 3)."""
    centre = 0.5 * (low + high)
    return torch.cat([centre, torch.maximum(high - centre, centre - low)], 1)


def box_of_ball(placement: Tensor) -> tuple[Tensor, Tensor]:
    """The least and greatest coordinates of unit spheres that are placed, (B, 3) each, by (B, 3, 4) matrices."""
    centre, half = placement[:, :3, 3], placement[:, :3, :3].norm(dim=2)
    return centre - half, centre + half


def tables(p: Tensor, first: Tensor, scale: Tensor, balls: Tensor | None) -> Runs:
    """What loops read of triangles.

    Args:
        p: (F, 3, 3) their corners.
        first: (R,) the first triangle of each run.
        scale: () the length of 1 in units of the mesh.
        balls: (B, 3, 4) the placements of balls beside them; None: none.
    """
    p = p * scale
    lengths = torch.cat([first, first.new_tensor([len(p)])]).diff()
    borders = [torch.segment_reduce(found, how, lengths=lengths) for found, how in ((p.amin(1), "min"), (p.amax(1), "max"))]
    if balls is not None:
        borders = [torch.cat(pair) for pair in zip(borders, box_of_ball(balls.to(p.dtype) * scale))]
    low, high = borders
    boxes = boxes_around(torch.cat([low.amin(0, keepdim=True), low]), torch.cat([high.amax(0, keepdim=True), high]))
    run = torch.zeros(len(p), dtype=torch.int64, device=p.device)
    run[first[1:]] = 1
    run = run.cumsum(0)
    _, place = torch.unique(p.flatten(0, 1), dim=0, return_inverse=True)
    named = run.repeat_interleave(3) * (int(place.max()) + 1) + place
    names, rows = torch.unique(named, return_inverse=True)  # sorted, and so run by run
    corners = p.new_empty(len(names), 3)
    corners[rows] = p.flatten(0, 1)
    of_run = torch.searchsorted(names, torch.arange(len(first) + 1, device=p.device) * (int(place.max()) + 1))
    firsts = torch.stack([torch.cat([first, first.new_tensor([len(p)])]), of_run], 1)
    by_triangle = torch.nn.functional.pad(p.reshape(-1, 9).T, (0, max(0, FEW - len(p)))).contiguous()
    return Runs(corners, rows.reshape(-1, 3).to(torch.int32), by_triangle,
                torch.tensor(by_triangle.shape[1], device=p.device), boxes, firsts.to(torch.int32),
                torch.tensor(len(first), device=p.device), scale)
