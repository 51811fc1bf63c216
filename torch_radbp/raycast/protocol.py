"""The protocol of ray casters: a detached query that answers with a triangle and a place on it."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import NamedTuple, Protocol

import torch
from torch import Tensor

from torch_radbp.tensors.vec import Ray


class Hit(NamedTuple):
    """The closest triangle of each lane; its point is o + t d, and (1-u-v) p0 + u p1 + v p2, in the world."""

    prim: Tensor  # int32, index into faces; -1 on a miss
    u: Tensor  # barycentric weight of the second vertex, the ray's dtype; 0 on a miss
    v: Tensor  # barycentric weight of the third vertex
    t: Tensor  # in units of the length of d; 0 on a miss
    instance: Tensor | None = None  # int32, the instance that was hit, from 1; 0: none, or a miss; None: the scene has none


class RayCaster(Protocol):
    """Ray queries against one triangle mesh and its instances; results are detached.

    A caster never changes, so that graphs and threads may keep theirs while the scene goes on: moved geometry has another
    caster. A lane whose ray is not finite, or whose direction is zero, is no query: it misses, and disturbs no other lane.
    """

    vertices: Tensor  # (V, 3), in the dtype that they were given in
    faces: Tensor  # (F, 3) int32
    rays_cast: int  # lanes handed to `intersect` and `occluded` so far

    def intersect(self, ray: Ray) -> Hit:
        """The closest hit of each lane at t > 0, from either side of a triangle."""

    def occluded(self, ray: Ray, tmax: Tensor) -> Tensor:
        """True where any triangle lies at 0 < t < tmax, or, with most casters, at tmax itself; bool per lane.

        Args:
            tmax: per lane, in units of the length of d. A value <= 0 (or NaN) is no query and gives False.
        """

    @property
    def recorded_as(self) -> Hashable | None:
        """A key of all that the code of recorded queries depends on but the tables that it reads; None: not recordable.

        Casters that can be recorded have `reads`, too.
        """

    def reads(self, dtype: torch.dtype) -> Sequence[Tensor | int]:
        """The tables and addresses that recorded queries read beside rays of a dtype, in a form that a `Recording` takes."""
