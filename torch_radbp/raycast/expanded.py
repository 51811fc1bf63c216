"""Instances for casters that know only triangles, by copying the triangles of each instance: for tiny scenes."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence

import torch
from torch import Tensor

from torch_radbp.interface.instances import Instances, expanded
from torch_radbp.jit import LaneFunction
from torch_radbp.jit.recording.recording import recording
from torch_radbp.raycast.protocol import Hit, Ray, RayCaster


class ExpandedCaster:
    """A ray caster that copies the triangles of every instance and casts rays by a caster that knows no instances.

    Args:
        make: makes that caster, of vertices and faces.
        vertices, faces, instances: as for `make_caster`.
    """

    def __init__(self, make: Callable[[Tensor, Tensor], RayCaster], vertices: Tensor, faces: Tensor, instances: Instances):
        self.vertices, self.faces = vertices.detach().clone(), faces.to(torch.int32, copy=True)
        shown = expanded(self.vertices, self.faces, instances)
        self.caster = make(shown.vertices, shown.faces)
        self.triangle, self.instance = shown.triangle, shown.instance

    @property
    def rays_cast(self) -> int:
        """The number of rays cast so far."""
        return self.caster.rays_cast

    def intersect(self, ray: Ray) -> Hit:
        hit, shown = self.caster.intersect(ray), as_shown if recording() is None else AS_SHOWN
        prim, instance = shown(self.triangle, self.instance, hit.prim)
        return hit._replace(prim=prim, instance=instance)

    def occluded(self, ray: Ray, tmax: Tensor) -> Tensor:
        return self.caster.occluded(ray, tmax)

    @property
    def recorded_as(self) -> Hashable | None:
        return None if self.caster.recorded_as is None else (ExpandedCaster, self.caster.recorded_as)

    def reads(self, dtype: torch.dtype) -> Sequence[Tensor | int]:
        return [self.triangle, self.instance, *self.caster.reads(dtype)]

    def launch(self, *arguments) -> None:
        """Casts a ray for each lane on a GPU, without waiting; args as of `jit.nvidia.launches.Caster.launch`."""
        self.caster.launch(*arguments)

    def given(self) -> bytes:
        """The bytes that `launch` hands to the GPU's kernels beside its own arguments."""
        return self.caster.given()

    def count(self, rays: int) -> None:
        """Counts rays that are cast."""
        self.caster.count(rays)


def as_shown(triangle: Tensor, instance: Tensor, prim: Tensor) -> tuple[Tensor, Tensor]:
    """The scene's triangle and the instance of hits on copied triangles, (N,) int32 each.

    Args:
        triangle, instance: of each copied triangle.
        prim: (N,) int32, the copied triangle that is hit; -1: none.
    """
    met, place = prim >= 0, prim.clamp_min(0)
    return torch.where(met, triangle.index_select(0, place), -1), torch.where(met, instance.index_select(0, place), 0)


AS_SHOWN = LaneFunction(as_shown, ("triangle", "instance"))
