"""Balls around the mirrors, the glass and the lamps of a scene, at which rays are aimed."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.path.integrand import Integrand
from torch_radbp.sampling.guide import GuideSpheres
from torch_radbp.sampling.spheres import BoundingSphere
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.vec import Vec3, dot

MARGIN, LEAST_RADIUS = 1.001, 1e-6  # of spheres
MOST_TARGETS = 8  # spheres; code grows with them
SHORTEST = 3  # depth of the shortest path to a lamp in a mirror


def ideal_surfaces(scene: SceneTensors) -> tuple[BoundingSphere, ...]:
    """Spheres around the surfaces of each material with ideal lobes, or one around all of many; none: there is none."""
    some = narrow_triangles(scene)
    found = spheres_around(scene, some, scene.triangles.material[some])
    if found is None:
        return ()
    return tuple(BoundingSphere(Vec3(*middle), radius) for *middle, radius in zip(*found.middle, found.radius))


def guide_spheres(scene: SceneTensors) -> GuideSpheres | None:
    """Where lamps may be seen in mirrors and glass; None: there are no such, or none is a lamp of finite extent.

    Not of groups that are instanced, nor among media with boundaries.
    """
    triangles, layout = scene.triangles, scene.layout
    if triangles.instances is not None or layout.traces_segments or not layout.visible_surfaces:
        return None
    narrow, lit = narrow_triangles(scene), triangles.emitter >= 0
    texture = lookup(scene.lights.radiance, triangles.emitter[lit])
    mirrors, lamps = spheres_around(scene, narrow, triangles.material[narrow]), spheres_around(scene, lit, texture)
    if mirrors is None or lamps is None:
        return None
    each = len(lamps.radius)
    pairs, each = (torch.full((), count, dtype=torch.int32, device=scene.device) for count in (len(mirrors.radius) * each, each))
    return GuideSpheres(mirrors, lamps, pairs, each)


def with_guided_paths(integrand: Integrand) -> Integrand:
    """The integrand of a detached scene whose paths are sent to where mirrors show lamps, for light of which no derivative
    is taken; the same if there is nothing to find so."""
    spheres = guide_spheres(integrand.proposal) if integrand.max_depth >= SHORTEST and not integrand.attached else None
    if spheres is None:
        return integrand
    scene = integrand.proposal._replace(guiding=spheres)
    return integrand._replace(scene=scene, proposal=scene, parts={})


def narrow_triangles(scene: SceneTensors) -> Tensor:
    """(T,) bool: triangles of materials that scatter narrowly, if not invisible, by ideal lobes or all of them."""
    materials = scene.materials
    ideal = [look for look, of in enumerate(scene.layout.appearances) if of.kind.delta and not of.kind.invisible]
    of_rows = torch.isin(materials.appearance, torch.tensor(ideal, device=scene.device))
    by_side = (of_rows if materials.narrow is None else of_rows | materials.narrow).view(2, -1).any(0)
    return by_side[scene.triangles.material.long()]


def spheres_around(scene: SceneTensors, some: Tensor, kind: Tensor) -> BoundingSphere | None:
    """(K,) spheres around triangles of each kind, or one around all of many kinds; None: there is no triangle.

    Args:
        some: (T,) bool, the triangles.
        kind: int32, theirs.
    """
    met, group = kind.unique(return_inverse=True)
    if not len(met):
        return None
    if len(met) > MOST_TARGETS:
        met, group = met[:1], torch.zeros_like(group)
    points = torch.stack([torch.stack([part.detach()[corner[some].long()] for part in scene.triangles.vertices.p])
                          for corner in scene.triangles.corners])  # (3 corners, xyz, triangles)
    first, groups = points.new_zeros(3, len(met)), group.expand(3, -1)
    least, most = (first.scatter_reduce(1, groups, getattr(points, side)(0), side, include_self=False)
                   for side in ("amin", "amax"))
    middle = 0.5 * (least + most)
    squared = (points - middle[:, group]).square().sum(1).amax(0)
    squared = points.new_zeros(len(met)).scatter_reduce(0, group, squared, "amax", include_self=False)
    return BoundingSphere(Vec3(*middle), (MARGIN * squared.sqrt()).clamp_min(LEAST_RADIUS))


def sphere_around(low: Vec3, high: Vec3) -> BoundingSphere:
    """The sphere around a box, () each."""
    size = high - low
    return BoundingSphere((low + high) * 0.5, (0.5 * MARGIN * torch.sqrt(dot(size, size))).clamp_min(LEAST_RADIUS))
