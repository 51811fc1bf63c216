"""Zero images with the derivative of discontinuities: the jump in radiance times the motion of curves."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.adjoint.forward_mode import has_tangents
from torch_radbp.adjoint.function import asks_for_gradient, first_derivatives_only
from torch_radbp.adjoint.scatter import Contribution, Gradients, gradients_of
from torch_radbp.boundary.geometry import Geometry
from torch_radbp.boundary.motion import asked_of_places, slopes, swept
from torch_radbp.boundary.places import Places
from torch_radbp.public_call import public_call
from torch_radbp.sensor.kind import Camera
from torch_radbp.tensors.differentiated import detached, differentiable
from torch_radbp.tensors.lookup import summed
from torch_radbp.tensors.stage import Stages
from torch_radbp.tensors.vec import rows


class JumpPlaces(NamedTuple):
    """Samples on discontinuity curves that the camera sees."""

    places: Places  # among others
    shown: Tensor  # (K,) int32, indices of the visible ones
    strength: tuple[Tensor, ...]  # (K,) float64 for each channel: value behind the curve less value ahead
    kinds: tuple[int, ...]  # kinds of curves inside of triangles among them


class JumpFunction(torch.autograd.Function):
    """A zero image with the derivative of its discontinuities, as a function of what curves depend on.

    How curves follow is found at once, so that nothing of the scene is kept for the backward pass.
    """

    @staticmethod
    def forward(ctx, stages: Stages, geometry: Geometry, camera: Camera, jumps: JumpPlaces, shape: tuple[int, int],
                *leaves: Tensor) -> Tensor:
        wanted, wanted_of_camera = asks_for_gradient(geometry), asks_for_gradient(camera)
        geometry, camera = detached(geometry), detached(camera)
        ctx.slopes = stages(slopes)(geometry, camera, tuple(wanted), tuple(wanted_of_camera), jumps.places, jumps.shown,
                                   jumps.kinds)
        ctx.stages, ctx.camera, ctx.film, ctx.jumps = stages, camera, jumps.places.film, jumps._replace(places=None)
        ctx.leaves = [leaf.detach() for leaf in leaves]  # of which only shapes matter
        return camera.film.size_x.new_zeros(len(jumps.strength), *shape)

    @staticmethod
    @first_derivatives_only
    @torch.autograd.function.once_differentiable
    @public_call
    def backward(ctx, grad_image: Tensor):
        jumps, pixels = ctx.jumps, tuple(channel.contiguous() for channel in grad_image.flatten(1))
        tables, lens = ctx.slopes
        gradients = Gradients(ctx.leaves)
        everything = torch.zeros_like(jumps.shown)
        found = [Contribution(leaf, *read) for leaf, reads in enumerate(tables) for read in reads]
        found += [Contribution(len(tables) + number, everything, slope) for number, slope in enumerate(lens)]
        asked = ctx.stages(asked_of_places)(ctx.camera, pixels, ctx.film, jumps.strength, jumps.shown,
                                           tuple([part.adjoint for part in found]))
        gradients.add([Contribution(leaf, index, adjoint) for (leaf, index, _), adjoint in zip(found, asked)])
        results, _ = gradients_of([gradients])
        return None, None, None, None, None, *results


def image_of_jumps(stages: Stages, geometry: Geometry, camera: Camera, jumps: JumpPlaces, shape: tuple[int, int]) -> Tensor:
    """(C, H, W) zeros with the derivative of discontinuities, for the backward pass.

    Args:
        stages: of the call.
        geometry, camera: attached.
        jumps: (K,).
        shape: H and W.
    """
    leaves = differentiable(geometry), differentiable(camera)
    return JumpFunction.apply(stages, geometry, camera, jumps, shape, *leaves[0], *leaves[1])


def recorded_jumps(stages: Stages, geometry: Geometry, camera: Camera, jumps: JumpPlaces, shape: tuple[int, int]) -> Tensor:
    """(C, H, W) zeros with the derivative of discontinuities, recorded by torch in either mode."""
    geometry = geometry if has_tangents(geometry) else summed(geometry)
    moved = stages(swept)(geometry, camera, jumps.places, jumps.shown, jumps.kinds)
    image = moved.new_zeros(len(jumps.strength), shape[0] * shape[1])
    for pixel, count in detached(camera).film.around(rows(jumps.places.film, jumps.shown)):
        image = image.index_add(1, pixel, torch.stack(jumps.strength) * (moved * count))
    return image.to(camera.dtype).view(len(image), *shape)
