"""Warns of closed surfaces that face inwards, and so are black from outside."""

from __future__ import annotations

from itertools import accumulate

import torch
from torch import Tensor

from torch_radbp.boundary.curve.edges import edges_of
from torch_radbp.boundary.curve.rendering import Rendering, listed
from torch_radbp.boundary.warning.view_rays import ray_from, rays_of
from torch_radbp.bsdf.twosided import TwoSided
from torch_radbp.plugin import SceneWarning
from torch_radbp.scene.packing.attributes import with_nested
from torch_radbp.scene.tables.scene_tensors import TriangleTable, proposal_of
from torch_radbp.shape.surface import Surface
from torch_radbp.tensors.vec import rows
from torch_radbp.vertex.interaction import is_in_front

RIM = 0.1  # share of the camera rays that meet the front of a smooth surface at most, where it is seen at grazing angles
BLOCK = 1 << 16  # triangles that are examined together
OPEN = 1e-3  # ratio of the sum of area-weighted normals to the area from which a surface is not closed


def inward_faces(rendering: Rendering) -> SceneWarning | None:
    """The warning that closed surfaces seen from outside have one-sided faces that point inwards; None: none have.

    Such a surface encloses a negative volume, and camera rays hit it from behind, but for some at the rim, where vertex
    normals turn back. A room that is seen from inside faces inwards, too, but is hit from the front.
    """
    one_sided = [number for number, shape in enumerate(rendering.shapes) if is_one_sided(shape)]
    if not one_sided:
        return None
    tensors, ends = proposal_of(rendering.call.scene), list(accumulate(rendering.sizes))
    ranges = [range(last - size, last) for last, size in zip(ends, rendering.sizes)]

    def has_few_triangles(number: int) -> bool:
        return len(ranges[number]) <= BLOCK  # their volume is known sooner than what the camera meets

    suspects = [number for number in one_sided
                if not has_few_triangles(number) or has_negative_volume(tensors.triangles, ranges[number])]
    if not suspects:
        return None
    o, d, seen = (torch.cat(part) for part in zip(*map(rays_of, rendering.sights)))
    ray = ray_from(o[seen], d[seen])
    hit = rendering.call.caster.intersect(ray)
    dtype = rendering.scene.dtype
    front = is_in_front(tensors, ray._replace(d=ray.d.map(lambda part: part.to(dtype))),
                        hit._replace(u=hit.u.to(dtype), v=hit.v.to(dtype)))
    met = hit.prim >= 0
    shape = rendering.shape_of[hit.prim.clamp_min(0).long()]
    times, in_front = (shape[own].bincount(minlength=len(ranges)) for own in (met, met & front))
    behind = ((times > 0) & (in_front < RIM * times)).tolist()
    caster = rendering.call.caster
    black = [number for number in suspects if behind[number]
             and (has_few_triangles(number) or has_negative_volume(tensors.triangles, ranges[number]))
             and is_closed(caster.vertices, caster.faces[ranges[number].start:ranges[number].stop])]
    if not black:
        return None
    names = [rendering.names[id(rendering.shapes[number])] for number in black]
    whose = "its" if len(names) == 1 else "their"
    return SceneWarning(f"the faces of {listed(names)} point inwards, and {whose} material is seen from the front only: "
                        f"from outside, as the camera looks, they are black. Turn the faces by `flip_normals`, or wrap "
                        f"the material in a twosided")


def is_one_sided(shape: Surface) -> bool:
    """True if a surface is black from behind."""
    return not shape.bsdf.kind().transmits and not any(isinstance(part, TwoSided) for part in with_nested(shape.bsdf))


def has_negative_volume(triangles: TriangleTable, own: range) -> bool:
    """True if a surface may enclose a negative volume, as faces that point inwards do; a quick test without neighbours.

    Args:
        triangles: of the scene, detached.
        own: the rows of the surface.
    """
    vertices, volume, area = triangles.vertices, 0.0, 0.0
    outwards, origin = triangles.n.x.new_zeros(3, dtype=torch.float64), None
    for start in range(own.start, own.stop, BLOCK):
        block = slice(start, min(start + BLOCK, own.stop))
        corners = [corner[block] for corner in triangles.corners]
        first, second, third = (rows(vertices.p, corner).stack().double() for corner in corners)
        origin = first[0] if origin is None else origin
        n = torch.linalg.cross(second - first, third - first)
        fronts = torch.ones_like(n[:, 0])
        if vertices.n is not None:
            shaded = torch.sign((sum(rows(vertices.n, corner).stack() for corner in corners) * n).sum(1))
            fronts = shaded if triangles.smooth is None else torch.where(triangles.smooth[block], shaded, fronts)
        volume = volume + (((first - origin) * n).sum(1) * fronts).sum()
        area, outwards = area + n.norm(dim=1).sum(), outwards + n.sum(0)
    return bool(volume < 0) and bool(outwards.norm() < OPEN * area)


def is_closed(vertices: Tensor, faces: Tensor) -> bool:
    """True if each edge of a surface has exactly two triangles; args as of `edges_of`."""
    return bool((edges_of(vertices, faces).count == 2).all())
