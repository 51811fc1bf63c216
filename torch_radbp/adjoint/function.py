"""The one `torch.autograd.Function`: from the leaves of `SceneTensors` to images."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import nullcontext
from functools import partial, wraps

import torch
from torch import Tensor

from torch_radbp.adjoint.bounce import vector_jacobian_product, zeros_unless
from torch_radbp.adjoint.checked_sweep import CheckedSweep
from torch_radbp.adjoint.images import render_images
from torch_radbp.adjoint.record import record_wavefront
from torch_radbp.adjoint.scatter import Gradients, gradients_of
from torch_radbp.adjoint.sweep import Sweep, numbered_leaves
from torch_radbp.adjoint.taped_sweep import sweep_of
from torch_radbp.call.chunks import Chunk
from torch_radbp.call.finite import FirstNonFinite, NonFiniteError, all_finite, count_of_bad, gradient_error
from torch_radbp.call.pixels import asked_of_pixels, filters_of, lane_adjoint, weighted
from torch_radbp.call.render_call import (
    RenderCall,
    integrand_of,
    start_paths,
)
from torch_radbp.call.wavefronts import Wavefront
from torch_radbp.call.workers import in_turns
from torch_radbp.public_call import public_call
from torch_radbp.scene.cone import Cone
from torch_radbp.tensors.differentiated import detached, differentiable
from torch_radbp.tensors.lookup import summed
from torch_radbp.tensors.record import leaves_of, mapped, rows_between, with_leaves
from torch_radbp.tensors.stage import EAGER
from torch_radbp.tensors.torch_internals import batched
from torch_radbp.tensors.vec import Ray

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
    """The images as a differentiable function of the scene's leaves; backward by memoized adjoint radiance."""

    @staticmethod
    def forward(ctx, call: RenderCall, *leaves: Tensor) -> Tensor:
        ctx.shapes = {name: tuple(parameter.shape) for name, parameter in call.parameters.items()}
        ctx.camera_leaves = [asks_for_gradient(view.camera) for view in call.views]
        ctx.scene_leaves = asks_for_gradient(call.scene)
        integrand, views = call.integrand, [detached(view) for view in call.views]
        ctx.call = call = call._replace(scene=integrand.scene, views=views, caster=None, make_integrand=None, integrand=None)
        wanted = any(ctx.needs_input_grad)
        images, filters, records = render_images(call, integrand, record=wanted and (call.shares_samples or call.together))
        ctx.filters = filters if call.shares_samples else None
        # An image that lives on keeps the hierarchy of triangles alive only if its backward pass casts rays.
        casts_again = wanted and (None in records or not call.adjoint.keep_hits)
        ctx.integrand = integrand if casts_again else integrand._replace(caster=None)
        # Saved as tensors, so that autograd frees them after the backward pass and refuses a second one.
        recorded: list[Tensor] = []
        ctx.records = mapped(records, partial(without_tensor, recorded))
        ctx.save_for_backward(*leaves, *recorded)
        return images

    @staticmethod
    @first_derivatives_only
    @torch.autograd.function.once_differentiable
    @public_call
    def backward(ctx, grad_images: Tensor):
        call, integrand, grad_images = ctx.call, ctx.integrand, grad_images[:, :3]  # quantities have no derivative here
        check_shapes(call.parameters, ctx.shapes)
        tensors = saved_tensors(ctx)
        saved = iter(tensors[len(ctx.needs_input_grad) - 1:])
        records = mapped(ctx.records, lambda leaf: next(saved) if leaf is SAVED else leaf)
        asked = iter(ctx.needs_input_grad[1:])
        wanted = tuple(attached and next(asked) for attached in ctx.scene_leaves)
        wanted_of_cameras = [tuple(attached and next(asked) for attached in leaves) for leaves in ctx.camera_leaves]
        numbered = numbered_leaves(call.scene, wanted)
        leaves = [leaf for leaf, want in zip(leaves_of(call.scene), wanted) if want]
        cameras = [leaf for view, wants in zip(call.views, wanted_of_cameras)
                   for leaf, want in zip(leaves_of(view.camera), wants) if want]
        filters = ctx.filters if call.shares_samples else filters_of(call, 1)
        pixels = asked_of_pixels(call, grad_images, filters)
        first = [len(leaves) + sum(map(sum, wanted_of_cameras[:sensor])) for sensor in range(len(call.views))]

        def swept(index: int, gradients: Gradients, sweep_of: Callable = sweep_of) -> Sweep:
            wavefront, record = call.wavefronts[index], records[index]
            if record is None:
                record = record_wavefront(call, integrand, wavefront)
            adj_L = weighted(lane_adjoint(call, wavefront, record.place, pixels), record.weight)
            seen = integrand_of(call, integrand, wavefront.sensor)
            with sweep_of(seen, record, adj_L, numbered, gradients) as sweep:
                call.adjoint.backward(sweep)
            return sweep

        def sweep_again(finding: FirstNonFinite) -> None:
            for index in range(len(call.wavefronts)):
                if finding.depth is None:
                    swept(index, Gradients(leaves), lambda *arguments: nullcontext(CheckedSweep(finding, *arguments)))

        def differentiate_share(share: Iterable[int]) -> Gradients:
            gradients = Gradients((*leaves, *cameras), call.memory)
            for index in share:
                memo = swept(index, gradients).memo
                for chunk, *lanes in call.wavefronts[index].parts():
                    wants = wanted_of_cameras[chunk.sensor]
                    if any(wants):
                        adj_start = rows_between((memo.adj_ray, memo.adj_cone), *lanes)
                        for k, adjoint in enumerate(camera_adjoint(call, chunk, wants, *adj_start)):
                            gradients.add_whole(first[chunk.sensor] + k, adjoint)
            return gradients

        shares = in_turns(len(call.wavefronts), call.workers, differentiate_share)
        results, are_finite = gradients_of(shares)
        call.memory.give_back(rows for share in shares for rows in share.rows)
        if not are_finite:
            if not all_finite([grad_images]):
                raise NonFiniteError(f"the derivative of the loss with respect to the image is NaN or infinite in "
                                     f"{count_of_bad(grad_images)}: it is the loss that is not finite, not the rendering")
            sources = tensors[:len(ctx.needs_input_grad) - 1]
            bad = [(source, result) for source, result in zip(wanted_of(ctx, sources), results) if not all_finite([result])]
            raise gradient_error(bad, integrand, call.module, call.parameters, sweep_again)
        results = iter(results)
        return None, *(next(results) if need else None for need in ctx.needs_input_grad[1:])


def without_tensor(tensors: list[Tensor], leaf):
    """Replaces a tensor in a record by a placeholder, and appends it to `tensors`, which autograd saves."""
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
    """The leaves of the forward pass that require a gradient."""
    return [source for source, need in zip(sources, ctx.needs_input_grad[1:]) if need]


def camera_adjoint(call: RenderCall, chunk: Chunk, wanted: tuple[bool, ...], adj_ray: Ray,
                   adj_cone: Cone | None) -> list[Tensor]:
    """The gradients of a camera's leaves from the adjoints of one chunk's rays and cones."""
    view = call.views[chunk.sensor]
    leaves = leaves_of(view.camera)
    leaves = [leaf.clone().requires_grad_() if want else leaf for leaf, want in zip(leaves, wanted)]
    sensors = [view._replace(camera=summed(with_leaves(view.camera, leaves))) if number == chunk.sensor else other
               for number, other in enumerate(call.views)]
    with torch.enable_grad():
        start = start_paths(call._replace(views=sensors, stages=EAGER), Wavefront((chunk,)), 1)
        inputs = [leaf for leaf, want in zip(leaves, wanted) if want]
        outputs, adjoints = (leaves_of((ray, cone or ())) for ray, cone in ((start.ray, start.cone), (adj_ray, adj_cone)))
        adjoints = vector_jacobian_product(outputs, inputs, adjoints)
    return [zeros_unless(adjoint, leaf) for adjoint, leaf in zip(adjoints, inputs)]


def render_with_derivative(call: RenderCall) -> Tensor:
    """Renders images with AOVs, attached to the leaves of scene and cameras by `RenderFunction`."""
    return RenderFunction.apply(call, *differentiable(call.scene), *differentiable([view.camera for view in call.views]))
