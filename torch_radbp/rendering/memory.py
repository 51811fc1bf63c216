"""Predicts the memory of a rendering with its backward pass, and picks a chunk size and stride that fit a budget.

Dead lanes leave the wavefront, so that the need depends on the scene: a pilot of a few thousand paths tells how many lanes
reach each depth, and one of its bounces what a lane needs while it is computed (`bounce_memory.py`). What is counted: the
states and hits that the forward pass keeps for the backward pass, and the working memory of the bounce that is being
computed, or of the places at which images jump, with the allocator's waste; tables that each call packs anew, since they
have derivatives. What is not counted: the rest of the scene and compiled code.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Iterator, Sequence
from math import inf
from typing import NamedTuple

import torch

from torch_radbp.adjoint.bounce import Memo, empty_memo
from torch_radbp.adjoint.kept_state import part_kept
from torch_radbp.adjoint.memoized import MemoizedAdjoint
from torch_radbp.adjoint.outside import HELD
from torch_radbp.adjoint.scatter import workers_beside
from torch_radbp.adjoint.strategy import AdjointStrategy
from torch_radbp.path.camera_rays import CameraSample
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.state import PathState, start_path
from torch_radbp.path.step import Onward, Step
from torch_radbp.path.trace import walk
from torch_radbp.path.wavefront import take_step
from torch_radbp.raycast.protocol import Hit
from torch_radbp.rendering.bounce_memory import BounceMemory, LinearSize
from torch_radbp.sampling.sampler import LaneKey
from torch_radbp.tensors.record import tensors_in
from torch_radbp.tensors.vec import Ray, Vec2, Vec3

# Resident memory is more than what torch holds: by this factor, and by so many numbers a lane. The factor counts where
# every operation takes memory and gives it back, and where chunks follow each other, whose records do not fit the holes
# that the last ones have left. See `python -m benchmarks.memory`.
WASTE, SPARE = 1.75, 50
COMPILED = 0.3  # of the working memory of an eager adjoint,
WASTE_COMPILED, SPARE_COMPILED = 1.25, 20  # and of its waste
# Of the same without spare numbers, what launches of a GPU take: on the way back where records say what was decided, and on
# the way there, when nothing is kept yet but light is looked for. See `python -m benchmarks.lane_bytes`.
LAUNCHED_BACK, LAUNCHED_THERE = 0.95, 1.65

# Numbers per lane that a bounce, its adjoint and autograd's tape need at least: those of diffuse surfaces.
LEAST_BOUNCE, LEAST_ADJOINT, LEAST_TAPE = 74, 60, 32

SMALLEST_CHUNK = 1 << 12
MIB = 1 << 20
UNITS = {"B": 1, "KiB": 1 << 10, "MiB": MIB, "GiB": 1 << 30, "TiB": 1 << 40, "kB": 10**3, "MB": 10**6, "GB": 10**9,
         "TB": 10**12}


class RecordSizes(NamedTuple):
    """Bytes of a lane in the path records of a call."""

    state: int  # `PathState`
    kept: int  # of that what is kept if no bounce is replayed
    step: int  # `Step`
    memo: int  # `Memo`


class MemoryPlan(NamedTuple):
    """A choice of chunk and strategy, with the bytes that it is predicted to need at its peak."""

    chunk: int  # lanes
    adjoint: AdjointStrategy
    retrace: bool  # the backward pass traces paths again, of which no records are kept
    kept: int  # bytes between forward and backward pass
    working: int  # bytes on top of that while a chunk is processed

    @property
    def peak(self) -> int:
        """Predicted bytes at the worst moment."""
        return self.kept + self.working


def parse_budget(budget: str | int | float) -> int:
    """Returns the bytes of a number, or of a string such as "2GiB", "2 GB" or "1.5gb": 2 GiB are 2^31, 2 GB 2 * 10^9 bytes.

    Raises:
        ValueError: if it cannot be read, or is less than a byte.
    """
    match = re.fullmatch(r"\s*([0-9.]+(?:e[0-9]+)?)\s*([a-z]*)\s*", str(budget), re.IGNORECASE)
    factors = {unit.lower(): factor for unit, factor in UNITS.items()} | {"": 1}
    try:
        size = float(match[1]) * factors[match[2].lower()]
    except (TypeError, ValueError, KeyError):
        size = -1.0
    if isinstance(budget, bool) or not 1 <= size < float("inf"):
        raise ValueError(f"memory_budget must be a number of bytes or a string such as '2GiB' or '2GB' "
                         f"({', '.join(UNITS)}), got {budget!r}")
    return int(size)


def reaching(integrand: Integrand, pilot: PathState) -> list[float]:
    """The fraction of camera paths that reach each depth, estimated by pilot paths."""
    counts: list[int] = []
    with torch.no_grad():
        walk(integrand, Onward(pilot, None), lambda depth, state, step: counts.append(len(state.lane)))
    return [count / max(1, len(pilot.lane)) for count in counts] or [0.0]


def lane_bytes(record) -> int:
    """The bytes that one lane takes in a record of tensors."""
    return sum(tensor.element_size() for tensor in tensors_in(record))


def record_sizes(integrand: Integrand, pilot: PathState, triangles: bool) -> RecordSizes:
    """The record sizes of a call, measured on one bounce of pilot paths.

    Args:
        integrand: of the detached scene.
        pilot: the paths.
        triangles: whether the backward pass carries adjoints of triangles from vertex to vertex.
    """
    with torch.no_grad():
        step = take_step(integrand, pilot, 0)[-1]
    most = max(step.texture_values, key=lane_bytes)  # each lane is in one queue
    step = step._replace(texture_values=(most,))
    memo = empty_memo(pilot.pdf, integrand.settings.moving, triangles, integrand.scene)
    return RecordSizes(*map(lane_bytes, (pilot, part_kept(integrand, pilot), step, memo)))


@functools.lru_cache
def least_records(dtype: torch.dtype) -> RecordSizes:
    """The record sizes of the simplest scene, in which nothing moves."""
    number, index, flag = (torch.empty(0, dtype=kind, device="cpu") for kind in (dtype, torch.int32, torch.bool))
    ray = Ray(Vec3.buffer(number), Vec3.buffer(number))
    state = start_path(CameraSample(ray, LaneKey(index, index), weight=None, cone=None, place=None))
    step = Step(Hit(index, number, number, number), None, index, (), flag, flag)
    kept = state._replace(ray=state.ray._replace(o=None), key=None)
    return RecordSizes(*map(lane_bytes, (state, kept, step, Memo(Vec3.buffer(number)))))


class Workload(NamedTuple):
    """The work of a call, by which its memory is predicted for any chunk size and strategy of the backward pass."""

    fractions: list[float]  # of camera paths that reach each depth
    lanes: int  # of the whole call: sensors x pixels x samples
    max_depth: int  # greatest number of bounces
    dtype: torch.dtype  # of the scene
    compiled: bool = False  # True if bounces are compiled
    workers: int = 1  # chunks that are traced side by side
    moving: bool = False  # True if rays carry derivatives
    records: RecordSizes | None = None  # None: the least sizes
    images: int = 0  # bytes of the images, of their sums and of their gradients
    measured: BounceMemory | None = None  # of a bounce; None: the least sizes
    least: int = 1  # least lanes of a chunk
    row: int = 1  # lanes of a row of pixels
    jumps: int = 0  # bytes of discontinuity curves and samples on them; 0: no boundary terms
    launched: bool = False  # True if bounces are launches of a GPU, whose results have room for all lanes
    most: int = 1 << 62  # lanes of a chunk
    together: bool = False  # True if image and derivative are traced as one, and all is recorded

    @property
    def bounce_memory(self) -> BounceMemory:
        if self.measured is not None:
            return self.measured
        least = (LinearSize(numbers * self.dtype.itemsize, 0.0) for numbers in (LEAST_BOUNCE, LEAST_ADJOINT, LEAST_TAPE))
        return BounceMemory(*least)


def predict(work: Workload, chunk: int, adjoint: AdjointStrategy, record_bytes: float = inf) -> MemoryPlan:
    """Predicts the bytes of a forward and backward pass.

    Args:
        work: of the call.
        chunk: lanes traced together.
        adjoint: the strategy.
        record_bytes: that are kept between the passes at most.
    """
    fractions, lanes, dtype = work.fractions, work.lanes, work.dtype
    state, part, step, memo = least_records(dtype) if work.records is None else work.records
    radiance, place = (len(kind._fields) * dtype.itemsize for kind in (Vec3, Vec2))
    chunk = min(max(chunk, work.least), lanes)
    together = min(lanes, work.workers * chunk)  # lanes that are worked on at a time
    bounces = len(fractions)
    bounce, sweep, tape, outside, at_once, held_back, tables = work.bounce_memory
    if adjoint.taped:
        kept = int(lanes * WASTE * tape.per_lane + tape.fixed)
        working = max(together * (WASTE * bounce.per_lane + SPARE * dtype.itemsize), work.jumps)
        return MemoryPlan(chunk, adjoint, False, kept, int(working) + work.images)
    depths = adjoint.kept(bounces, work.max_depth)
    per_lane = max(states_kept(adjoint, taken, work) for taken in range(1, bounces + 1))
    per_lane *= part if adjoint.records_all else state
    per_lane += len(LaneKey._fields) * torch.int32.itemsize  # of the start
    per_lane += sum(fractions) * step * adjoint.keep_hits + radiance * adjoint.keep_radiance + place
    replayed = adjoint.replayed(fractions, depths, work.moving) * state
    held = radiance + memo + state + step * (not adjoint.keep_hits)
    share, waste, spare = (COMPILED, WASTE_COMPILED, SPARE_COMPILED) if work.compiled else (1.0, WASTE, SPARE)
    spare = 0 if work.launched else spare
    busy = waste * max(share * sweep.per_lane + held, share * bounce.per_lane) + spare * dtype.itemsize
    # A chunk of few rows is not like the image: measured, up to half of its lanes meet more than in the mean.
    unlike = 1.0 + 1.0 / (1.0 + chunk / work.row)
    there = LAUNCHED_THERE * busy if work.launched else 0.0
    busy *= LAUNCHED_BACK if work.launched and adjoint.keep_hits else 1.0
    working = together * unlike * (busy * max(fractions) + replayed) + work.workers * sweep.fixed
    working += work.workers * (WASTE * outside.per_lane * min(chunk, at_once) + outside.fixed)
    # Adjoints that are held back, once more where they are joined; lanes are of the image, or of the derivative.
    working += work.workers * WASTE * 2 * held_back * min(HELD, 2 * chunk * sum(fractions))
    working = max(working, WASTE * tables.packing)
    if work.jumps:  # paths beside curves are traced as the others are
        working = max(working, work.jumps + together * unlike * waste * share * bounce.per_lane)
    working += workers_beside(work.workers, tables.totals) * tables.totals + tables.packed
    # What is traced again is recorded chunk by chunk; and what is kept, chunk by chunk, too.
    kept = min(lanes * per_lane, max(record_bytes, together * per_lane))
    retrace = kept < lanes * per_lane
    kept = WASTE * kept if retrace and not work.launched else kept  # a card's allocator fills the holes of other chunks
    working = max(working, together * unlike * there * max(fractions) - kept)
    return MemoryPlan(chunk, adjoint, retrace, int(kept), int(working) + work.images)


def predict_all(works: Sequence[Workload], chunk: int, adjoint: AdjointStrategy, record_bytes: float = inf) -> MemoryPlan:
    """Predicts the bytes of several works one after the other: paths from the camera, and paths from lamps.

    What is kept for the derivative, and the images, add up; `working` is that of the largest work.
    """
    plans, images = [], sum(work.images for work in works)
    for work in works:
        if work.together:  # lanes of image and derivative, and all that is recorded
            plan = predict(work._replace(lanes=2 * work.lanes), 2 * min(chunk, work.most), adjoint, inf)
        else:
            plan = predict(work, min(chunk, work.most), adjoint, record_bytes)
        plans.append(plan._replace(working=plan.working + images - work.images))
    worst = max(plans, key=lambda plan: plan.peak)._replace(chunk=chunk, retrace=any(plan.retrace for plan in plans))
    if record_bytes == 0 and not adjoint.taped:  # records are made for one wavefront after the other
        return worst
    return worst._replace(kept=sum(plan.kept for plan in plans), working=max(plan.working for plan in plans))


def states_kept(adjoint, bounces: int, work: Workload) -> float:
    """The mean number of states kept of a camera path after `bounces` bounces; the first counts only if all are kept, else
    camera rays are made again."""
    depths = adjoint.kept(bounces, work.max_depth)
    return sum(work.fractions[depth] for depth in depths if depth > 0 or len(depths) == bounces)


def _candidates(chunk: int, adjoint: AdjointStrategy | None,
                shares_samples: bool) -> Iterator[tuple[int, AdjointStrategy, float]]:
    """Yields chunk, strategy and record bytes to try, from the fastest to the most frugal.

    Smaller chunks cost little, replayed bounces more, and tracing all paths again most.
    """
    strategies = [MemoizedAdjoint(stride) for stride in (1, 2, 4, 8, "sqrt", "log")] if adjoint is None else [adjoint]
    for record_bytes in (inf, 0.0) if shares_samples else (0.0,):
        for strategy in strategies:
            if record_bytes == 0 and shares_samples and strategy.taped:
                continue
            lanes = chunk
            while lanes >= SMALLEST_CHUNK:
                yield lanes, strategy, record_bytes
                lanes //= 2


def bytes_text(count: float) -> str:
    """A number of bytes as text, in binary units."""
    unit = max((unit for unit in UNITS if UNITS[unit] <= count and len(unit) != 2), key=UNITS.get, default="B")
    return f"{count / UNITS[unit]:.3g} {unit}"


def plan_memory(budget: int, works: Sequence[Workload], chunk: int, adjoint: AdjointStrategy | None = None,
                shares_samples: bool = True) -> MemoryPlan:
    """Picks the fastest chunk size and strategy that fit `budget` bytes.

    Args:
        budget: bytes.
        works: what is to be done, one after the other.
        chunk: the largest to try, lanes.
        adjoint: the strategy if the user chose one: then only the chunk is planned; else None.
        shares_samples: image and derivative have the same samples, so that something may be kept of them.

    Raises:
        ValueError: if nothing fits; the message says how much the most frugal plan needs.
    """
    plans = [predict_all(works, size, strategy, record_bytes)
             for size, strategy, record_bytes in _candidates(max(chunk, SMALLEST_CHUNK), adjoint, shares_samples)]
    fitting = next((plan for plan in plans if plan.peak <= budget), None)
    if fitting is None:
        least = min(plans, key=lambda plan: plan.peak)
        raise ValueError(f"memory_budget of {bytes_text(budget)} is too small: the most frugal plan "
                         f"({least.adjoint}, chunk={least.chunk}) needs {bytes_text(least.peak)}")
    return fitting
