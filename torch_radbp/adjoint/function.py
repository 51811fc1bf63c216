"""The one `torch.autograd.Function`: from the leaves of `SceneTensors` to images."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import nullcontext
from functools import partial, wraps
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.adjoint.checked_sweep import CheckedSweep
from torch_radbp.adjoint.images import render_images
from torch_radbp.adjoint.record import record_wavefront
from torch_radbp.adjoint.scatter import Gradients, bytes_of_totals, gradients_of, workers_beside
from torch_radbp.adjoint.sweep import Sweep, numbered_leaves
from torch_radbp.adjoint.taped_sweep import sweep_of
from torch_radbp.call.chunks import LaneBlock
from torch_radbp.call.finite import FirstNonFinite, NonFiniteError, all_finite, count_of_bad, gradient_error
from torch_radbp.call.less_memory import again_in_pieces
from torch_radbp.call.pixels import weighted
from torch_radbp.call.render_call import RenderCall, integrand_of_wavefront, start_paths, started
from torch_radbp.call.sink import SinkValues
from torch_radbp.call.wavefronts import Wavefront
from torch_radbp.jit.recording.repetitions import Repetitions
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.taped_bounces import repeating
from torch_radbp.path.trace import trace
from torch_radbp.public_call import public_call
from torch_radbp.raycast.protocol import Hit
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.tensors.differentiated import differentiable
from torch_radbp.tensors.lookup import summed
from torch_radbp.tensors.record import leaves_of, mapped, rows_between, with_leaves
from torch_radbp.tensors.stage import EAGER
from torch_radbp.tensors.torch_internals import batched
from torch_radbp.tensors.vec import Ray, Vec3
from torch_radbp.tensors.vector_jacobian import vector_jacobian_product, zeros_unless
from torch_radbp.threads.workers import in_turns
from torch_radbp.vertex.cone import Cone

SAVED = object()  # stands for a tensor that autograd keeps


def first_derivatives_only(backward: Callable) -> Callable:
    """Makes a backward pass raise under double differentiation, instead of returning zeros."""
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
    """The rendering of a call as an `autograd.Function`, with memoized adjoint radiance as its derivative."""

    @staticmethod
    def forward(ctx, call: RenderCall, *leaves: Tensor) -> Tensor:
        ctx.shapes = {name: tuple(parameter.shape) for name, parameter in call.parameters.items()}
        ctx.source_leaves, ctx.scene_leaves = asks_for_gradient(call.source.tensors), asks_for_gradient(call.scene)
        integrand, call = call.integrand, call.still()
        call = call._replace(caster=None, make_integrand=None, integrand=None)
        wanted = any(ctx.needs_input_grad)

        def images(call: RenderCall) -> tuple[RenderCall, SinkValues]:
            return call, call.repetitions.enough(lambda some: render_images(
                call, repeating(integrand, some), record=wanted and (call.shares_samples or call.together)))

        ctx.call, (values, filters, records) = again_in_pieces(call, images)
        call = ctx.call
        ctx.filters = filters if call.shares_samples else None
        # An image that lives on keeps the hierarchy of triangles alive only if its backward pass casts rays.
        casts_again = wanted and (None in records or not call.adjoint.keep_hits)
        ctx.integrand = integrand if casts_again else integrand._replace(caster=None)
        # Saved as tensors, so that autograd frees them after the backward pass and refuses a second one.
        recorded: list[Tensor] = []
        ctx.records = mapped(records, partial(without_tensor, recorded))
        ctx.save_for_backward(*leaves, *recorded)
        return values

    @staticmethod
    @first_derivatives_only
    @torch.autograd.function.once_differentiable
    @public_call
    def backward(ctx, gradient: Tensor):
        call, integrand = ctx.call, ctx.integrand
        check_shapes(call.parameters, ctx.shapes)
        tensors = saved_tensors(ctx)
        saved = iter(tensors[len(ctx.needs_input_grad) - 1:])
        records = mapped(ctx.records, lambda leaf: next(saved) if leaf is SAVED else leaf)
        asked = iter(ctx.needs_input_grad[1:])
        wanted = tuple(attached and next(asked) for attached in ctx.scene_leaves)
        wanted_of_source = [attached and next(asked) for attached in ctx.source_leaves]
        numbered = numbered_leaves(call.scene, wanted)
        leaves = [leaf for leaf, want in zip(leaves_of(call.scene), wanted) if want]
        of_source = [leaf for leaf, want in zip(leaves_of(call.source.tensors), wanted_of_source) if want]
        adj_sums, all_wanted = call.sink.adj_sums(call, gradient, ctx.filters), (*wanted, *wanted_of_source)
        start_counts = bool(of_source) or (call.sink.at_vertices and integrand.settings.moving and any(
            [wanted[place] for place in scene_leaves_met(call.scene)]))

        def seen_by(wavefront: Wavefront, integrand: Integrand) -> Integrand:
            seen = call.sink.backward_integrand(integrand_of_wavefront(call, integrand, wavefront, 1), adj_sums)
            # Of camera paths another function for the first bounce would take longer to compile than it saves.
            fixed = call.sink.at_vertices and seen.settings.moving and not start_counts
            return seen._replace(settings=seen.settings._replace(fixed_start=fixed))

        seen_by_all = seen_by(call.wavefronts[0], integrand) if call.sink.at_vertices else None  # made once

        def swept(call: RenderCall, integrand: Integrand, index: int, gradients: Gradients,
                  sweep_of: Callable = sweep_of) -> Sweep:
            wavefront, record = call.wavefronts[index], None if call is not ctx.call else records[index]
            if record is None:
                record = record_wavefront(call, integrand, wavefront)
            adj_L = weighted(call.sink.adjoint(call, wavefront, record.place, adj_sums), record.weight)
            seen = seen_by(wavefront, integrand) if seen_by_all is None else seen_by_all._replace(
                repetitions=integrand.repetitions)
            if call.sink.at_vertices and call.adjoint.keep_radiance:  # what paths bring to the loss is known only now
                record = record._replace(radiance=per_power(trace(seen, start := record.start()), start.beta))
            with sweep_of(seen, record, adj_L, numbered, gradients) as sweep:
                call.adjoint.backward(sweep)
            return sweep

        def sweep_again(finding: FirstNonFinite) -> None:
            for index in range(len(call.wavefronts)):
                if finding.depth is None:
                    swept(call, integrand, index, Gradients(leaves),
                          lambda *arguments: nullcontext(CheckedSweep(finding, *arguments)))

        def differentiate_share(call: RenderCall, integrand: Integrand, share: Iterable[int]) -> Gradients:
            gradients = Gradients((*leaves, *of_source), call.memory)
            for index in share:
                sweep = swept(call, integrand, index, gradients)
                adj_start = adj_of_start(sweep) if start_counts else None
                del sweep  # and with it the states of its paths
                for chunk, *lanes in call.wavefronts[index].parts() if start_counts else ():
                    for k, adjoint in source_adjoint(call, integrand, chunk, all_wanted, rows_between(adj_start, *lanes)):
                        gradients.add_whole(k, adjoint)
            return gradients

        def differentiate(some: Repetitions, call: RenderCall) -> tuple[list[Tensor], bool]:
            share_of = partial(differentiate_share, call, repeating(integrand, some))
            workers = workers_beside(call.workers, bytes_of_totals((*leaves, *of_source)))
            shares = in_turns(len(call.wavefronts), workers, share_of)
            found = gradients_of(shares, some)
            call.memory.give_back(rows for share in shares for rows in share.rows)
            return found

        def differentiated(call: RenderCall) -> tuple[list[Tensor], bool]:
            return call.repetitions.enough(lambda some: differentiate(some, call))

        # Without a caster what was recorded cannot be traced again.
        again = integrand.caster is not None
        results, are_finite = again_in_pieces(call, differentiated) if again else differentiated(call)
        if not are_finite:
            radiance = call.sink.radiance(gradient)
            if not all_finite([radiance]):
                raise NonFiniteError(f"the derivative of the loss with respect to the image is NaN or infinite in "
                                     f"{count_of_bad(radiance)}: it is the loss that is not finite, not the rendering")
            sources = tensors[:len(ctx.needs_input_grad) - 1]
            bad = [(source, result) for source, result in zip(wanted_of(ctx, sources), results) if not all_finite([result])]
            raise gradient_error(bad, integrand, call.module, call.parameters, sweep_again)
        results = iter(results)
        return None, *(next(results) if need else None for need in ctx.needs_input_grad[1:])


def without_tensor(tensors: list[Tensor], leaf):
    """Replaces a tensor of a record by a placeholder, and appends it to `tensors`, which autograd saves."""
    if not isinstance(leaf, Tensor):
        return leaf
    tensors.append(leaf)
    return SAVED


def saved_tensors(ctx) -> tuple[Tensor, ...]:
    """The tensors that autograd has saved; raises RuntimeError if a parameter was changed in place since."""
    try:
        return ctx.saved_tensors
    except RuntimeError as error:
        if "inplace" not in str(error):
            raise
        raise RuntimeError("a parameter has been changed in place between a rendering and its backward pass, which reads it "
                           "again: call backward() first, then change it and render again") from error


def check_shapes(parameters: dict[str, Tensor], shapes: dict[str, tuple[int, ...]]) -> None:
    """Raises RuntimeError naming a parameter whose shape has changed since the forward pass."""
    for name, parameter in parameters.items():
        if tuple(parameter.shape) != shapes[name]:
            raise RuntimeError(f"the parameter {name!r} has been resized between a rendering and its backward pass, from "
                               f"{shapes[name]} to {tuple(parameter.shape)}: call backward() first, then resize it and "
                               f"render again")


def asks_for_gradient(record) -> list[bool]:
    """For each leaf of a record, whether it is a tensor that requires a gradient."""
    return [isinstance(leaf, Tensor) and leaf.requires_grad for leaf in leaves_of(record)]


def wanted_of(ctx, sources: tuple[Tensor, ...]) -> list[Tensor]:
    """The tensors of scene and source, inputs of the `autograd.Function`, of which autograd wants a gradient."""
    return [source for source, need in zip(sources, ctx.needs_input_grad[1:]) if need]


def per_power(L: Vec3, beta: Vec3) -> Vec3:
    """The radiance L_1 of paths that begin with throughput `beta`, from their light L = beta L_1; 0 where `beta` is 0."""
    return Vec3(*(part / torch.where(begun != 0, begun, 1.0) for part, begun in zip(L, beta)))


class StartAdjoint(NamedTuple):
    """The derivatives of the loss by the first rays, cones and throughputs of N paths, and what these rays hit."""

    ray: Ray | None
    cone: Cone | None
    beta: Vec3
    hit: Hit | None  # None: rays carry no derivatives


def adj_of_start(sweep: Sweep) -> StartAdjoint:
    """The derivatives of the loss by the first ray, cone and throughput of each path, after a sweep of all bounces."""
    memo, kept = sweep.memo, sweep.record.radiance
    return StartAdjoint(memo.adj_ray, memo.adj_cone, sweep.adj_L * (memo.L if kept is None else kept), memo.hit)


def source_adjoint(call: RenderCall, integrand: Integrand, chunk: LaneBlock, wanted: Sequence[bool],
                   adj_start: StartAdjoint) -> Iterator[tuple[int, Tensor]]:
    """Yields gradients of scene and source tensors by way of the rays, cones and power with which paths begin.

    Yields:
        The index of each tensor among the wanted ones, and its gradient, which is summed in float64 where each ray reads
        entries of its own.
    """
    tensors, scene, glued = call.source.tensors, call.scene, call.sink.at_vertices and integrand.settings.moving
    shift, of_scene = len(leaves_of(scene)), scene_leaves_met(scene) if glued else ()
    read = {*of_scene, *(shift + place for place in call.source.leaves_read(chunk))}
    leaves = [leaf.clone().requires_grad_() if want and place in read else leaf
              for place, (leaf, want) in enumerate(zip((*leaves_of(scene), *leaves_of(tensors)), wanted))]
    inputs = [(sum(wanted[:place]), leaves[place]) for place in sorted(read) if wanted[place]]
    if not inputs:
        return
    source = call.source.with_tensors(summed(with_leaves(tensors, leaves[shift:])))
    with torch.enable_grad():
        if glued:
            sample = source.glued(chunk, 1, summed(with_leaves(scene, leaves[:shift])), adj_start.hit)
            start = started(call, sample)
        else:
            start = start_paths(call._replace(source=source, stages=EAGER), Wavefront((chunk,)), 1)
        pairs = [(output, adjoint) for output, adjoint in zip((start.ray, start.cone, start.beta), adj_start)
                 if adjoint is not None]
        outputs, adjoints = (leaves_of(parts) for parts in zip(*pairs))
        adjoints = vector_jacobian_product(outputs, [leaf for _, leaf in inputs], adjoints)
    for (number, leaf), adjoint in zip(inputs, adjoints):
        yield number, zeros_unless(adjoint, leaf)


def scene_leaves_met(scene: SceneTensors) -> list[int]:
    """The indices of the scene's tensors on which hit points depend: vertex positions and instances."""
    marked = with_leaves(scene.triangles, list(range(len(leaves_of(scene.triangles)))))
    return [number for number in leaves_of((marked.vertices.p, marked.instances)) if number is not None]


def render_with_derivative(call: RenderCall) -> Tensor:
    """The result of a rendering, such as images, attached to the tensors of scene and source through `RenderFunction`."""
    return RenderFunction.apply(call, *differentiable(call.scene), *differentiable(call.source.tensors))
