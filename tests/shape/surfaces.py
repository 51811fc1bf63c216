"""What a ray meets on a shape alone."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from tests.scenes import load, sensor, texels
from torch_radbp.raycast import make_caster
from torch_radbp.scene.packing.pack import pack
from torch_radbp.scene.tables.part import part_of
from torch_radbp.tensors.vec import Ray, Vec3
from torch_radbp.vertex.interaction import SurfaceInteraction, surface_interaction

TEXTURED = {"type": "diffuse", "reflectance": {"type": "bitmap", "data": texels(2, 3)}}


def meets(origin: tuple[float, ...], direction: tuple[float, ...], objects: dict[str, Any]) -> SurfaceInteraction:
    """Where one ray, of a direction of any length, meets these objects, which are all of one appearance."""
    scene = pack(load(camera=sensor(2), sky={"type": "constant"}, **objects))
    ray = Ray(*(Vec3(*torch.tensor(row, dtype=torch.float64)[:, None].unbind(0)) for row in (origin, direction)))
    triangles = scene.triangles
    faces = torch.stack(triangles.corners, 1)
    instances = None if triangles.instances is None else triangles.instances.casting
    hit = make_caster("embree", triangles.vertices.p.stack().detach(), faces, triangles.balls, instances).intersect(ray)
    appearance, = scene.layout.appearances
    return surface_interaction(part_of(scene, appearance), ray, hit)


def of_point(si: SurfaceInteraction) -> tuple[float, Tensor, Tensor]:
    """The distance of a single interaction, (3,) its shading normal and (2,) its uv."""
    assert si.valid.all(), "the ray misses"
    return float(si.t), si.frame.n.stack()[0], torch.stack(si.point.uv, 1)[0]
