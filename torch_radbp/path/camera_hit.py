"""The closest visible surface on a camera ray: without hidden emitters, and not beyond the far plane."""

from __future__ import annotations

import torch

from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.sensor.kind import Camera
from torch_radbp.tensors.vec import Ray, dot, rows
from torch_radbp.vertex.interaction import surface_interaction


def camera_hit(caster, scene: SceneTensors, ray: Ray, clipping: Camera | None, hide_emitters: bool):
    """The closest surface that a camera sees along its rays, as a `raycast.Hit`.

    Args:
        caster: a `RayCaster`.
        scene: detached.
        ray: (N,) camera rays.
        clipping: the camera, if its far plane cuts the scene; else None.
        hide_emitters: True if the camera does not see emitters.
    """
    hit = caster.intersect(ray)
    if hide_emitters and scene.layout.lit_surfaces:
        hit = behind_emitters(caster, scene, ray, hit)
    if clipping is not None:
        p = surface_interaction(scene, ray, hit).p
        hit = hit._replace(prim=torch.where(clipping.beyond_far_plane(p), -1, hit.prim))
    return hit


def behind_emitters(caster, scene: SceneTensors, ray: Ray, hit):
    """The closest hits of rays on surfaces that emit no light; emitters in front of them are passed through."""
    while True:
        hidden = ((hit.prim >= 0) & (scene.triangles.emitter[hit.prim.clamp_min(0)] >= 0)).nonzero().squeeze(1)
        if len(hidden) == 0:
            return hit
        seen = rows(ray, hidden)
        si = surface_interaction(scene, seen, rows(hit, hidden))
        start = si.offset(seen.d)
        beyond = caster.intersect(Ray(start, seen.d))
        beyond = beyond._replace(t=beyond.t + dot(start - seen.o, seen.d))
        hit = type(hit)(*(None if old is None else old.index_copy(0, hidden, new) for old, new in zip(hit, beyond)))
