"""Warp's kernels for instances: a tree of triangles for each group, in its own frame, under a tree over all instances.

A ray walks the upper tree from near to far (`instance_tree.py`). In each instance whose box it meets, before the nearest hit
so far, it is transformed to the frame of the group, where a distance is as many t as in the world, for its direction is not
normalised. It begins where it enters the ball around the group: there numbers are as small as the group, so that roundings
are, and the boxes of its tree are wide enough wherever the ray comes from. Triangles that no instance shows are a group of
their own, which is asked first.
"""

from collections.abc import Sequence
from typing import NamedTuple

import torch
import warp as wp
from torch import Tensor

from torch_radbp.interface.instances import Instances
from torch_radbp.raycast.instance_tree import instance_tree
from torch_radbp.raycast.warp_few import four_of
from torch_radbp.raycast.warp_rays import FARTHEST, factor_of, is_beyond, query_of
from torch_radbp.raycast.warp_tree import in_units, lanes_of, triangle_tree
from torch_radbp.tensors.asked_later import answered
from torch_radbp.transforms import matrix_inverse

wp.set_module_options({"enable_backward": False})
ROUNDINGS = 4  # of float32: how much wider boxes are, in units of the largest number that is added up for a corner
LARGE = wp.constant(1e36)  # the most that the inverse of a direction's component is
ROUNDED_UP = wp.constant(1.0 + 2.0**-21)  # t at which a ray leaves a box is at most so much more than it is computed


class GroupMesh(NamedTuple):
    """The tree of a group of shapes, and the triangles that it was built over, in the group's frame."""

    tree: wp.Mesh
    vertices: Tensor  # (V, 3)
    faces: Tensor  # (F, 3) int32, rows of `vertices`
    unit: Tensor  # () float64, the power of two by which the tree's numbers are greater
    ball: Tensor  # (4,) float64, the middle and the radius of a ball around the group, in the tree's numbers


class ShownGroups(NamedTuple):
    """The tables of a scene with instances that kernels read: an upper tree of L leaves, and triangles of no group."""

    groups: list[GroupMesh]  # the last is what no instance shows, if there is such
    nodes: Tensor  # (4 L, 4) float32, the lower and the upper corner of each node of the upper tree; the last column is 0
    places: Tensor  # (4 L + 4, 4) float32: rows of the transform from the world, with the group's origin; the ball
    shown: Tensor  # (2 L + 2,) int32: the instance as in a hit, and the first triangle of the group
    trees: Tensor  # (L + 1,) int64, the addresses of the groups' trees; 0: none

    def head(self) -> list:
        """The arguments that kernels get before those of the rays: the upper tree, transforms, and the groups' trees."""
        nodes, places = (wp.from_torch(table, dtype=wp.vec4, return_ctype=True) for table in (self.nodes, self.places))
        trees = wp.from_torch(self.trees, dtype=wp.uint64, return_ctype=True)
        return [nodes, places, lanes_of(self.shown), trees, len(self.trees) - 1]


def shown_groups(groups: list[GroupMesh], instances: Instances, unit: float) -> ShownGroups:
    """Builds the tree over the instances of groups.

    Args:
        groups: as by `group_meshes`.
        instances: of these.
        unit: the factor from world units to the units in which rays are cast.
    """
    corners, to_world = instances.boxes.double() * unit, instances.to_world.double()
    largest = corners.abs().amax((1, 2)) + 2 * unit * to_world[:, :, 3].abs().amax(1)
    wider = ROUNDINGS * torch.finfo(torch.float32).eps * largest[:, None]
    nodes, order = instance_tree((corners.amin(1) - wider).float(), (corners.amax(1) + wider).float())

    # A row for each instance, then one for what none shows: for nobody, if there is no such thing.
    counts, firsts = [*instances.counts(), 1], [*instances.first_triangle[:-1], 0]
    of_rows = groups if len(groups) == len(counts) else [*groups, groups[0]]
    addresses = [group.tree.id for group in groups] + [0] * (len(counts) - len(groups))
    tree, first_triangle = (torch.cat([torch.full((count,), number, device=corners.device) for number, count in zip(
        numbers, counts)]) for numbers in (addresses, firsts))
    units = _repeated(torch.stack([group.unit for group in of_rows])[:, None, None], counts) / unit
    balls = _repeated(torch.stack([group.ball for group in of_rows])[:, None], counts)
    to_world = torch.nn.functional.pad(to_world, (0, 0, 0, 0, 0, 1))
    to_world[-1].fill_diagonal_(1.0)
    places = torch.cat([torch.cat([matrix_inverse(to_world[:, :, :3]) * units, to_world[:, :, 3:] * unit], 2), balls], 1)
    leaf = torch.nn.functional.pad(order, (0, 1), value=len(to_world) - 1).clamp_min(0)
    shown = torch.stack([torch.nn.functional.pad(order + 1, (0, 1)), first_triangle[leaf]], 1)
    return ShownGroups(groups, torch.nn.functional.pad(nodes, (0, 1)).flatten(0, 1).contiguous(),
                       places[leaf].float().flatten(0, 1).contiguous(), shown.to(torch.int32).flatten(), tree[leaf])


def _repeated(rows: Tensor, counts: Sequence[int]) -> Tensor:
    """Repeats the rows of a table, each so often."""
    return torch.cat([row.expand(count, *row.shape) for row, count in zip(rows, counts)])


def group_meshes(vertices: Tensor, faces: Tensor, instances: Instances, last: Sequence[GroupMesh], unmoved: bool,
                 stream: wp.Stream | None) -> list[GroupMesh]:
    """The trees of the groups, and of triangles outside of groups, if any; trees of unchanged triangles are reused.

    Args:
        vertices: (V, 3) of the scene and of its groups.
        faces: (T, 3) int32, likewise.
        instances: of the groups.
        last: those of the caster that this one follows.
        unmoved: their triangles are known to be unchanged.
        stream: on which trees are built; None on the CPU.
    """
    ends = list(zip(instances.first_vertex, instances.first_triangle))
    spans = [*zip(ends, ends[1:]), *([((0, 0), ends[0])] if ends[0][1] else [])]
    parts = [(vertices[start[0]:end[0]], faces[start[1]:end[1]] - start[0]) for start, end in spans]
    same = [True] * len(last) if unmoved else equal_groups(parts, last)
    return [last[number] if number < len(last) and same[number] else new_group(*part, stream)
            for number, part in enumerate(parts)]


def equal_groups(parts: Sequence[tuple[Tensor, Tensor]], last: Sequence[GroupMesh]) -> list[bool]:
    """For each group of `last`, whether it has the triangles of the part with its index; the device is read once."""
    alike = [each.vertices.shape == vertices.shape and each.faces.shape == faces.shape
             for each, (vertices, faces) in zip(last, parts)]
    found = iter(answered([((each.vertices == vertices).all() & (each.faces == faces).all())
                           for each, (vertices, faces), asked in zip(last, parts, alike) if asked]))
    return [each and bool(next(found)) for each in alike]


def new_group(vertices: Tensor, faces: Tensor, stream: wp.Stream | None) -> GroupMesh:
    """Builds the tree of a group, (V, 3) and (F, 3)."""
    low, high = vertices.float().double().aminmax(dim=0)
    extent = (high - low).amax()
    unit = torch.ldexp(torch.ones_like(extent), -torch.frexp(extent).exponent.clamp(-120, 120))
    ball = torch.cat([(low + high) / 2, (high - low).norm(dim=0, keepdim=True) * 0.5]) * unit
    return GroupMesh(triangle_tree(in_units(vertices.float()[faces.long()], unit.float()), stream), vertices, faces, unit,
                     ball)


# -- Kernels ------------------------------------------------------------------------------------------------------------


@wp.struct
class Cursor:
    """The state of a walk through the tree over instances: a node, and the nodes left to visit."""

    node: int  # 0: behind the last one
    pending: int  # bits: whether the neighbour of the node, of its parent and so on is still to be visited


@wp.struct
class GroupRay:
    """A ray in the frame of a group, in the units of its tree."""

    o: wp.vec3  # where it enters the ball around the group, or begins in it
    d: wp.vec3
    start: float  # t there, of the ray in the world
    per_t: float  # t in the world per t of this ray, but for rays of extreme lengths 1


@wp.func
def box_entry(nodes: wp.array(dtype=wp.vec4), node: int, o: wp.vec3, inverse: wp.vec3) -> float:
    """t >= 0 at which a ray enters the box of a node; `FARTHEST` if it does not."""
    lower, upper = four_of(nodes, 2 * node), four_of(nodes, 2 * node + 1)
    near, far = float(0.0), float(FARTHEST)  # noqa: UP018 (variables of Warp's, not constants)
    for axis in range(3):
        forwards = inverse[axis] > 0.0  # so that an empty box, whose corners are the other way round, is never entered
        near = wp.max(near, (wp.where(forwards, lower[axis], upper[axis]) - o[axis]) * inverse[axis])
        far = wp.min(far, (wp.where(forwards, upper[axis], lower[axis]) - o[axis]) * inverse[axis])
    return wp.where(near <= far * ROUNDED_UP, near, FARTHEST)


@wp.func
def back(cursor: Cursor) -> Cursor:
    """Moves on from a node that is done to the next node to visit."""
    node, pending = int(cursor.node), int(cursor.pending)
    if pending == 0:
        return Cursor(0, 0)
    while (pending & 1) == 0:
        node = node >> 1
        pending = pending >> 1
    return Cursor(node ^ 1, pending ^ 1)


@wp.func
def next_instance(nodes: wp.array(dtype=wp.vec4), leaves: int, o: wp.vec3, inverse: wp.vec3, end: float,
                  cursor: Cursor) -> Cursor:
    """Moves on to the next leaf whose box the ray enters before `end`, the nearer one of two neighbours first."""
    at = Cursor(cursor.node, cursor.pending)
    while at.node > 0 and at.node < leaves:
        first, second = box_entry(nodes, 2 * at.node, o, inverse), box_entry(nodes, 2 * at.node + 1, o, inverse)
        if wp.min(first, second) < end:
            at = Cursor(2 * at.node + wp.where(second < first, 1, 0),
                        2 * at.pending + wp.where(wp.max(first, second) < end, 1, 0))
        else:
            at = back(at)
    return at


@wp.func
def inverse_of(d: wp.vec3) -> wp.vec3:
    """One over the components of a direction, finite."""
    found = wp.vec3()
    for axis in range(3):
        found[axis] = wp.where(wp.abs(d[axis]) * LARGE < 1.0, LARGE, 1.0 / d[axis])
    return found


@wp.func
def in_group(places: wp.array(dtype=wp.vec4), leaf: int, o: wp.vec3, d: wp.vec3) -> GroupRay:
    """The ray in the frame of the group that an instance shows."""
    x, y, z = four_of(places, 4 * leaf), four_of(places, 4 * leaf + 1), four_of(places, 4 * leaf + 2)
    ball = four_of(places, 4 * leaf + 3)
    off = o - wp.vec3(x[3], y[3], z[3])
    found = GroupRay()
    found.d = wp.vec3(row_product(x, d), row_product(y, d), row_product(z, d))
    factor = factor_of(found.d)
    found.d = found.d * factor
    found.o = wp.vec3(row_product(x, off), row_product(y, off), row_product(z, off))
    length = wp.length(found.d)
    start = wp.max((wp.dot(wp.vec3(ball[0], ball[1], ball[2]) - found.o, found.d) / length - ball[3]) / length, 0.0)
    found.o = found.o + start * found.d
    found.start = start * factor
    found.per_t = factor
    return found


@wp.func
def row_product(row: wp.vec4, v: wp.vec3) -> float:
    """The product of a row of a matrix and a vector."""
    return row[0] * v[0] + row[1] * v[1] + row[2] * v[2]


@wp.kernel
def closest_of_groups(nodes: wp.array(dtype=wp.vec4), places: wp.array(dtype=wp.vec4), shown: wp.array(dtype=int),
                      trees: wp.array(dtype=wp.uint64), leaves: int, unit: float,
                      last: wp.array(dtype=wp.int64), rays: wp.array(dtype=wp.int64),
                      ox: wp.array(dtype=float), oy: wp.array(dtype=float), oz: wp.array(dtype=float),
                      dx: wp.array(dtype=float), dy: wp.array(dtype=float), dz: wp.array(dtype=float),
                      prim: wp.array(dtype=int), u: wp.array(dtype=float), v: wp.array(dtype=float),
                      t: wp.array(dtype=float), instance: wp.array(dtype=int)):
    """The GPU kernel that finds the closest hits of rays by the trees of groups and instances, one thread per ray."""
    lane = wp.tid()
    if is_beyond(lane, last, rays):
        return
    prim[lane] = -1
    u[lane] = 0.0
    v[lane] = 0.0
    t[lane] = 0.0
    instance[lane] = 0
    query = query_of(unit, ox[lane], oy[lane], oz[lane], dx[lane], dy[lane], dz[lane])
    if not query.valid:
        return
    inverse, end = inverse_of(query.d), float(FARTHEST)
    leaf, cursor = int(leaves), Cursor(1, 0)  # what no instance shows comes behind all leaves, and first of all
    while leaf >= 0:
        ray = in_group(places, leaf, query.o, query.d)
        if trees[leaf] != wp.uint64(0) and ray.start < end:
            hit = wp.mesh_query_ray(trees[leaf], ray.o, ray.d, wp.min((end - ray.start) / ray.per_t, FARTHEST))
            if hit.result:
                end = ray.start + hit.t * ray.per_t
                prim[lane] = shown[2 * leaf + 1] + hit.face
                u[lane] = hit.v  # Warp's u and v are the weights of the first and the second vertex
                v[lane] = wp.max(1.0 - hit.u - hit.v, 0.0)
                t[lane] = end / query.per_t
                instance[lane] = shown[2 * leaf]
        cursor = next_instance(nodes, leaves, query.o, inverse, end, cursor)
        leaf = cursor.node - leaves
        cursor = back(cursor)


@wp.kernel
def any_of_groups(nodes: wp.array(dtype=wp.vec4), places: wp.array(dtype=wp.vec4), shown: wp.array(dtype=int),
                  trees: wp.array(dtype=wp.uint64), leaves: int, unit: float,
                  last: wp.array(dtype=wp.int64), rays: wp.array(dtype=wp.int64),
                  ox: wp.array(dtype=float), oy: wp.array(dtype=float), oz: wp.array(dtype=float),
                  dx: wp.array(dtype=float), dy: wp.array(dtype=float), dz: wp.array(dtype=float),
                  tmax: wp.array(dtype=float), hidden: wp.array(dtype=wp.bool)):
    """The GPU kernel that tells by the trees of groups and instances whether segments are occluded, one thread per ray,
    which ends at the first hit."""
    lane = wp.tid()
    if is_beyond(lane, last, rays):
        return
    hidden[lane] = False
    query = query_of(unit, ox[lane], oy[lane], oz[lane], dx[lane], dy[lane], dz[lane])
    if not query.valid or not tmax[lane] > 0.0:
        return
    inverse, end = inverse_of(query.d), wp.min(tmax[lane] * query.per_t, FARTHEST)
    leaf, cursor = int(leaves), Cursor(1, 0)
    while leaf >= 0:
        ray = in_group(places, leaf, query.o, query.d)
        if trees[leaf] != wp.uint64(0) and ray.start < end:
            if wp.mesh_query_ray_anyhit(trees[leaf], ray.o, ray.d, wp.min((end - ray.start) / ray.per_t, FARTHEST)):
                hidden[lane] = True
                return
        cursor = next_instance(nodes, leaves, query.o, inverse, end, cursor)
        leaf = cursor.node - leaves
        cursor = back(cursor)
