"""Kernels that count what rays are tested against in trees, in the order in which `raycast/warp.py` has them searched."""

from typing import NamedTuple

import torch
import warp as wp
from torch import Tensor

from benchmarks.lbvh import FlatTree, joined, tree_of
from benchmarks.rays import Query
from torch_radbp.interface.instances import Instances
from torch_radbp.raycast.warp import Warp
from torch_radbp.raycast.warp_instances import Cursor, back, box_entry, in_group, inverse_of
from torch_radbp.raycast.warp_rays import FARTHEST
from torch_radbp.raycast.warp_tree import in_units

wp.set_module_options({"enable_backward": False})
TOGETHER = wp.constant(32)  # rays that wait for each other
LOOPS, STEPS = 32, 512  # of each ray, and of each loop; what comes behind these counts with the last one
Stack = wp.types.vector(length=64, dtype=wp.int32)


@wp.struct
class Flat:
    """A `FlatTree` in a kernel."""

    lower: wp.array(dtype=wp.vec3)
    upper: wp.array(dtype=wp.vec3)
    links: wp.array(dtype=wp.vec3i)
    prims: wp.array(dtype=wp.int32)
    corners: wp.array(dtype=wp.vec3)


@wp.struct
class Search:
    """What a ray has met in a tree, and what it was tested against."""

    t: float
    boxes: int
    triangles: int


@wp.func
def box_at(tree: Flat, node: int, o: wp.vec3, inverse: wp.vec3) -> float:
    """t at which a ray enters the box of a node; `FARTHEST` if it does not."""
    one, other = wp.cw_mul(tree.lower[node] - o, inverse), wp.cw_mul(tree.upper[node] - o, inverse)
    near, far = wp.max(wp.min(one, other)), wp.min(wp.max(one, other))
    return wp.where(far >= 0.0 and far >= near, near, FARTHEST)


@wp.func
def triangle_at(tree: Flat, prim: int, o: wp.vec3, d: wp.vec3) -> float:
    """t at which a ray meets a triangle; `FARTHEST` if it does not."""
    a = tree.corners[3 * prim]
    e1, e2 = tree.corners[3 * prim + 1] - a, tree.corners[3 * prim + 2] - a
    across = wp.cross(d, e2)
    volume = wp.dot(e1, across)
    off = o - a
    turned = wp.cross(off, e1)
    u, v, t = wp.dot(off, across) / volume, wp.dot(d, turned) / volume, wp.dot(e2, turned) / volume
    return wp.where(volume != 0.0 and u >= 0.0 and v >= 0.0 and u + v <= 1.0 and t >= 0.0, t, FARTHEST)


@wp.func
def search(tree: Flat, root: int, o: wp.vec3, d: wp.vec3, end: float, shadow: bool, warp: int, loop: int,
           waits: wp.array(dtype=int, ndim=4)) -> Search:
    """Looks for the nearest triangle before `end`, or for any, in the order of Warp's `mesh_query_ray`.

    Others wait while a ray is tested: `waits` has the most of each step of the loop, of boxes and of triangles.
    """
    stack, depth, node, step = Stack(), int(0), int(root), int(0)  # noqa: UP018 (variables of Warp's, not constants)
    best, boxes, triangles = float(end), int(0), int(0)  # noqa: UP018
    inverse = inverse_of(d)
    while node >= 0:
        link = tree.links[node]
        onwards = int(-1)  # noqa: UP018
        if link[2] == 1:
            before = int(triangles)
            for place in range(link[0], link[1]):
                if not (shadow and best < end):
                    triangles = triangles + 1
                    best = wp.min(best, triangle_at(tree, tree.prims[place], o, d))
            waits[warp, loop, step, 1] = wp.max(waits[warp, loop, step, 1], triangles - before)
        else:
            boxes = boxes + 2
            waits[warp, loop, step, 0] = 2
            first, second = box_at(tree, link[0], o, inverse), box_at(tree, link[1], o, inverse)
            if wp.min(first, second) < best:
                onwards = wp.where(first < second, link[0], link[1])
                if wp.max(first, second) < best:
                    stack[depth] = wp.where(first < second, link[1], link[0])
                    depth = depth + 1
        if onwards < 0 and depth > 0 and not (shadow and best < end):
            depth = depth - 1
            onwards = stack[depth]
        node = onwards
        step = wp.min(step + 1, waits.shape[2] - 1)
    return Search(best, boxes, triangles)


@wp.kernel
def count(tree: Flat, root: int, shadow: bool, o: wp.array(dtype=wp.vec3), d: wp.array(dtype=wp.vec3),
          tmax: wp.array(dtype=float), counts: wp.array(dtype=int, ndim=2), waits: wp.array(dtype=int, ndim=4),
          t: wp.array(dtype=float)):
    """Boxes and triangles of each ray."""
    lane = wp.tid()
    if tmax[lane] > 0.0:
        found = search(tree, root, o[lane], d[lane], tmax[lane], shadow, lane // TOGETHER, 0, waits)
        counts[lane, 0] = found.boxes
        counts[lane, 1] = found.triangles
        t[lane] = found.t


@wp.kernel
def count_in_instances(tree: Flat, nodes: wp.array(dtype=wp.vec4), places: wp.array(dtype=wp.vec4),
                       roots: wp.array(dtype=int), shadow: bool, o: wp.array(dtype=wp.vec3), d: wp.array(dtype=wp.vec3),
                       tmax: wp.array(dtype=float), counts: wp.array(dtype=int, ndim=2),
                       waits: wp.array(dtype=int, ndim=4), t: wp.array(dtype=float)):
    """Boxes, triangles and instances of each ray, in turns of a search in an instance and a walk to the next one."""
    lane = wp.tid()
    end, met = float(tmax[lane]), bool(False)  # noqa: UP018
    if end > 0.0:
        leaves, loop, inverse = int(roots.shape[0]) - 1, int(0), inverse_of(d[lane])  # noqa: UP018
        leaf, at = int(leaves), Cursor(1, 0)
        while leaf >= 0 and not (shadow and met):
            ray = in_group(places, leaf, o[lane], d[lane])
            if roots[leaf] >= 0 and ray.start < end:
                found = search(tree, roots[leaf], ray.o, ray.d, (end - ray.start) / ray.per_t, shadow, lane // TOGETHER,
                               loop, waits)
                counts[lane, 0] = counts[lane, 0] + found.boxes
                counts[lane, 1] = counts[lane, 1] + found.triangles
                if ray.start + found.t * ray.per_t < end:
                    met = True
                    end = ray.start + found.t * ray.per_t
            step = int(0)  # noqa: UP018
            while at.node > 0 and at.node < leaves:  # as `next_instance`
                counts[lane, 0] = counts[lane, 0] + 2
                waits[lane // TOGETHER, loop + 1, step, 0] = 2
                step = wp.min(step + 1, waits.shape[2] - 1)
                first = box_entry(nodes, 2 * at.node, o[lane], inverse)
                second = box_entry(nodes, 2 * at.node + 1, o[lane], inverse)
                if wp.min(first, second) < end:
                    at = Cursor(2 * at.node + wp.where(second < first, 1, 0),
                                2 * at.pending + wp.where(wp.max(first, second) < end, 1, 0))
                else:
                    at = back(at)
            leaf = at.node - leaves
            if leaf >= 0:
                counts[lane, 2] = counts[lane, 2] + 1
            at = back(at)
            loop = wp.min(loop + 2, waits.shape[1] - 2)
        t[lane] = end


class Counts(NamedTuple):
    """What rays are tested against, a ray on average."""

    boxes: float
    triangles: float
    instances: float  # that it is transformed into
    boxes_together: float  # of rays that wait for each other: sums over steps of what one of them does at the most
    triangles_together: float

    @staticmethod
    def of(counts: Tensor, waits: Tensor) -> "Counts":
        """Of (N, 3) boxes, triangles and instances of each ray, and (W, loops, steps, 2) waits of each `TOGETHER`."""
        return Counts(*counts.double().mean(0).tolist(), *waits.sum((1, 2)).double().mean(0).tolist())


def empty_counts(lanes: int, loops: int) -> tuple[Tensor, Tensor, Tensor]:
    """Counts, waits and t of some rays, 0."""
    return (torch.zeros(lanes, 3, dtype=torch.int32), torch.zeros(-(-lanes // TOGETHER), loops, STEPS, 2, dtype=torch.int32),
            torch.zeros(lanes))


def columns_of_query(query: Query, unit: float) -> tuple[Tensor, Tensor, Tensor, bool]:
    """Origins, directions, ends and kind of rays, in the units of trees."""
    o, d = (torch.stack(tuple(vector), 1).float().mul_(unit) for vector in query.ray)
    shadow = query.tmax is not None
    return o, d, query.tmax.float() if shadow else torch.full((len(o),), float(FARTHEST)), shadow


def given(tree: FlatTree, corners: Tensor) -> Flat:
    """The tree as kernels take it; the arrays live as long."""
    flat = Flat()
    flat.lower, flat.upper = (wp.array(each, dtype=wp.vec3, device="cpu") for each in (tree.lower, tree.upper))
    flat.links, flat.prims = wp.array(tree.links, dtype=wp.vec3i, device="cpu"), wp.array(tree.prims, device="cpu")
    flat.corners = wp.from_torch(corners.flatten(0, 1).contiguous(), dtype=wp.vec3)
    return flat


def counted(tree: Flat, root: int, query: Query, unit: float) -> tuple[Counts, Tensor]:
    """Counts for rays in one tree, and t where they end."""
    o, d, tmax, shadow = columns_of_query(query, unit)
    counts, waits, t = empty_counts(len(o), 1)
    wp.launch(count, len(o), [tree, root, shadow, *(wp.from_torch(each, dtype=wp.vec3) for each in (o, d)),
                              *map(wp.from_torch, (tmax, counts, waits, t))], device="cpu")
    return Counts.of(counts, waits), t


class TwoLevels(NamedTuple):
    """The trees of a scene with instances."""

    tree: Flat  # of all groups and of the triangles that no instance shows
    nodes: int
    upper: Tensor  # (4 L, 4), see `ShownGroups`
    places: Tensor
    roots: Tensor  # (L + 1,) int32, of the group that each leaf shows, and of what none shows; -1: there is none
    unit: float

    @staticmethod
    def of(vertices: Tensor, faces: Tensor, instances: Instances, constructor: str, leaf_size: int) -> "TwoLevels":
        """The trees of a scene, as for `Warp`."""
        caster = Warp(vertices, faces, instances=instances)
        shown = caster._geometry
        parts = [in_units(group.vertices.float()[group.faces.long()], group.unit.float()) for group in shown.groups]
        tree = joined([tree_of(constructor, leaf_size, part) for part in parts])
        root_of = {0: -1, **dict(zip([group.tree.id for group in shown.groups], tree.roots))}
        roots = torch.tensor([root_of[address] for address in shown.trees.tolist()], dtype=torch.int32)
        return TwoLevels(given(tree, torch.cat(parts)), tree.nodes + len(shown.nodes) // 2, shown.nodes, shown.places, roots,
                         caster._unit)

    def counted(self, query: Query) -> tuple[Counts, Tensor]:
        """Counts for rays, and t where they end."""
        o, d, tmax, shadow = columns_of_query(query, self.unit)
        counts, waits, t = empty_counts(len(o), LOOPS)
        tables = (wp.from_torch(table, dtype=wp.vec4) for table in (self.upper, self.places))
        rays = (wp.from_torch(each, dtype=wp.vec3) for each in (o, d))
        wp.launch(count_in_instances, len(o), [self.tree, *tables, wp.from_torch(self.roots), shadow, *rays,
                                               *map(wp.from_torch, (tmax, counts, waits, t))], device="cpu")
        return Counts.of(counts, waits), t
