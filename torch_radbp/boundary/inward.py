"""Closed surfaces that face inwards, and so are black from outside."""

from __future__ import annotations

import torch

from torch_radbp.boundary.edges import edges_of
from torch_radbp.boundary.rendering import Rendering, listed
from torch_radbp.boundary.shadow import ray_from
from torch_radbp.boundary.sky import rays_of
from torch_radbp.bsdf.twosided import TwoSided
from torch_radbp.plugin import SceneWarning
from torch_radbp.scene.attributes import with_nested
from torch_radbp.scene.geometry import PlacedShape
from torch_radbp.scene.interaction import is_in_front
from torch_radbp.scene.tensors import proposal_of
from torch_radbp.shape.surface import Surface

RIM = 0.1  # share of the camera rays that meet the front of a smooth surface at most, where it is seen at grazing angles
BLOCK = 1 << 16  # triangles that are examined together
OPEN = 1e-3  # ratio of the sum of area-weighted normals to the area from which a surface is not closed


def inward_faces(rendering: Rendering) -> SceneWarning | None:
    """The warning that the camera sees closed surfaces from outside whose one-sided faces point inwards, or None.

    Such a surface encloses a negative volume, and the camera rays that meet it meet it from behind, but for some at the rim,
    where normals of vertices turn back. A room that is seen from inside faces inwards, too, but is met from the front.
    """
    inward = [number for number, (shape, placed) in enumerate(zip(rendering.shapes, rendering.placed))
              if is_one_sided(shape) and has_negative_volume(placed)]
    if not inward:
        return None
    o, d, seen = (torch.cat(part) for part in zip(*map(rays_of, rendering.sights)))
    ray = ray_from(o[seen], d[seen])
    hit = rendering.caster.intersect(ray)
    tensors, dtype = proposal_of(rendering.tensors), rendering.scene.dtype
    front = is_in_front(tensors, ray._replace(d=ray.d.map(lambda part: part.to(dtype))),
                        hit._replace(u=hit.u.to(dtype), v=hit.v.to(dtype)))
    shape = torch.where(hit.prim >= 0, rendering.shape_of[hit.prim.clamp_min(0).long()], -1)
    black = [number for number in inward if (shape == number).any() and front[shape == number].double().mean() < RIM
             and is_closed(rendering.placed[number])]
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


def has_negative_volume(placed: PlacedShape) -> bool:
    """True if a surface may enclose a volume, to which it turns its fronts; a quick look without regard to neighbours."""
    vertices, normals = placed.vertices, placed.surface.normals
    volume, area, outwards = 0.0, 0.0, vertices.new_zeros(3, dtype=torch.float64)
    for faces in placed.faces.long().split(BLOCK):
        first, second, third = (vertices[corner].double() - vertices[0] for corner in faces.unbind(1))
        n = torch.linalg.cross(second - first, third - first)
        fronts = 1.0 if normals is None else torch.sign((normals.detach()[faces].sum(1) * n).sum(1))
        volume = volume + ((first * n).sum(1) * fronts).sum()
        area, outwards = area + n.norm(dim=1).sum(), outwards + n.sum(0)
    return bool(volume < 0) and bool(outwards.norm() < OPEN * area)


def is_closed(placed: PlacedShape) -> bool:
    """True if two triangles meet at each edge of a surface."""
    edges = edges_of(placed.vertices, placed.faces)
    return bool((torch.bincount(edges.edge, minlength=len(edges.a)) == 2).all())
