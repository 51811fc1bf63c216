"""Whether curved mirrors and glass have black strips beside their outlines.

There interpolated normals lead light to the wrong side of triangles, in a strip as wide as these lie off the surface that
they stand for: light that is refracted, and light that a coarse mesh reflects. What a fine one reflects runs along its
triangles instead (see `vertex.outgoing_ray.above_triangle`).
"""

from __future__ import annotations

from typing import NamedTuple
from weakref import WeakKeyDictionary

import torch
from torch import Tensor

from torch_radbp.call.render_call import RenderCall
from torch_radbp.scene.cache.common_work import same_leaves
from torch_radbp.scene.modules.scene import Scene
from torch_radbp.scene.tables.placement import InstanceTable
from torch_radbp.scene.tables.scene_tensors import SceneTensors, of_triangles
from torch_radbp.scene.tables.triangle_corners import at_corners, is_fine
from torch_radbp.tensors.record import leaves_of
from torch_radbp.tensors.vec import dot, rows

ANGLES = 1e-5  # as a share of squared lengths, by which rounding may change products of the rows of a rotation


class KnownStrips(NamedTuple):
    """Whether a scene has black strips, cached together with what this depends on."""

    facts: list
    found: bool


KNOWN: WeakKeyDictionary[Scene, KnownStrips] = WeakKeyDictionary()


def has_black_strips(call: RenderCall) -> bool:
    """True if some mirror or glass of a call's scene may have black strips beside its outline; cached while triangles and
    materials are unchanged.

    Args:
        call: detached.
    """
    scene, known = call.scene, KNOWN.get(call.module)
    if not scene.layout.shading_normals:
        return False
    triangles, instances = scene.triangles, scene.triangles.instances
    facts = leaves_of((triangles.vertices.p, triangles.vertices.n, triangles.corners, triangles.smooth, triangles.material,
                       None if instances is None else instances.linear, scene.materials.appearance,
                       scene.layout.appearances))
    if known is None or not same_leaves(known.facts, facts):
        known = KNOWN[call.module] = KnownStrips(facts, black_strips(scene))
    return known.found


def black_strips(scene: SceneTensors) -> bool:
    """True if some triangle with interpolated normals refracts, or reflects ideally and belongs to a coarse mesh.

    Degenerate triangles, which no ray meets, do not count. Of a group that an instance distorts, so that it changes angles,
    all meshes count as coarse.

    Args:
        scene: detached, with shading normals.
    """
    if len(smooth_triangles(scene, transmits=True)):
        return True
    triangles, instances, own = scene.triangles, scene.triangles.instances, smooth_triangles(scene, transmits=False)
    n, corners = rows((triangles.n, triangles.corners), own)
    is_coarse = ~is_fine(n, at_corners(triangles.vertices.n, corners))
    if instances is not None and distorts(instances):
        is_coarse = is_coarse | (own >= instances.casting.first_triangle[0])
    return bool((is_coarse & (dot(n, n) > 0)).any())


def smooth_triangles(scene: SceneTensors, transmits: bool) -> Tensor:
    """(K,) int64, the triangles with interpolated normals whose material scatters ideally; `transmits`: to the other side,
    too, or not."""
    looks = torch.tensor([number for number, look in enumerate(scene.layout.appearances)
                          if look.kind.delta and not look.kind.invisible and look.kind.transmits == transmits],
                         dtype=torch.int32, device=scene.device)
    ideal = of_triangles(scene, torch.isin(scene.materials.appearance, looks))
    return (ideal if scene.triangles.smooth is None else ideal & scene.triangles.smooth).nonzero().squeeze(1)


def distorts(table: InstanceTable) -> bool:
    """True if the pose of an instance changes angles."""
    first, second, third = table.linear
    squared = torch.stack([dot(row, row) for row in table.linear])
    products = torch.stack([dot(first, second), dot(second, third), dot(third, first)])
    size = squared.mean(0)
    return bool((torch.cat([squared - size, products]).abs() > ANGLES * size).any())
