"""A few rays of a camera, for warnings."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.boundary.curve.silhouette import CameraSight
from torch_radbp.tensors.vec import Ray, Vec2, Vec3

SIDE = 24  # rays in each row and column of the image


def rays_of(sight: CameraSight) -> tuple[Tensor, Tensor, Tensor]:
    """A grid of camera rays: origins and unit directions, (SIDE^2, 3) float64; and (SIDE^2,) bool: the ray exists."""
    film, lens = sight.camera.film, sight.camera.lens
    share = (torch.arange(SIDE, device=film.size_x.device) + 0.5) / SIDE
    y, x = (part.flatten() for part in torch.meshgrid(share * sight.height, share * sight.width, indexing="ij"))
    position = Vec2((x + film.crop_x) / film.size_x, (y + film.crop_y) / film.size_y)
    middle = Vec2(torch.full_like(x, 0.5), torch.full_like(x, 0.5)) if sight.camera.kind.has_aperture else None
    ray, weight = sight.camera.kind.sample_ray(lens, position, middle)
    o, d = (part.stack().double() for part in ray)
    seen = torch.isfinite(d).all(1) if weight is None else torch.isfinite(d).all(1) & (weight > 0)
    return o.expand_as(d), torch.nn.functional.normalize(d, dim=1), seen


def ray_from(o: Tensor, d: Tensor) -> Ray:
    """Float32 rays from (N, 3) points in (N, 3) directions."""
    return Ray(*(Vec3(*part.float().contiguous().unbind(1)) for part in (o, d)))
