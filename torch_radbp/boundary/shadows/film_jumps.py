"""Derivatives of an image as deposits at points of the film."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.adjoint.forward_mode import has_tangents
from torch_radbp.boundary.geometry import Geometry, geometry_of
from torch_radbp.call.view import View
from torch_radbp.scene.tensors import SceneTensors
from torch_radbp.tensors.differentiated import detached, primal
from torch_radbp.tensors.lookup import summed
from torch_radbp.tensors.vec import Vec2


class FilmJumps(NamedTuple):
    """K deposits on the film: zeros with derivatives."""

    place: Vec2  # (K,) pixels from the upper left corner of the window, float64
    amount: Tensor  # (3, K) attached, per square pixel


def attached_geometry(scene: SceneTensors) -> Geometry:
    """The geometry of an attached scene, prepared for sums of many gradients."""
    geometry = geometry_of(scene)
    return geometry if has_tangents(geometry) else summed(geometry)


def swept_areas(seen: Vec2, normal: Vec2) -> Tensor:
    """(K,) zeros, attached: the areas that pieces of curves sweep.

    Args:
        seen: (K,) where they are, attached.
        normal: (K,) across them, as long as the pieces.
    """
    return (seen.x - primal(seen.x)) * normal.x + (seen.y - primal(seen.y)) * normal.y


def image_of(view: View, jumps: list[FilmJumps], dtype: torch.dtype) -> Tensor:
    """(3, H, W) the sum of deposits in the pixels of a view."""
    image = torch.zeros(3, view.height * view.width, dtype=dtype, device=view.camera.film.size_x.device)
    for place, amount in jumps:
        around = detached(view.camera).film.around(place)
        pixel = torch.cat([pixel for pixel, _ in around])
        image = image.index_add(1, pixel, torch.cat([amount * count for _, count in around], 1).to(dtype))
    return image.view(3, view.height, view.width)
