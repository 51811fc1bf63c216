"""Forward mode: images with their tangents, by dual numbers through the loop over bounces.

There is no second implementation: where leaves of `SceneTensors` are dual tensors (`torch.autograd.forward_ad`), torch
carries the tangents through `path.trace` as it runs, inside of fused loops (`jit/dual.py`) and of what was recorded of
bounces, too. No states are kept, so that the chunk bounds the memory, as in the forward pass.

`torch.func.jvp` makes dual tensors, too, but while it is active it wraps everything, down to the constants of a ray caster,
in tensors without storage. `render_outside_transforms` unwraps the parameters first and wraps only the image again.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor
from torch.autograd import forward_ad

from torch_radbp.adjoint.attached import bounce_attached
from torch_radbp.adjoint.images import render_images
from torch_radbp.call.render_call import RenderCall
from torch_radbp.path.taped_bounces import repeating
from torch_radbp.tensors import torch_internals
from torch_radbp.tensors.differentiated import tangent_of
from torch_radbp.tensors.record import tensors_in
from torch_radbp.tensors.torch_internals import tree_map


def has_tangents(record) -> bool:
    """True if any tensor of a record is a dual tensor."""
    return any(tangent_of(tensor) is not None for tensor in tensors_in(record))


def render_tangents(call: RenderCall) -> Tensor:
    """Renders images, (B, 3, H, W), with their forward-mode tangents, of a scene whose leaves are dual tensors.

    Raises:
        RuntimeError: if a leaf also requires a gradient, which would be missing.
    """
    tensors = tensors_in((call.scene, call.source.tensors))
    if torch.is_grad_enabled() and any(tensor.requires_grad for tensor in tensors):
        raise RuntimeError("a rendering is differentiated either forward or backward, but parameters have tangents and "
                           "parameters require grad: render under torch.no_grad(), or with adjoint=TapeAdjoint() for both")
    with torch.no_grad():
        integrand = call.make_integrand(call.scene)
        return call.repetitions.enough(lambda some: render_images(
            call, repeating(integrand, some), record=False, bounce=bounce_attached(integrand))).values


def inside_transforms() -> bool:
    """True while a transform of `torch.func` is active."""
    return bool(torch_internals.transforms())


def render_outside_transforms(render: Callable, parameters: dict[str, Tensor]):
    """Computes `render(parameters)` for `torch.func.jvp`: outside of the transform, on dual tensors.

    Raises:
        RuntimeError: in any other transform, or in several.
    """
    transforms = torch_internals.transforms()
    if transforms != ["jvp"]:
        raise RuntimeError("of the transforms of torch.func rendering works in jvp only, and not nested, but is called in: "
                           f"{', '.join(transforms)}; for gradients use torch.autograd.grad or backward(), not "
                           "torch.func.grad or vjp")
    duals = {name: tuple(map(torch_internals.unwrapped, forward_ad.unpack_dual(value)))
             for name, value in parameters.items()}

    def rendered():
        images = render({name: value if tangent is None else forward_ad.make_dual(value, tangent)
                         for name, (value, tangent) in duals.items()})
        return tree_map(lambda image: tuple(forward_ad.unpack_dual(image)), images)

    images = torch_internals.outside_transforms(rendered)
    return tree_map(rewrapped, images, is_leaf=lambda part: isinstance(part, tuple) and isinstance(part[1], Tensor | None))


def rewrapped(image: tuple[Tensor, Tensor | None]) -> Tensor:
    """Makes a dual tensor of an image and its tangent, if it has one."""
    return image[0] if image[1] is None else forward_ad.make_dual(*image)
