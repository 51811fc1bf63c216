"""Traces wavefronts, and records what the backward pass needs."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from threading import Lock

import torch
from torch import Tensor

from torch_radbp.adjoint.kept_state import part_kept
from torch_radbp.adjoint.sweep import PathRecord
from torch_radbp.call.pixels import weighted
from torch_radbp.call.render_call import (
    RenderCall,
    camera_samples,
    integrand_of_wavefront,
    samples_of_chunks,
    start_paths,
    started,
)
from torch_radbp.call.wavefronts import Wavefront
from torch_radbp.jit.tiles import TILE
from torch_radbp.path.camera_rays import CameraSample
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.state import PathState
from torch_radbp.path.step import Onward, Step
from torch_radbp.path.taped_bounces import Bounce
from torch_radbp.path.through_media import free_flights
from torch_radbp.path.trace import trace, trace_to_film, walk
from torch_radbp.path.wavefront import bounced
from torch_radbp.path.whole_paths import goes_whole
from torch_radbp.raycast.protocol import Hit
from torch_radbp.tensors.differentiated import any_differentiated, detached
from torch_radbp.tensors.record import joined, leaves_of, rows_between
from torch_radbp.tensors.vec import Vec3
from torch_radbp.threads.team import each, threads

MANY = 2 * TILE  # lanes of an image from which on those of its derivative are traced apart, at the same time


def trace_wavefront(call: RenderCall, integrand: Integrand, wavefront: Wavefront, which: int, record: bool,
                    bounce: Bounce = bounced) -> tuple[list[Tensor], PathRecord]:
    """Traces a wavefront: its contributions to the sink, as of `Sink.deposit`, and the record for its backward pass.

    Args:
        which: 0 for the samples of the image, 1 for those of its derivative.
        record: whether anything is kept for the backward pass.
        bounce: takes one bounce.
    """
    samples, recorder = camera_samples(call, wavefront, which), Recorder(call.adjoint, integrand.bounces, record)
    integrand, bounce = integrand_of_wavefront(call, integrand, wavefront, which), recorder.bounce if record else bounce
    if call.sink.at_vertices:
        deposits, hit = call.sink.deposits(call), None
        if integrand.settings.moving and (integrand.attached or any_differentiated((samples.ray, samples.power))):
            still = integrand.still()
            hit = still.caster.intersect(detached(samples.ray))
            behind, _ = free_flights(still, started(call, samples), hit, 0)
            samples = joined([call.source.glued(chunk, which, integrand.scene, rows_between(behind, first, last))
                              for chunk, first, last in wavefront.parts()])
        trace_to_film(integrand, started(call, samples), deposits.add, recorder.visit if record else None, bounce, hit)
        return [deposits.total()], recorder.record(partial(start_paths, call, wavefront, which), None, samples)
    asked = record or call.quantities is not None  # of the quantities some ask for what camera rays meet
    L = trace(integrand, started(call, samples), recorder.visit if asked else None, bounce=bounce)
    radiance = L if record and call.adjoint.keep_radiance else None
    return (call.sink.deposit(call, wavefront, _shown(call, integrand, samples, recorder.hit, L), samples),
            recorder.record(partial(start_paths, call, wavefront, which), radiance, samples))


def trace_both(call: RenderCall, integrand: Integrand, wavefront: Wavefront) -> tuple[list[Tensor], PathRecord]:
    """Traces the samples of the image and, together with them, those of its derivative; results as of `trace_wavefront`."""
    recorder = Recorder(call.adjoint, integrand.bounces)
    integrand = integrand_of_wavefront(call, integrand, wavefront)
    # Through media that scatter the paths of image and derivative are sampled otherwise.
    apart = bool(integrand.proposal.layout.scattering_media) or (
        wavefront.lanes >= MANY and call.quantities is None and goes_whole(integrand, wavefront.lanes))
    traced = traced_apart if apart else traced_as_one
    image, derivative, hit, L = traced(call, integrand, wavefront, recorder)
    return (call.sink.deposit(call, wavefront, _shown(call, integrand, image, hit, L), image),
            recorder.record(partial(start_paths, call, wavefront, 1), None, derivative))


def traced_apart(call: RenderCall, integrand: Integrand, wavefront: Wavefront,
                 recorder: Recorder) -> tuple[CameraSample, CameraSample, Hit | None, Vec3]:
    """Traces the image's samples and the derivative's paths in two threads.

    Returns:
        The first rays of both; the image's first hits, None unless AOVs need them; and the image's radiance.
    """
    seen_first = Recorder(call.adjoint, integrand.bounces, keeping=False)

    def image() -> tuple[CameraSample, Vec3]:
        samples = camera_samples(call, wavefront, 0)
        return samples, trace(integrand, started(call, samples), None if call.quantities is None else seen_first.visit)

    def derivative() -> CameraSample:
        samples = camera_samples(call, wavefront, 1)
        walk(integrand_of_wavefront(call, integrand, wavefront, 1), Onward(started(call, samples), None), recorder.visit,
             bounce=recorder.bounce)
        return samples

    (seen, L), differentiated = each(lambda side: side(), (image, derivative), threads())
    return seen, differentiated, seen_first.hit, L


def traced_as_one(call: RenderCall, integrand: Integrand, wavefront: Wavefront,
                  recorder: Recorder) -> tuple[CameraSample, CameraSample, Hit | None, Vec3]:
    """Traces the samples of image and derivative as one wavefront: rays of both, and the image's hits and radiance."""
    image, derivative = (samples_of_chunks(call, wavefront, which) for which in (0, 1))
    lanes = wavefront.lanes
    both = joined([samples._replace(weight=None, place=None) for samples in (*derivative, *image)])
    image, derivative = (rows_between(both, first, first + lanes)._replace(
        weight=joined([samples.weight for samples in own]), place=joined([samples.place for samples in own]))
        for first, own in ((lanes, image), (0, derivative)))
    integrand = integrand._replace(differentiated=both.ray.d.x.new_full((), lanes, dtype=torch.int32))
    L = trace(integrand, started(call, both), recorder.visit, bounce=recorder.bounce)
    hit, L = (rows_between(part, lanes, 2 * lanes) for part in (recorder.hit, L))
    return image, derivative, hit, L


def _shown(call: RenderCall, integrand: Integrand, samples: CameraSample, hit: Hit | None, L: Vec3) -> list[Tensor]:
    """The radiance of an image's lanes, weighted by the camera, and the values of AOVs beside it.

    Args:
        samples: their camera rays.
        hit: what these hit; None: there are no bounces.
        L: their radiance.
    """
    if call.quantities is None:
        return list(weighted(L, samples.weight))
    with torch.no_grad():
        still = integrand.still()
        found = call.quantities(still, detached(started(call, samples)), hit, detached(L))
    return [value if samples.weight is None else value * samples.weight for value in (*L, *found)]


def record_wavefront(call: RenderCall, integrand: Integrand, wavefront: Wavefront) -> PathRecord:
    """Records a wavefront's paths for the backward pass, without radiance unless the strategy needs it."""
    if call.adjoint.keep_radiance:
        return trace_wavefront(call, integrand, wavefront, 1, record=True)[1]
    samples, recorder = camera_samples(call, wavefront, 1), Recorder(call.adjoint, integrand.bounces)
    walk(integrand_of_wavefront(call, integrand, wavefront, 1), Onward(started(call, samples), None), recorder.visit,
         bounce=recorder.bounce)
    return recorder.record(partial(start_paths, call, wavefront, 1), None, samples)


def bounced_in_part(integrand: Integrand, onward: Onward, depth: int, L: Vec3 | None) -> tuple[PathState, Step, Onward]:
    """Takes a bounce as `bounced` does, but returns only the part of the path states that the backward pass reads."""
    state, step, onward = bounced(integrand, onward, depth, L)
    return part_kept(integrand, state), step, onward


class Recorder:
    """Records first hits, and states and steps of bounces as the adjoint strategy needs them, of at most `most` bounces.

    Args:
        keeping: False: no bounce is recorded.
    """

    def __init__(self, strategy, most: int, keeping: bool = True):
        self.strategy, self.most, self.keeping, self.bounces = strategy, most, keeping, 0
        self.hit: Hit | None = None  # of camera rays
        self.states: dict[int, PathState] = {}
        self.steps: dict[int, Step] = {}

    @property
    def bounce(self) -> Bounce:
        """The function that takes each bounce; its path states hold only what the strategy needs."""
        return bounced_in_part if self.keeping and self.strategy.records_all else bounced

    def visit(self, depth: int, state: PathState, step: Step) -> None:
        if depth == 0:
            self.hit = step.hit
        if not self.keeping:
            return
        self.bounces = depth + 1
        kept = self.strategy.kept(self.bounces, self.most)
        self.states[depth] = state
        for known in [known for known in self.states if known not in kept or (known == 0 and len(kept) < self.bounces)]:
            del self.states[known]  # also of camera paths, which are made again, unless all others are kept
        if self.strategy.keep_hits:
            self.steps[depth] = step

    def record(self, start: Callable[[], PathState], radiance: Vec3 | None, samples: CameraSample) -> PathRecord:
        return PathRecord(start, radiance, self.states, self.steps, self.bounces, samples.weight, samples.place, samples.key)


class Allowance:
    """The remaining bytes for path records, shared by wavefronts that are traced in parallel."""

    def __init__(self, count: float):
        self.left, self.lock = count, Lock()

    def covers(self, record: PathRecord) -> bool:
        """True if a path record still fits the memory limit; its bytes are then counted."""
        size = sum(item.nbytes for item in leaves_of(record) if isinstance(item, Tensor))
        with self.lock:
            self.left -= size
            return self.left >= 0
