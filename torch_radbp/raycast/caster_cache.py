"""The ray caster of the last rendering, and whether its triangles are still those of the scene."""

from __future__ import annotations

import operator
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.interface.balls import Balls
from torch_radbp.interface.instances import Instances
from torch_radbp.raycast.protocol import RayCaster
from torch_radbp.tensors.vec import Vec3


class CastTriangles(NamedTuple):
    """The triangles of a scene as a ray caster is built from them, detached. These tensors are never written into."""

    p: Vec3  # (V,) positions
    corners: tuple[Tensor, Tensor, Tensor]  # (T,) int32 each, rows of `p`
    balls: Balls | None  # the triangles that tessellate spheres
    instances: Instances | None = None  # of groups of these triangles
    made_of: tuple[Tensor, ...] = ()  # what the positions are computed from: the same objects where that is the same

    def is_made_of_the_same(self, other: CastTriangles) -> bool:
        """True if the other record is made of the very same tensors, so that triangles need not be compared."""
        mine, others = ((mesh.balls, mesh.instances, *mesh.corners, *mesh.made_of) for mesh in (self, other))
        return bool(self.made_of) and len(mine) == len(others) and all(map(operator.is_, mine, others))

    def compared(self, other: CastTriangles) -> tuple[list[Tensor], list[Tensor]] | None:
        """Flags, () bool each on the device, that are all true if the other record has equal triangles, and equal instances;
        None: shapes, dtypes or groups differ."""
        flags = []
        for mine, others in zip(self.columns(), other.columns()):
            if len(mine) != len(others) or not all(map(of_one_kind, mine, others)):
                return None
            flags.append([(a == b).all() for a, b in zip(mine, others) if a.data_ptr() != b.data_ptr()])
        return (flags[0], flags[1]) if self.groups() == other.groups() else None

    def equals(self, other: CastTriangles) -> bool:
        """True if the other record has the same triangles."""
        return self.groups() == other.groups() and all(
            len(mine) == len(others) and all(map(same_values, mine, others))
            for mine, others in zip(self.columns(), other.columns()))

    def columns(self) -> tuple[tuple[Tensor, ...], tuple[Tensor, ...]]:
        """The tensors that describe the triangles, and those that describe the instances."""
        return (*self.p, *self.corners, *(self.balls or ())), () if self.instances is None else (
            self.instances.to_world, self.instances.boxes)

    def groups(self) -> tuple[tuple[int, ...], ...]:
        """The first vertex, triangle and instance of each group; empty without instances."""
        return () if self.instances is None else self.instances[1:4]

    def stacked(self) -> tuple[Tensor, Tensor, Balls | None, Instances | None]:
        """The vertices (V, 3), the faces (T, 3), the balls among them, and the instances of some."""
        return self.p.stack(), torch.stack(self.corners, 1), self.balls, self.instances


class CachedCaster(NamedTuple):
    """A ray caster and the triangles that it was built from."""

    caster: RayCaster
    mesh: CastTriangles


def same_values(a: Tensor, b: Tensor) -> bool:
    """True if two tensors that are never written into have one dtype, one device and the same values."""
    return of_one_kind(a, b) and (a.data_ptr() == b.data_ptr() or torch.equal(a, b))


def of_one_kind(a: Tensor, b: Tensor) -> bool:
    """True if two tensors have one dtype, one device and one shape."""
    return (a.dtype, a.device, a.shape) == (b.dtype, b.device, b.shape)
