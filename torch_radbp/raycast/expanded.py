"""Instances for casters that know only triangles, by copying the triangles of each instance: for tiny scenes."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from torch_radbp.raycast.protocol import Hit, Ray, RayCaster
from torch_radbp.shape.placement import Instances, expanded


class ExpandedCaster:
    """A `RayCaster` that copies the triangles of every instance and casts rays by a caster that knows no instances.

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
        hit = self.caster.intersect(ray)
        met, prim = hit.prim >= 0, hit.prim.clamp_min(0)
        return hit._replace(prim=torch.where(met, self.triangle[prim], -1),
                            instance=torch.where(met, self.instance[prim], 0))

    def occluded(self, ray: Ray, tmax: Tensor) -> Tensor:
        return self.caster.occluded(ray, tmax)
