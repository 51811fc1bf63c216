"""The first difference of two camera paths from neighbouring points of the film, between which the image may jump."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.boundary.eye.ideal_paths import IdealPath, Vertices
from torch_radbp.boundary.eye.ideal_steps import FRONT, LIT, ONWARDS, OUTSIDE, THROUGH, Reached
from torch_radbp.boundary.eye.surfaces import Surfaces
from torch_radbp.jit.arguments import PreparedArgument
from torch_radbp.jit.cpu.board import board
from torch_radbp.jit.dual import tangents_and_tensors
from torch_radbp.jit.order import chosen
from torch_radbp.jit.tape import Played, Tape, structure_of
from torch_radbp.path.integrand import int32_number as number_of
from torch_radbp.path.lanes import put_rows
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.stage import Stages, stage
from torch_radbp.tensors.torch_internals import inside_dual_level
from torch_radbp.tensors.vec import TINY, Vec3, dot, rows
from torch_radbp.vertex.interaction import triangle_normal

# How two paths part: one meets another surface; they meet different sides of a surface, by its shading normals; a texture
# jumps between them; chance lets one go another way, which is no jump; they leave the surface on different sides of its
# triangles; light reaches only one of their ends; or they meet what seems to be one smooth surface, and nothing else
# differs.
SAME, SURFACE, RIM, TEXTURE, CHANCE, HORIZON, SHADOW, BENT = range(8)
LEAST = 0.05  # likelihood of a jump between points of what may be one smooth surface
LEAST_OF_CHANCE = 0.1  # the same where chance lets paths part
AT_ONCE = 0.5  # the same right beside what the camera sees without mirrors: at outlines of curved mirrors
BEND = 2.0  # sine of the angle between a surface and the way to a point of another, of which 1 / BEND is surely a jump
SMOOTH = 0.2  # BEND times that angle below which points of one smooth surface are taken to lie side by side


class Difference(NamedTuple):
    """The first difference between the two camera paths of each of N pairs."""

    kind: Tensor  # (N,) int32
    depth: Tensor  # (N,) int32, number of ideal vertices before; of a horizon its surface counts
    likelihood: Tensor  # (N,) float64, of a discontinuity between the two; 0 if the paths are alike
    alike: Tensor  # (N,) bool: no difference so far, and both go on


class Pairing(NamedTuple):
    """N pairs of camera paths, by their indices."""

    first: Tensor  # (N,) int64, rows of paths
    second: Tensor


def path_difference(stages: Stages, surfaces: Surfaces, path: IdealPath, pairs: Pairing) -> Difference:
    """The first vertex at which the two paths of each pair differ, and in what.

    Args:
        stages: runs the stages.
        surfaces: of the scene, prepared for the stages.
        path: the paths.
        pairs: pairs of these.
    """
    depths = tuple([number_of(depth, pairs.first.device) for depth in range(len(path))])
    if not isinstance(surfaces, PreparedArgument) or not len(pairs.first) or inside_dual_level():
        return depth_by_depth(stages, surfaces, path, pairs, depths)
    with board() as helpers:
        kind = stages, surfaces.form.structure, *structure_of((path, depths))
        tape = Tape(tangents_and_tensors((path, depths, surfaces.argument)), kind, board=helpers)
        played = tape.play(("difference",), lambda pairs: Played(depth_by_depth(stages, surfaces, path, pairs, depths)),
                           (pairs,), len(pairs.first))
    return depth_by_depth(stages, surfaces, path, pairs, depths) if played is None else played.results


def depth_by_depth(stages: Stages, surfaces: Surfaces, path: IdealPath, pairs: Pairing,
                   depths: tuple[Tensor, ...]) -> Difference:
    """The first vertex at which the two paths of each pair differ, and in what, found vertex by vertex.

    Args as for `path_difference`; `depths`: the numbers of the vertices as tensors.
    """
    found, whole = stages(unparted)(pairs), None
    for depth, vertices in zip(depths, path):
        found = stages(parted)(surfaces, vertices, pairs, found, depth)
        if whole is None:  # what parts at once, or meets nothing ideal, needs no further look
            whole, onwards = found, chosen(found.alike)
            pairs, found = stages(rows)((pairs, found), onwards)
    put_rows(whole, onwards, found)
    return whole


@stage()
def unparted(pairs: Pairing) -> Difference:
    """The state of pairs of paths before any vertices are compared: no difference yet."""
    nothing = torch.zeros_like(pairs.first, dtype=torch.int32)
    return Difference(nothing, nothing, torch.zeros_like(nothing, dtype=torch.float64),
                      torch.ones_like(nothing, dtype=torch.bool))


@stage("surfaces", "vertices")
def parted(surfaces: Surfaces, vertices: Vertices, pairs: Pairing, so_far: Difference, number: Tensor) -> Difference:
    """The first differences of pairs of paths after one more vertex is compared.

    Args:
        surfaces: of the scene.
        vertices: those of the paths after `number`, () int32, ideal vertices.
        pairs: of the paths.
        so_far: the differences at vertices before.
    """
    first, second = (lookup(vertices.place, own) for own in pairs)
    both = so_far.alike & (first >= 0) & (second >= 0)  # where only one of two goes on they have parted before
    one, other = (rows(vertices.met, place.clamp_min(0)) for place in (first, second))
    differs = one.what ^ other.what
    surely, bend = how_bent(surfaces, one, other)
    together = _meet_same_surface(surfaces, one, other)
    smooth = ~surely & ~together & part_of_one(surfaces, one, other) & (bend < SMOOTH)
    drawn = torch.zeros_like(both)
    for cell, another in zip(one.cells, other.cells):
        drawn = drawn | ((cell != another) & (one.hit.prim >= 0))
    met = torch.zeros_like(so_far.kind)
    for how, parts in ((BENT, smooth & ~(number == 0)), (SHADOW, (differs & LIT) != 0), (HORIZON, (differs & OUTSIDE) != 0),
                       (CHANCE, (differs & (ONWARDS | THROUGH)) != 0), (TEXTURE, drawn), (RIM, (differs & FRONT) != 0),
                       (SURFACE, ~(together | smooth))):
        met = torch.where(parts, how, met).to(met.dtype)  # the last of them counts
    likely = torch.where(met == CHANCE, LEAST_OF_CHANCE, torch.ones_like(bend))
    likely = torch.where((met == BENT) | (met == SURFACE), torch.where(surely, 1.0, bend.clamp(LEAST, 1.0)), likely)
    likely = torch.where((met == SAME), 0.0, likely)
    # What the camera sees at once is no matter of this term, unless something else is right beside it.
    likely = torch.where((number == 0) & (met != HORIZON) & (met != SAME), AT_ONCE, likely)
    tells = both & (met != SAME)
    known = tells & ~((met == BENT) & (so_far.kind != SAME))
    depth = number + (met == HORIZON).to(number.dtype)
    return Difference(torch.where(known, met, so_far.kind), torch.where(known, depth, so_far.depth),
                      torch.where(tells, torch.maximum(likely, so_far.likelihood), so_far.likelihood),
                      both & ((met == SAME) | (met == BENT)) & ((one.what & ONWARDS) != 0))


def _meet_same_surface(surfaces: Surfaces, one: Reached, other: Reached) -> Tensor:
    """(N,) bool: two rays hit the same triangle, or neighbours on a smooth surface, or both hit nothing."""
    same, there = one.hit.prim == other.hit.prim, one.hit.prim.clamp_min(0)
    near = torch.zeros_like(same)
    for side in range(3):
        near = near | (lookup(surfaces.smooth.continues, 3 * there + side) == other.hit.prim)
    same = same | (near & (one.hit.prim >= 0) & (other.hit.prim >= 0))
    return same if one.hit.instance is None else same & (one.hit.instance == other.hit.instance)


def part_of_one(surfaces: Surfaces, one: Reached, other: Reached) -> Tensor:
    """(N,) bool: two rays hit the same smooth surface, provided that they hit the same instance."""
    parts = [lookup(surfaces.smooth.part, met.hit.prim.clamp_min(0)) for met in (one, other)]
    return parts[0] == parts[1]


def how_bent(surfaces: Surfaces, one: Reached, other: Reached) -> tuple[Tensor, Tensor]:
    """Whether neighbouring rays surely hit different surfaces, and how bent the surface is from hit to hit; (N,) each.

    The latter is BEND times the sine of the greater angle between the line that joins the hits and the triangles there.
    """
    way = point_met(other) - point_met(one)
    length = torch.sqrt(dot(way, way)).clamp_min(TINY)
    bend = torch.zeros_like(length)
    for met in (one, other):
        bend = torch.maximum(bend, dot(triangle_normal(surfaces, met.hit).map(torch.Tensor.double), way).abs() / length)
    materials = [lookup(surfaces.triangles.material, met.hit.prim.clamp_min(0)) for met in (one, other)]
    surely = (one.hit.prim < 0) | (other.hit.prim < 0) | (materials[0] != materials[1]) | (
        ((one.what ^ other.what) & FRONT) != 0)
    if one.hit.instance is not None:
        surely = surely | (one.hit.instance != other.hit.instance)
    return surely, BEND * bend


def point_met(met: Reached) -> Vec3:
    """The points at which rays hit surfaces, (N,) world, float64."""
    o, d = (part.map(torch.Tensor.double) for part in met.ray)
    return o + d * met.hit.t.double()
