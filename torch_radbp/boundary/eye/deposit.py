"""Derivatives of images by jumps: deposits at points of the film.

Each is a zero with a derivative, how far a piece of a curve moves times what the image jumps by there. So the value of the
image stays what it is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.adjoint.forward_mode import has_tangents
from torch_radbp.adjoint.function import first_derivatives_only
from torch_radbp.boundary.curve.geometry import Geometry, geometry_of
from torch_radbp.call.render_call import RenderCall
from torch_radbp.public_call import public_call
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.sensor.kind import Camera
from torch_radbp.tensors.differentiated import detached, moving_with, primal
from torch_radbp.tensors.lookup import summed
from torch_radbp.tensors.stage import Stages, stage
from torch_radbp.tensors.vec import Vec2, rows


class Deposit(NamedTuple):
    """Jumps of an image at K points, and the motion of the curves that these lie on."""

    place: Vec2  # (K,) pixels from the upper left corner of the window, float64, detached
    strength: Sequence[Tensor]  # (K,) float64 for each channel: gain per unit of motion, detached
    moved: Tensor  # (K,) float64 zeros, attached: the areas that pieces of curves sweep, or what levels change by


def image_of(call: RenderCall, number: int, deposits: Sequence[Deposit], channels: int = 3) -> Tensor:
    """(C, H, W) zeros whose derivative is that of deposits, splatted to the pixels of view `number`."""
    view = call.views[number]
    camera, shape, moved = detached(view.camera), (channels, view.height, view.width), [own.moved for own in deposits]
    if not deposits or call.adjoint.taped or has_tangents(moved):
        return recorded(camera, deposits, shape)
    return DepositFunction.apply(call.stages, camera, [own._replace(moved=None) for own in deposits], shape, *moved)


def recorded(camera: Camera, deposits: Sequence[Deposit], shape: tuple[int, int, int]) -> Tensor:
    """The image of deposits as recorded by torch, in either mode of differentiation; args as of `DepositFunction`."""
    image = torch.zeros(shape, dtype=torch.float64, device=camera.film.size_x.device).flatten(1)
    for place, strength, moved in deposits:
        gain = moving_with(moved, torch.stack(tuple(strength)))
        for pixel, count in camera.film.around(place):
            image = image.index_add(1, pixel, gain * (moved * moving_with(moved, count)))
    return image.to(camera.dtype).view(shape)


class DepositFunction(torch.autograd.Function):
    """A zero image with the derivative of deposits, as an `autograd.Function` of their motions."""

    @staticmethod
    def forward(ctx, stages: Stages, camera: Camera, deposits: Sequence[Deposit], shape: tuple[int, int, int],
                *moved: Tensor) -> Tensor:
        ctx.stages, ctx.camera, ctx.deposits = stages, camera, deposits
        return camera.film.size_x.new_zeros(shape)

    @staticmethod
    @first_derivatives_only
    @torch.autograd.function.once_differentiable
    @public_call
    def backward(ctx, grad_image: Tensor):
        pixels = tuple(channel.contiguous() for channel in grad_image.flatten(1))
        asked = [ctx.stages(adjoint_of_motion)(ctx.camera, pixels, *own[:2]) for own in ctx.deposits]
        return None, None, None, None, *asked


@stage("camera", "pixels")
def adjoint_of_motion(camera: Camera, pixels: tuple[Tensor, ...], place: Vec2, strength: Sequence[Tensor]) -> Tensor:
    """The derivatives of the loss by the motion of deposits, (K,) float64.

    Args:
        camera: detached.
        pixels: (H * W,) for each channel, the derivative of the loss by the image, row-major.
        place, strength: as of `Deposit`.
    """
    total = torch.zeros_like(strength[0])
    for pixel, count in camera.film.around(place):
        for channel, jump in zip(pixels, strength):
            total = total + jump * count * rows(channel, pixel)
    return total


class MotionFunction(torch.autograd.Function):
    """The motion of K points: zeros, whose derivatives by the scene's tensors are computed by a given function.

    The autograd graph keeps that function, and no intermediate results of the points' positions.
    """

    @staticmethod
    def forward(ctx, count: int, adjoint: Callable[[Tensor], Sequence[Tensor | None]], *leaves: Tensor) -> Tensor:
        ctx.adjoint = adjoint
        return torch.zeros(count, dtype=torch.float64, device=leaves[0].device)

    @staticmethod
    @first_derivatives_only
    @torch.autograd.function.once_differentiable
    @public_call
    def backward(ctx, asked: Tensor):
        return None, None, *ctx.adjoint(asked)


def attached_geometry(scene: SceneTensors) -> Geometry:
    """The triangles of an attached scene, in tables of which autograd sums the gradients of many look-ups in float64."""
    geometry = geometry_of(scene)
    return geometry if has_tangents(geometry) else summed(geometry)


def swept_areas(seen: Vec2, normal: Vec2) -> Tensor:
    """(K,) zeros whose derivatives are those of the areas that pieces of curves sweep when they move.

    Args:
        seen: (K,) positions of the pieces, attached.
        normal: (K,) normals, as long as the pieces.
    """
    before, normal = moving_with(seen, (seen.map(primal), normal))
    return (seen.x - before.x) * normal.x + (seen.y - before.y) * normal.y
