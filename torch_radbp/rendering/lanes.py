"""How many lanes of a call are traced together, and whether those of its derivative are among them."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf
from typing import NamedTuple

from torch_radbp.call.chunks import fair_chunk
from torch_radbp.film.window import Window
from torch_radbp.rendering.cost import Request, check_cost, lanes_of_chunks, recorded_lanes, traced_together


class LanePlan(NamedTuple):
    """How the lanes of a call are divided."""

    grids: list[tuple[int, int]]  # columns and rows of pixels that have samples, of each image
    lanes: int  # of a chunk
    together: bool  # see `RenderCall`


def plan_lanes(windows: Sequence[Window], rr_depth: int, request: Request) -> LanePlan:
    """The division of a call.

    Args:
        windows: of its images.
        rr_depth: scattering events before Russian roulette.
        request: the call; its `chunk` is what the user asks for, None where that is picked here.

    Raises:
        ValueError: for more than this machine can do.
    """
    device, dtype, adjoint, spp = request.device, request.dtype, request.adjoint, request.spp
    grids = [(window.columns.sampled, window.rows.sampled) for window in windows]
    about = lanes_of_chunks(device, dtype, request.workers, request.compiled)
    if adjoint is not None and device.type == "cpu":
        about = min(about, recorded_lanes(adjoint, request.max_depth, rr_depth, dtype))
    lanes = request.chunk or fair_chunk(grids, spp, request.workers, about)
    paths = spp * sum(columns * rows for columns, rows in grids)
    # Eager operations round the last lanes of a wavefront otherwise: an image would depend on what is differentiated.
    apart = adjoint is not None and request.record_bytes == 0
    together = request.compiled and apart and 2 * paths <= (request.chunk or inf) and (
        traced_together(adjoint, paths, request.max_depth, rr_depth, dtype))
    check_cost(request._replace(chunk=lanes))
    return LanePlan(grids, lanes, together)
