"""Points that look at edges."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.tensors.vec import Vec3, dot

COPLANAR = 1e-6  # a cosine; what lies in the plane of an eye's surface hides nothing from it


class Eyes(NamedTuple):
    """M points that look at edges, or directions towards such; detached, float64."""

    place: Vec3  # (M,)
    w: Tensor  # (M,) 1; 0: `place` is a direction towards the eye
    n: Vec3  # (M,) unit normal of the surface that it lies on, 0: on none; directions count by their cosines,
    behind: Tensor  # (M,) behind the surface so many times less,
    even: Tensor  # (M,) and so much, whatever the cosine, but along the surface


def how_much_counts(eye: Eyes, d: Vec3, cosine: Tensor | float = 1.0, sine: Tensor | float = 0.0) -> Tensor:
    """The most that directions around some count, (N,).

    Args:
        eye: (N,).
        d: (N,) unit.
        cosine, sine: of the angle up to which others lie off these.
    """
    faced = dot(eye.n, d).clamp(-1.0, 1.0)
    across = torch.sqrt(1.0 - faced * faced)
    before, behind = (torch.where(side >= cosine, 1.0, side * cosine + across * sine) for side in (faced, -faced))
    faced = torch.maximum(before, eye.behind * behind)
    return torch.where(faced > COPLANAR, faced + eye.even, torch.where(dot(eye.n, eye.n) > 0.0, 0.0, 1.0))
