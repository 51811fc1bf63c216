"""Renders the images of a call with interior derivatives, in either mode."""

from __future__ import annotations

from functools import partial

import torch
from torch import Tensor

from torch_radbp.adjoint.forward_mode import has_tangents
from torch_radbp.adjoint.images import render_detached
from torch_radbp.call.render_call import RenderCall
from torch_radbp.call.source import Cameras
from torch_radbp.scene.cache.common_work import once
from torch_radbp.tensors.differentiated import differentiable, with_derivative_of


def rendered(call: RenderCall) -> Tensor:
    """The images of a call, (B, C, H, W), AOV channels included, with interior derivatives (without boundary terms)."""
    record = call.scene, call.source.tensors
    forward_mode = has_tangents(record)
    if not forward_mode and not (torch.is_grad_enabled() and differentiable(record)):
        return render_detached(call)
    if not forward_mode:
        return call.adjoint.image(call)
    attached = call.adjoint.dual_image(call.of_derivative())
    if call.shares_samples:
        return attached
    if call.quantities is not None or not isinstance(call.source, Cameras):
        return with_derivative_of(render_detached(call), attached)
    return with_derivative_of(once("image", call.facts, partial(render_detached, call)), attached)
