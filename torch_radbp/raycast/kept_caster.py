"""The ray caster that is kept from one rendering to the next while the triangles stay the same."""

from __future__ import annotations

import torch

from torch_radbp.raycast import RayCaster, make_caster
from torch_radbp.raycast.caster_cache import CachedCaster, CastTriangles
from torch_radbp.raycast.mesh import MeshExtremes
from torch_radbp.tensors.asked_later import answered


class KeptCaster:
    """Makes a new ray caster only where the triangles have changed.

    Each rendering keeps its own, and so does the graph behind its image: neither geometry that moves later nor another
    thread changes what they see.
    """

    def __init__(self) -> None:
        self.cached: CachedCaster | None = None

    def of(self, mesh: CastTriangles, name: str | None) -> RayCaster:
        """Returns the caster of the last rendering if its triangles are the same, else builds one by `make_caster`."""
        cached = self.cached
        if cached is not None and cached.mesh.is_made_of_the_same(mesh):
            return cached.caster
        same, known = (False, None) if cached is None else same_mesh(cached.mesh, mesh)
        if not same:
            # Freed first, if no graph and no thread holds it; but for groups, which the new one may take over.
            last = None if cached is None or mesh.instances is None else cached.caster
            cached = self.cached = None
            cached = CachedCaster(make_caster(name, *mesh.stacked(), last, known), mesh)
        self.cached = cached._replace(mesh=mesh)  # the next one may bring the very same tensors again
        return cached.caster


def same_mesh(mesh: CastTriangles, other: CastTriangles) -> tuple[bool, MeshExtremes | None]:
    """True if two meshes have equal triangles; and the extremes of the other one, or None if they were not computed.

    They are only computed on another device than the CPU: the host waits once for both answers.
    """
    if other.p.x.is_cpu:
        return mesh.equals(other), None
    flags = mesh.compared(other)
    if flags is None or not any(flags):
        return flags is not None, None
    vertices, faces, _, instances = other.stacked()
    asked = [torch.stack(each).all() for each in flags if each]
    found = answered([*asked, *MeshExtremes.asked_of(vertices, faces, instances)])
    unmoved = not flags[0] or bool(found[0])
    return all(found[:len(asked)]), MeshExtremes.of(found[len(asked):], unmoved)
