"""Where two camera paths from nearby points of the film part: between these the image may jump."""

from __future__ import annotations

from itertools import zip_longest
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.reflections.ideal_paths import IdealPath, Reached
from torch_radbp.boundary.reflections.surfaces import Surfaces
from torch_radbp.scene.interaction import triangle_normal
from torch_radbp.scene.tensors import SceneTensors
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.vec import TINY, Vec3, dot, rows

# How two paths part: one meets another surface; they meet different sides of a surface, by its shading normals; a texture
# jumps between them; chance lets one go another way, which is no jump; they leave the surface on different sides of its
# triangles; light reaches only one of their ends.
SAME, SURFACE, RIM, TEXTURE, CHANCE, HORIZON, SHADOW = range(7)
LEAST = 0.1  # likelihood of a jump between points of what may be one smooth surface
AT_ONCE = 0.5  # the same right beside what the camera sees without mirrors: at outlines of curved mirrors
BEND = 2.0  # sine of the angle between a surface and the way to a point of another, of which 1 / BEND is surely a jump


class Difference(NamedTuple):
    """How the paths of N pairs part."""

    kind: Tensor  # (N,) int64
    depth: Tensor  # (N,) int64, after how many ideal vertices; of a horizon that of the surface counts
    likelihood: Tensor  # (N,) float64, of a jump between the two; 0 if the paths are alike


def difference(scene: SceneTensors, surfaces: Surfaces, first: IdealPath, second: IdealPath) -> Difference:
    """How the paths of pairs part: by the first vertex at which they do.

    Args:
        scene: detached.
        surfaces: of the scene.
        first, second: (N,) each.
    """
    undecided = torch.ones_like(first[0].here)
    kind, depth = (torch.zeros(len(undecided), dtype=torch.int64, device=undecided.device) for _ in range(2))
    likelihood = torch.zeros(len(undecided), dtype=torch.float64, device=undecided.device)
    for number, (one, other) in enumerate(zip_longest(first, second)):
        if one is None or other is None:  # where only one of two goes on they have parted before
            break
        both = undecided & one.here & other.here
        together = joined(surfaces.continues, one, other)
        turned, sideways = one.front ^ other.front, one.outside ^ other.outside
        by_chance = (one.onwards ^ other.onwards) | (one.through ^ other.through)
        shadow, drawn = one.lit ^ other.lit, torch.zeros_like(turned)
        for cell, another in zip(one.cells, other.cells):
            drawn = drawn | ((cell != another) & (one.hit.prim >= 0))
        met = torch.full_like(kind, SAME)
        for how, parts in ((SHADOW, shadow), (HORIZON, sideways), (CHANCE, by_chance), (TEXTURE, drawn), (RIM, turned),
                           (SURFACE, ~together)):
            met = torch.where(parts, how, met)  # the last of them counts
        kind = torch.where(both, met, kind)
        depth = torch.where(both, number + (met == HORIZON).long(), depth)
        parts = both & (met != SAME)
        own = (parts & (met == SURFACE)).nonzero().squeeze(1)
        likelihood = torch.where(parts, torch.where(met == CHANCE, LEAST, 1.0), likelihood)
        if len(own):
            likelihood[own] = likelihood_of_jump(scene, *(rows(met, own) for met in (one, other)))
        if number == 0:  # what the camera sees at once is no matter of this term, unless something else is right beside it
            likelihood = torch.where(parts & (met != HORIZON), AT_ONCE, likelihood)
        undecided = both & ~parts & one.onwards
    return Difference(kind, depth, likelihood)


def joined(continues: Tensor, one: Reached, other: Reached) -> Tensor:
    """(N,) bool: two rays meet the same triangle, neighbours on a smooth surface, or both nothing."""
    same, there = one.hit.prim == other.hit.prim, one.hit.prim.clamp_min(0)
    near = torch.zeros_like(same)
    for side in range(3):
        near = near | (lookup(continues, 3 * there + side) == other.hit.prim)
    same = same | (near & (one.hit.prim >= 0) & (other.hit.prim >= 0))
    return same if one.hit.instance is None else same & (one.hit.instance == other.hit.instance)


def likelihood_of_jump(scene: SceneTensors, one: Reached, other: Reached) -> Tensor:
    """How likely a jump is between two different triangles that nearby rays meet; (N,) float64."""
    hits = one.hit.prim >= 0, other.hit.prim >= 0
    p, q = (point_met(met) for met in (one, other))
    way = q - p
    length = torch.sqrt(dot(way, way)).clamp_min(TINY)
    bend = torch.zeros_like(length)
    for met in (one, other):
        bend = torch.maximum(bend, dot(triangle_normal(scene, met.hit).map(torch.Tensor.double), way).abs() / length)
    materials = [lookup(scene.triangles.material, met.hit.prim.clamp_min(0)) for met in (one, other)]
    surely = ~(hits[0] & hits[1]) | (materials[0] != materials[1]) | (one.front ^ other.front)
    if one.hit.instance is not None:
        surely = surely | (one.hit.instance != other.hit.instance)
    return torch.where(surely, 1.0, (BEND * bend).clamp(LEAST, 1.0))


def point_met(met: Reached) -> Vec3:
    """Where rays meet surfaces, (N,) world, float64."""
    o, d = (part.map(torch.Tensor.double) for part in met.ray)
    return o + d * met.hit.t.double()
