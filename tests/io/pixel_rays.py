"""The ray of the middle of a pixel."""

from __future__ import annotations

import torch

from torch_radbp.film.box import Box
from torch_radbp.tensors.vec import Vec2

HALF = torch.tensor([0.5], dtype=torch.float64)


def seen_by(sensor, column: int, row: int) -> tuple[torch.Tensor, torch.Tensor]:
    """(origin, direction) of the middle of a pixel; (3,) float64 each."""
    sensor.double().film.rfilter = Box()  # whose middle it is, also at the border
    column, row = torch.tensor([[column], [row]], dtype=torch.int32)
    ray, _ = sensor.tensors().sample_ray(column, row, Vec2(HALF, HALF))
    return ray.o.stack()[0].detach(), ray.d.stack()[0].detach()
