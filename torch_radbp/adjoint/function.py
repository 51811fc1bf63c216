"""The one `torch.autograd.Function`: from the leaves of `SceneTensors` to images."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial, wraps
from itertools import groupby
from threading import Lock
from typing import NamedTuple, TypeVar

import torch
from torch import Tensor

from torch_radbp.adjoint.bounce import Memo, vector_jacobian_product, zeros_unless
from torch_radbp.adjoint.chunks import Chunk
from torch_radbp.adjoint.finite import (
    CheckedSweep,
    Finding,
    NonFiniteError,
    checked_stages,
    count_of_bad,
    finite,
    gradient_error,
    image_error,
)
from torch_radbp.adjoint.scatter import Gradients, gradients_of
from torch_radbp.adjoint.sweep import PathRecord, Sweep
from torch_radbp.adjoint.workers import in_turns
from torch_radbp.differentiated import detached, differentiable
from torch_radbp.entry import entry
from torch_radbp.integrand import Integrand, Stages
from torch_radbp.jit.torch_internals import batched
from torch_radbp.path import CameraSample
from torch_radbp.path_state import PathState, start_path
from torch_radbp.raycast import RayCaster
from torch_radbp.record import joined, leaves_of, rows_between, with_leaves
from torch_radbp.sampling.sampler import SampleKey
from torch_radbp.scene import Scene
from torch_radbp.scene.tensors import SceneTensors
from torch_radbp.vec import Vec3
from torch_radbp.view import View
from torch_radbp.wavefront import Step, trace, walk

Result = TypeVar("Result")
SAVED = object()  # stands for a tensor that autograd keeps


class RenderCall(NamedTuple):
    """All that one rendering needs beside the scene's leaves."""

    scene: SceneTensors
    caster: RayCaster | None  # of its triangles; as the next one, None where the integrand is made
    make_integrand: Callable[[SceneTensors], Integrand] | None
    stages: Stages
    adjoint: object  # the strategy
    views: list[View]
    chunks: list[Chunk]
    spp: int
    shares_samples: bool  # the backward pass differentiates the very samples of the image
    record_bytes: float  # of these that are kept for it at most; it traces the others again
    together: bool  # samples of its own are traced beside those of the image, which takes half as many calls
    workers: int  # chunks that are traced side by side
    following: bool = False  # see `Settings.following`
    module: Scene | None = None  # whose tensors these are; gives names to errors
    parameters: dict[str, Tensor] = {}  # by name, those that derivatives are wanted of

    def still(self) -> RenderCall:
        """The call without derivatives."""
        return self._replace(scene=detached(self.scene), views=[detached(view) for view in self.views])

    def of_derivative(self) -> RenderCall:
        """The call whose image has the samples of the derivative."""
        return self._replace(views=[view._replace(sample_keys=view.sample_keys[1:] * 2) for view in self.views])


def start_paths(call: RenderCall, chunk: Chunk, key: SampleKey) -> PathState:
    """The camera paths of a chunk, pixel by pixel."""
    return started(call, camera_samples(call, chunk, key))


def started(call: RenderCall, sample: CameraSample) -> PathState:
    """The paths that begin with camera rays."""
    return start_path(sample.ray, sample.key, call.scene.lights.by_place, call.following, sample.cone)


def camera_samples(call: RenderCall, chunk: Chunk, key: SampleKey) -> CameraSample:
    """The rays of a chunk's lanes; see `sample_camera`."""
    device = call.scene.device
    pixel = chunk.pixels.index(device).repeat_interleave(chunk.samples)
    sample = torch.arange(chunk.samples, dtype=torch.int32, device=device) + chunk.first_sample
    view = call.views[chunk.sensor]
    width = torch.full((), view.width, dtype=torch.int32, device=device)
    return call.stages.sample_camera(view.camera, width, pixel, sample.repeat(chunk.pixels.count), key,
                                     call.scene.layout.traces_cones)


def pilot_paths(call: RenderCall, lanes: int) -> PathState:
    """Some camera paths of the first sensor, spread over its image."""
    view, device = call.views[0], call.scene.device
    pixel = torch.linspace(0, view.width * view.height - 1, lanes, dtype=torch.float64, device=device).to(torch.int32)
    sample = torch.arange(lanes, dtype=torch.int32, device=device)
    width = torch.full((), view.width, dtype=torch.int32, device=device)
    return started(call, call.stages.sample_camera(view.camera, width, pixel, sample, view.sample_keys[0],
                                                   call.scene.layout.traces_cones))


def integrand_of(call: RenderCall, integrand: Integrand, chunk: Chunk) -> Integrand:
    """The integrand as the camera of a chunk sees it."""
    view = call.views[chunk.sensor]
    return integrand._replace(clipping=view.camera if view.clips else None)


def trace_chunk(call: RenderCall, integrand: Integrand, chunk: Chunk, key: SampleKey, record: bool,
                tracer: Callable = trace) -> tuple[Vec3, PathRecord]:
    """What counts of each lane's radiance, and what the backward pass will need of it."""
    samples, recorder = camera_samples(call, chunk, key), Recorder(call.adjoint, integrand.max_depth)
    L = tracer(integrand_of(call, integrand, chunk), started(call, samples), recorder.visit if record else None)
    radiance = L if record and call.adjoint.keep_radiance else None
    return weighted(L, samples.weight), recorder.record(partial(start_paths, call, chunk, key), radiance, samples.weight)


def trace_both(call: RenderCall, integrand: Integrand, chunk: Chunk) -> tuple[Vec3, PathRecord]:
    """What `trace_chunk` gives for the samples of the image and `record_chunk` for those of the derivative, traced as one
    wavefront."""
    of_image, of_derivative = call.views[chunk.sensor].sample_keys
    image, derivative = (camera_samples(call, chunk, key) for key in (of_image, of_derivative))
    recorder = Recorder(call.adjoint, integrand.max_depth)
    integrand = integrand_of(call, integrand, chunk)._replace(differentiated=chunk.lanes)
    L = trace(integrand, started(call, joined([derivative, image])), recorder.visit)
    return (weighted(rows_between(L, chunk.lanes, 2 * chunk.lanes), image.weight),
            recorder.record(partial(start_paths, call, chunk, of_derivative), None, derivative.weight))


def record_chunk(call: RenderCall, integrand: Integrand, chunk: Chunk, key: SampleKey) -> PathRecord:
    """What the backward pass needs of a chunk's paths, without their radiance unless the strategy asks for it."""
    if call.adjoint.keep_radiance:
        return trace_chunk(call, integrand, chunk, key, record=True)[1]
    samples, recorder = camera_samples(call, chunk, key), Recorder(call.adjoint, integrand.max_depth)
    walk(integrand_of(call, integrand, chunk), started(call, samples), recorder.visit)
    return recorder.record(partial(start_paths, call, chunk, key), None, samples.weight)


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

    def record(self, start: Callable[[], PathState], radiance: Vec3 | None, weight: Tensor | None) -> PathRecord:
        return PathRecord(start, radiance, self.states, self.steps, self.bounces, weight)


def weighted(L: Vec3, weight: Tensor | None) -> Vec3:
    """What counts of the lanes' radiance, or of its adjoint."""
    return L if weight is None else L * weight


def pixel_sums(chunk: Chunk, values: Iterable[Tensor]) -> Tensor:
    """(C, pixels) the sums over the lanes of each pixel of a chunk, of each of C values."""
    return sums_in_pairs(torch.stack([value.reshape(chunk.pixels.count, chunk.samples) for value in values]))


def sums_in_pairs(terms: Tensor) -> Tensor:
    """Sums over the last dimension: of neighbours, of neighbouring pairs, of pairs of pairs, ...

    So that images do not depend on chunks: the same blocks are summed in the same order in all of them.
    """
    while terms.shape[-1] > 1:
        even, odd = terms[..., ::2], terms[..., 1::2]
        both = odd.shape[-1]
        terms = even + odd if both == even.shape[-1] else torch.cat([even[..., :both] + odd, even[..., both:]], -1)
    return terms.squeeze(-1)


def render_images(call: RenderCall, integrand: Integrand, record: bool,
                  tracer: Callable = trace) -> tuple[Tensor, list[PathRecord | None]]:
    """(B, 3, H, W) linear RGB, and the records of those chunks of which one is wanted and kept; None of the others."""
    allowance = Allowance(call.record_bytes if record else 0)

    def trace_one(chunk: Chunk) -> tuple[Tensor, PathRecord | None]:
        if record and call.together:
            L, path_record = trace_both(call, integrand, chunk)
            return pixel_sums(chunk, L), path_record
        keeping = allowance.left > 0
        L, path_record = trace_chunk(call, integrand, chunk, call.views[chunk.sensor].sample_keys[0], keeping, tracer)
        return pixel_sums(chunk, L), path_record if keeping and allowance.covers(path_record) else None

    sums, records = zip(*of_chunks(call, trace_one))
    images = assembled(call, sums)
    check_images(call, integrand, images.detach())
    return images, list(records)


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


def of_chunks(call: RenderCall, work: Callable[[Chunk], Result]) -> list[Result]:
    """`work` on every chunk, side by side; the results in the order of the chunks."""
    shares = in_turns(len(call.chunks), call.workers, lambda share: [work(call.chunks[index]) for index in share])
    return [shares[index % len(shares)][index // len(shares)] for index in range(len(call.chunks))]


def assembled(call: RenderCall, sums: Sequence[Tensor]) -> Tensor:
    """(B, C, H, W) the images whose chunks have these sums, (C, pixels) each."""
    view, channels = call.views[0], len(sums[0])
    images = [torch.zeros(channels, view.height * view.width, dtype=call.scene.dtype, device=call.scene.device)
              for _ in call.views]
    for (sensor, pixels), parts in groupby(zip(call.chunks, sums), lambda part: part[0][:2]):
        total = sums_in_pairs(torch.stack([own for _, own in parts], -1))
        images[sensor].index_copy_(1, pixels.index(total.device).long(), total / call.spp)
    # Stacked in their final shape: what is no view may be changed in place, also where gradients are wanted.
    return torch.stack([image.reshape(channels, view.height, view.width) for image in images])


def check_images(call: RenderCall, integrand: Integrand, images: Tensor) -> None:
    """Raises NonFiniteError if a pixel is NaN or infinite."""
    if finite([images]):
        return

    def trace_again(integrand: Integrand, finding: Finding) -> None:
        for chunk in call.chunks:
            if finding.depth is None:
                trace_chunk(call, integrand.with_stages(checked_stages(integrand.stages, finding)), chunk,
                            call.views[chunk.sensor].sample_keys[0], record=False)

    with torch.no_grad():
        call = call.still()
        raise image_error(images, integrand._replace(scene=integrand.proposal, parts={}), call.module, trace_again)


def lane_adjoint(call: RenderCall, chunk: Chunk, grad_images: Tensor) -> Vec3:
    """Derivative of the loss with respect to what counts of L_1 of each lane: a pixel is the mean of its samples."""
    gradient = grad_images[chunk.sensor].reshape(3, -1).index_select(1, chunk.pixels.index(grad_images.device)) / call.spp
    return Vec3(*(channel.repeat_interleave(chunk.samples) for channel in gradient))


def first_derivatives_only(backward: Callable) -> Callable:
    """A backward pass that refuses to be recorded, instead of giving gradients whose own derivative would be zero."""
    @wraps(backward)
    def refusing(ctx, *gradients: Tensor):
        if torch.is_grad_enabled():
            raise RuntimeError(
                "a rendering has first derivatives only, and its backward pass is being recorded (create_graph=True, a "
                "gradient penalty, torch.autograd.functional.hessian): render with adjoint=rb.TapeAdjoint(), which has "
                "second derivatives and holds all paths in memory, or leave the rendering out of what is recorded")
        if any(map(batched, gradients)):
            raise RuntimeError("the backward pass of a rendering takes one gradient of the image at a time, and a batch is "
                               "given (is_grads_batched=True, vectorize=True): call torch.autograd.grad for each, with "
                               "retain_graph=True, or take rb.jvp for derivatives of all pixels")
        return backward(ctx, *gradients)

    return refusing


class RenderFunction(torch.autograd.Function):
    """Images as a function of the scene's leaves, with memoized adjoint radiance as its derivative."""

    @staticmethod
    def forward(ctx, call: RenderCall, *leaves: Tensor) -> Tensor:
        ctx.shapes = {name: tuple(parameter.shape) for name, parameter in call.parameters.items()}
        ctx.camera_leaves = [asks_for_gradient(view.camera) for view in call.views]
        ctx.scene_leaves = asks_for_gradient(call.scene)
        scene, views = detached(call.scene), [detached(view) for view in call.views]
        integrand = call.make_integrand(scene)
        ctx.call = call = call._replace(scene=scene, views=views, caster=None, make_integrand=None)
        wanted = any(ctx.needs_input_grad)
        images, records = render_images(call, integrand, record=wanted and (call.shares_samples or call.together))
        # An image that lives on keeps the hierarchy of triangles alive only if its backward pass casts rays.
        casts_again = wanted and (None in records or not call.adjoint.keep_hits)
        ctx.integrand = integrand if casts_again else integrand._replace(caster=None)
        # Saved as tensors, so that autograd frees them after the backward pass and refuses a second one.
        recorded = leaves_of(records)
        ctx.save_for_backward(*leaves, *(item for item in recorded if isinstance(item, Tensor)))
        ctx.records = with_leaves(records, (SAVED if isinstance(item, Tensor) else item for item in recorded))
        return images

    @staticmethod
    @first_derivatives_only
    @torch.autograd.function.once_differentiable
    @entry
    def backward(ctx, grad_images: Tensor):
        call, integrand = ctx.call, ctx.integrand
        check_shapes(call.parameters, ctx.shapes)
        saved = iter(ctx.saved_tensors[len(ctx.needs_input_grad) - 1:])
        records = with_leaves(ctx.records, (next(saved) if item is SAVED else item for item in leaves_of(ctx.records)))
        asked = iter(ctx.needs_input_grad[1:])
        wanted = tuple(attached and next(asked) for attached in ctx.scene_leaves)
        wanted_of_cameras = [tuple(attached and next(asked) for attached in leaves) for leaves in ctx.camera_leaves]
        leaves = [leaf for leaf, want in zip(leaves_of(call.scene), wanted) if want]
        cameras = [leaf for view, wants in zip(call.views, wanted_of_cameras)
                   for leaf, want in zip(leaves_of(view.camera), wants) if want]
        first = [len(leaves) + sum(map(sum, wanted_of_cameras[:sensor])) for sensor in range(len(call.views))]

        def swept(index: int, gradients: Gradients, make_sweep: Callable = Sweep) -> Sweep:
            chunk = call.chunks[index]
            key, record = call.views[chunk.sensor].sample_keys[1], records[index]
            if record is None:
                record = record_chunk(call, integrand, chunk, key)
            sweep = make_sweep(integrand_of(call, integrand, chunk), record,
                               weighted(lane_adjoint(call, chunk, grad_images), record.weight), wanted, gradients)
            call.adjoint.backward(sweep)
            return sweep

        def sweep_again(finding: Finding) -> None:
            for index in range(len(call.chunks)):
                if finding.depth is None:
                    swept(index, Gradients(leaves), partial(CheckedSweep, finding))

        def differentiate_share(share: Iterable[int]) -> Gradients:
            gradients = Gradients((*leaves, *cameras))
            for index in share:
                chunk = call.chunks[index]
                key = call.views[chunk.sensor].sample_keys[1]
                sweep = swept(index, gradients)
                wants = wanted_of_cameras[chunk.sensor]
                if any(wants):
                    for k, adjoint in enumerate(camera_adjoint(call, chunk, key, wants, sweep.memo)):
                        gradients.add_whole(first[chunk.sensor] + k, adjoint)
            return gradients

        results = gradients_of(in_turns(len(call.chunks), call.workers, differentiate_share))
        if not finite(results):
            if not finite([grad_images]):
                raise NonFiniteError(f"the derivative of the loss with respect to the image is NaN or infinite in "
                                     f"{count_of_bad(grad_images)}: it is the loss that is not finite, not the rendering")
            sources = ctx.saved_tensors[:len(ctx.needs_input_grad) - 1]
            bad = [(source, result) for source, result in zip(wanted_of(ctx, sources), results) if not finite([result])]
            raise gradient_error(bad, integrand, call.module, call.parameters, sweep_again)
        results = iter(results)
        return None, *(next(results) if need else None for need in ctx.needs_input_grad[1:])


def check_shapes(parameters: dict[str, Tensor], shapes: dict[str, tuple[int, ...]]) -> None:
    """Raises RuntimeError naming a parameter whose shape is not that which it had in the forward pass."""
    for name, parameter in parameters.items():
        if tuple(parameter.shape) != shapes[name]:
            raise RuntimeError(f"the parameter {name!r} has been resized between a rendering and its backward pass, from "
                               f"{shapes[name]} to {tuple(parameter.shape)}: call backward() first, then resize it and "
                               f"render again")


def asks_for_gradient(record) -> list[bool]:
    """Of each leaf of a record, as `leaves_of` counts, whether it is a tensor that requires a gradient."""
    return [isinstance(leaf, Tensor) and leaf.requires_grad for leaf in leaves_of(record)]


def wanted_of(ctx, sources: tuple[Tensor, ...]) -> list[Tensor]:
    """The leaves that a gradient is asked for, of those that were handed over."""
    return [source for source, need in zip(sources, ctx.needs_input_grad[1:]) if need]


def camera_adjoint(call: RenderCall, chunk: Chunk, key: SampleKey, wanted: tuple[bool, ...], memo: Memo) -> list[Tensor]:
    """The gradients of the wanted leaves of a camera from what the memo holds of the rays of one chunk."""
    view = call.views[chunk.sensor]
    leaves = leaves_of(view.camera)
    leaves = [leaf.clone().requires_grad_() if want else leaf for leaf, want in zip(leaves, wanted)]
    sensors = [view._replace(camera=with_leaves(view.camera, leaves)) if number == chunk.sensor else other
               for number, other in enumerate(call.views)]
    with torch.enable_grad():
        start = start_paths(call._replace(views=sensors, stages=call.stages.eager()), chunk, key)
        inputs = [leaf for leaf, want in zip(leaves, wanted) if want]
        outputs, adjoints = (leaves_of((ray, cone or ())) for ray, cone in ((start.ray, start.cone),
                                                                            (memo.adj_ray, memo.adj_cone)))
        adjoints = vector_jacobian_product(outputs, inputs, adjoints)
    return [zeros_unless(adjoint, leaf) for adjoint, leaf in zip(adjoints, inputs)]


def render_detached(call: RenderCall) -> Tensor:
    """The images without derivatives."""
    call = call.still()
    with torch.no_grad():
        return render_images(call, call.make_integrand(call.scene), record=False)[0]


def render_with_derivative(call: RenderCall) -> Tensor:
    """The images; attached to the leaves of scene and cameras through `RenderFunction`."""
    return RenderFunction.apply(call, *differentiable(call.scene), *differentiable([view.camera for view in call.views]))
