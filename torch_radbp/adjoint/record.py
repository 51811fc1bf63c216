"""Traces chunks, and keeps of their paths what the backward pass will need."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from threading import Lock

from torch import Tensor

from torch_radbp.adjoint.sweep import PathRecord
from torch_radbp.path.bounce import CameraSample
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.state import PathState
from torch_radbp.path.wavefront import Step, trace, walk
from torch_radbp.record import joined, leaves_of, rows_between
from torch_radbp.rendering.call.chunks import Chunk
from torch_radbp.rendering.call.pixels import deposit, weighted
from torch_radbp.rendering.call.render_call import (
    RenderCall,
    camera_samples,
    integrand_of,
    start_paths,
    started,
)
from torch_radbp.sampling.sampler import SampleKey
from torch_radbp.vec import Vec3


def trace_chunk(call: RenderCall, integrand: Integrand, chunk: Chunk, key: SampleKey, record: bool,
                tracer: Callable = trace) -> tuple[Tensor, PathRecord]:
    """What the lanes count in pixels, as of `deposit`, and what the backward pass will need of them."""
    samples, recorder = camera_samples(call, chunk, key), Recorder(call.adjoint, integrand.max_depth)
    L = tracer(integrand_of(call, integrand, chunk), started(call, samples), recorder.visit if record else None)
    radiance = L if record and call.adjoint.keep_radiance else None
    return (deposit(call, chunk, weighted(L, samples.weight), samples.place),
            recorder.record(partial(start_paths, call, chunk, key), radiance, samples))


def trace_both(call: RenderCall, integrand: Integrand, chunk: Chunk) -> tuple[Tensor, PathRecord]:
    """What `trace_chunk` gives for the samples of the image and `record_chunk` for those of the derivative, traced as one
    wavefront."""
    of_image, of_derivative = call.views[chunk.sensor].sample_keys
    image, derivative = (camera_samples(call, chunk, key) for key in (of_image, of_derivative))
    recorder = Recorder(call.adjoint, integrand.max_depth)
    integrand = integrand_of(call, integrand, chunk)._replace(differentiated=chunk.lanes)
    L = trace(integrand, started(call, joined([derivative, image])), recorder.visit)
    radiance = weighted(rows_between(L, chunk.lanes, 2 * chunk.lanes), image.weight)
    return (deposit(call, chunk, radiance, image.place),
            recorder.record(partial(start_paths, call, chunk, of_derivative), None, derivative))


def record_chunk(call: RenderCall, integrand: Integrand, chunk: Chunk, key: SampleKey) -> PathRecord:
    """What the backward pass needs of a chunk's paths, without their radiance unless the strategy asks for it."""
    if call.adjoint.keep_radiance:
        return trace_chunk(call, integrand, chunk, key, record=True)[1]
    samples, recorder = camera_samples(call, chunk, key), Recorder(call.adjoint, integrand.max_depth)
    walk(integrand_of(call, integrand, chunk), started(call, samples), recorder.visit)
    return recorder.record(partial(start_paths, call, chunk, key), None, samples)


class Recorder:
    """Keeps what a strategy asks for of the bounces that it is shown, until there are `most`."""

    def __init__(self, strategy, most: int):
        self.strategy, self.most, self.bounces = strategy, most, 0
        self.states: dict[int, PathState] = {}
        self.steps: dict[int, Step] = {}

    def visit(self, depth: int, state: PathState, step: Step) -> None:
        self.bounces = depth + 1
        kept = self.strategy.kept(self.bounces, self.most)
        self.states[depth] = state
        for known in [known for known in self.states if known not in kept or (known == 0 and len(kept) < self.bounces)]:
            del self.states[known]  # also of camera paths, which are made again, unless all others are kept
        if self.strategy.keep_hits:
            self.steps[depth] = step

    def record(self, start: Callable[[], PathState], radiance: Vec3 | None, samples: CameraSample) -> PathRecord:
        return PathRecord(start, radiance, self.states, self.steps, self.bounces, samples.weight, samples.place)


class Allowance:
    """The bytes of records that are still to be kept, of chunks that are traced side by side."""

    def __init__(self, count: float):
        self.left, self.lock = count, Lock()

    def covers(self, record: PathRecord) -> bool:
        """True if a record is to be kept, which is then counted."""
        size = sum(item.nbytes for item in leaves_of(record) if isinstance(item, Tensor))
        with self.lock:
            self.left -= size
            return self.left >= 0
