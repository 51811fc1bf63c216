"""Plans the chunks and wavefronts of a call."""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Sequence
from math import inf
from typing import NamedTuple

from torch_radbp.call.chunks import Chunk, fair_chunk, plan_chunks
from torch_radbp.call.view import View
from torch_radbp.call.wavefronts import Wavefront, plan_wavefronts
from torch_radbp.film.window import Window
from torch_radbp.jit.cpu.kernel_code import Ahead
from torch_radbp.rendering.cost import Request, check_cost, lanes_of_chunks, recorded_lanes, traced_together


class LanePlan(NamedTuple):
    """The division of a call's lanes into chunks and wavefronts."""

    grids: list[tuple[int, int]]  # columns and rows of pixels that have samples, of each image
    lanes: int  # of a chunk, at most
    most: int  # of a wavefront, at most
    together: bool  # see `RenderCall`

    def bounded(self, lanes: int) -> LanePlan:
        """The plan with chunks and wavefronts of at most `lanes` lanes."""
        return self._replace(lanes=lanes, most=min(lanes, self.most))


def plan_lanes(windows: Sequence[Window], rr_depth: int, request: Request) -> LanePlan:
    """Plans the chunks and wavefronts of a call, and says how many paths code is compiled for.

    Args:
        windows: of its images.
        rr_depth: scattering events before Russian roulette.
        request: the call; its `chunk` is what the user asks for, None where that is picked here.

    Raises:
        ValueError: for more than this machine can do.
    """
    device, dtype, adjoint, spp = request.device, request.dtype, request.adjoint, request.spp
    grids = [(window.columns.sampled, window.rows.sampled) for window in windows]
    about = lanes_of_chunks(device, dtype, request.workers, request.compiled, request.media)
    if adjoint is not None and device.type == "cpu":
        about = min(about, recorded_lanes(adjoint, request.max_depth, rr_depth, dtype))
    lanes, most = request.chunk or fair_chunk(grids, spp, request.workers, about), request.chunk or about
    paths = spp * sum(columns * rows for columns, rows in grids)
    Ahead.are(paths)
    # Eager operations round the last lanes of a wavefront otherwise: an image would depend on what is differentiated.
    apart = adjoint is not None and request.record_bytes == 0
    together = request.compiled and apart and 2 * paths <= (request.chunk or inf) and (
        traced_together(adjoint, paths, request.max_depth, rr_depth, dtype))
    most = max(lanes, min(most, paths)) if request.compiled else lanes
    check_cost(request._replace(chunk=most))
    # For the same reason: an image would depend on what is seen beside it.
    return LanePlan(grids, lanes, most if request.compiled else 1, together)


def wavefronts_of(views: Sequence[View], plan: LanePlan, spp: int, workers: int) -> list[Wavefront]:
    """The wavefronts of a call: views of one chunk each are traced together if their cameras are alike.

    Args:
        views: of the call.
        plan: of its lanes.
        spp: samples of a pixel.
        workers: that trace wavefronts side by side.
    """
    chunks = plan_chunks(plan.grids, spp, plan.lanes, workers)
    counts = Counter(chunk.sensor for chunk in chunks)

    def alike(chunk: Chunk) -> Hashable:
        view = views[chunk.sensor]
        return None if counts[chunk.sensor] > 1 or view.clips else view.camera.kind

    return plan_wavefronts(chunks, alike, plan.most, workers)
