"""The six planes of a camera's view frustum."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.tensors.vec import Vec3, dot


class Plane(NamedTuple):
    """The plane n . p + d = 0; () float64 each, not normalised."""

    n: Vec3
    d: Tensor

    @staticmethod
    def through(p: Vec3, n: Vec3, shift: Tensor | float = 0.0) -> Plane:
        """The plane with normal `n` through `p`, () each, moved by `shift` against the normal."""
        return Plane(n, shift - dot(p, n))

    def distance(self, p: Vec3) -> Tensor:
        """The signed distance of (N,) points from the plane, times the length of its normal."""
        return dot(p, self.n) + self.d


class Frustum(NamedTuple):
    """A view frustum: six planes whose normals point inwards."""

    left: Plane
    right: Plane
    top: Plane
    bottom: Plane
    near: Plane
    far: Plane

    @staticmethod
    def of(planes: list[Plane]) -> Frustum:
        """The frustum of six planes, stored in one tensor."""
        numbers = torch.stack([number for n, d in planes for number in (*n, d)]).unbind()
        return Frustum(*(Plane(Vec3(*numbers[k:k + 3]), numbers[k + 3]) for k in range(0, 24, 4)))

    def clipped(self, a: Vec3, b: Vec3, dtype: torch.dtype = torch.float64) -> tuple[Tensor, Tensor]:
        """Clips segments from a to b, (N,) points: the parameters of entry and exit; entry is greater if they miss.

        Divisions, which take most of the time, are in `dtype`.

        Reference: Cyrus and Beck 1978, "Generalized Two- and Three-Dimensional Clipping".
        """
        enters, leaves = torch.zeros_like(a.x, dtype=dtype), torch.ones_like(a.x, dtype=dtype)
        for plane in self:
            start, end = plane.distance(a).to(dtype), plane.distance(b).to(dtype)
            crossing = start / torch.where(start == end, 1.0, start - end)
            enters = torch.maximum(enters, torch.where(start < 0, torch.where(end < 0, 2.0, crossing), 0.0))
            leaves = torch.minimum(leaves, torch.where(end < 0, torch.where(start < 0, -1.0, crossing), 1.0))
        return enters, leaves

    def misses(self, points: tuple[Vec3, ...]) -> Tensor:
        """True if all of some points, (N,) each, lie outside of one and the same plane; (N,) bool."""
        missed = torch.zeros_like(points[0].x, dtype=torch.bool)
        for plane in self:
            beyond = plane.distance(points[0]) < 0
            for point in points[1:]:
                beyond = beyond & (plane.distance(point) < 0)
            missed = missed | beyond
        return missed


def doubled(record):
    """A record with its tensors in float64."""
    return record.double() if isinstance(record, Tensor) else type(record)(*map(doubled, record))
