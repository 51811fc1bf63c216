"""Images of zeros with the derivative of jumps: what is seen at curves, times how these move."""

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
    """Places at which the camera sees an image jump."""

    places: Places  # among others
    shown: Tensor  # (K,) int32, which
    strength: tuple[Tensor, ...]  # (K,) float64 of each channel, by how much it is more behind the curve than ahead
    kinds: tuple[int, ...]  # of curves inside of triangles, that are among the places


class JumpFunction(torch.autograd.Function):
    """An image of zeros as a function of what curves follow, with the derivative of its jumps.

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
    """(C, H, W) zeros with the derivative of jumps, backward.

    Args:
        stages: of the call.
        geometry, camera: attached.
        jumps: (K,).
        shape: H and W.
    """
    leaves = differentiable(geometry), differentiable(camera)
    return JumpFunction.apply(stages, geometry, camera, jumps, shape, *leaves[0], *leaves[1])


def recorded_jumps(stages: Stages, geometry: Geometry, camera: Camera, jumps: JumpPlaces, shape: tuple[int, int]) -> Tensor:
    """The same with a derivative that torch records, in either mode."""
    geometry = geometry if has_tangents(geometry) else summed(geometry)
    moved = stages(swept)(geometry, camera, jumps.places, jumps.shown, jumps.kinds)
    image = moved.new_zeros(len(jumps.strength), shape[0] * shape[1])
    for pixel, count in detached(camera).film.around(rows(jumps.places.film, jumps.shown)):
        image = image.index_add(1, pixel, torch.stack(jumps.strength) * (moved * count))
    return image.to(camera.dtype).view(len(image), *shape)
