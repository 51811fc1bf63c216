"""The density on the film of paths whose vertices sample edges: higher near edges.

A vertex that lies r away from an edge sees it turn by 1 / r where either moves by one. Next to the ends of walls, and where
things touch, few paths so have most of the noise of all. So some paths are tried first. Their edges, each counted by the
throughput of its path over its distance, are summed in tiles of the film; half of all paths are spread by these sums, half
evenly, and each counts by the inverse of the density of both together. Those that were tried have random numbers of their
own, and are not used otherwise.

Reference: Veach and Guibas 1995, "Optimally Combining Sampling Techniques for Monte Carlo Rendering" (mixtures).
"""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.boundary.eye.seen_edges import Passed
from torch_radbp.boundary.eye.viewpoints import Viewpoints
from torch_radbp.call.view import View
from torch_radbp.tensors.vec import max_component

SHARE, FEWEST = 32, 1024  # one path is tried for so many; and at least, or none is
GUIDED = 0.5  # share of the paths that go where edges are near
OF_TILE = 16  # places on edges in a tile, in the mean


def film_density(view: View, points: Viewpoints, passed: Passed) -> Tensor:
    """The relative density of paths over the cells of a film, (cells,) float64, of mean 1.

    Args:
        view: the view of the film.
        points: vertices of paths that start evenly over the film.
        passed: samples on edges that they see, each of which stands for the same angle.
    """
    columns, rows = view.grid.columns, view.grid.rows
    eye = passed.eye.long()
    amount = (max_component(points.beta).double()[eye] / passed.distance.double()).nan_to_num(0.0, 0.0, 0.0)
    side = max(1, round((OF_TILE * columns * rows / len(eye))**0.5))
    across, down = -(-columns // side), -(-rows // side)
    column, row = (((place[eye] + before).floor().long().clamp(0, cells - 1) // side) for place, before, cells in (
        (points.place.x, view.window.columns.before, columns), (points.place.y, view.window.rows.before, rows)))
    tiles = amount.new_zeros(across * down).index_add(0, row * across + column, amount).view(down, across)
    cells = tiles.repeat_interleave(side, 0)[:rows].repeat_interleave(side, 1)[:, :columns].reshape(-1)
    mean = cells.mean()
    return (1.0 - GUIDED) + GUIDED * torch.where(mean > 0.0, cells / torch.where(mean > 0.0, mean, 1.0), 1.0)
