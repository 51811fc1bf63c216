"""The trees of Warp's constructors as arrays: those of its CPU device, and "lbvh" by the rules of its `bvh.cu`."""

from __future__ import annotations

import ctypes
from typing import NamedTuple

import numpy as np
import warp as wp
from torch import Tensor

DEEPEST = 32  # nodes deeper than that are leaves


class FlatTree(NamedTuple):
    """A tree over the boxes of triangles."""

    lower: np.ndarray  # (N, 3) float32, of each node
    upper: np.ndarray  # (N, 3)
    links: np.ndarray  # (N, 3) int32: two nodes and 0, or the first place in `prims`, the one behind the last, and 1
    prims: np.ndarray  # (F,) int32, the triangles in the order of the leaves
    roots: list[int]

    @property
    def nodes(self) -> int:
        """The nodes that rays can come to."""
        count, level = 0, np.array(self.roots)
        while len(level):
            count += len(level)
            level = self.links[level[self.links[level, 2] == 0], :2].reshape(-1)
        return count


class HostTree(ctypes.Structure):
    """The beginning of Warp's `BVH`, of which a `Bvh` of the CPU has the address."""

    _fields_ = [(name, ctypes.c_void_p) for name in ("lowers", "uppers", "parents", "counts", "prims")] + [
        (name, ctypes.c_int) for name in ("max_depth", "max_nodes", "nodes", "leaves")] + [("root", ctypes.c_void_p)]


def tree_of(constructor: str, leaf_size: int, corners: Tensor) -> FlatTree:
    """The tree over triangles, (F, 3, 3) float32, in units as of ray casters."""
    low, high = corners.amin(1), corners.amax(1)
    if constructor == "lbvh":
        return lbvh(low.numpy(), high.numpy(), leaf_size)
    boxes = [wp.from_torch(corner.contiguous(), dtype=wp.vec3) for corner in (low, high)]
    made = wp.Bvh(*boxes, constructor=constructor, leaf_size=leaf_size)
    found = HostTree.from_address(made.id)
    ends = []
    for address in (found.lowers, found.uppers):
        rows = np.ctypeslib.as_array(ctypes.cast(address, ctypes.POINTER(ctypes.c_uint32)), (found.nodes, 4)).copy()
        ends.append((rows[:, :3].view(np.float32), rows[:, 3]))
    (lower, first), (upper, second) = ends
    links = np.stack([first & 0x7fffffff, second & 0x7fffffff, first >> 31], 1).astype(np.int32)
    prims = np.ctypeslib.as_array(ctypes.cast(found.prims, ctypes.POINTER(ctypes.c_int32)), (len(corners),)).copy()
    return FlatTree(lower, upper, links, prims, [ctypes.c_int.from_address(found.root).value])


def lbvh(low: np.ndarray, high: np.ndarray, leaf_size: int) -> FlatTree:
    """A tree by Morton codes of ten bits an axis, from the leaves upwards.

    Reference: Apetrei 2014, "Fast and simple agglomerative LBVH construction".
    """
    count = len(low)
    codes = morton_codes((low + high) / 2 - low.min(0), high.max(0) - low.min(0) + 1e-4)
    prims = codes.argsort(kind="stable").astype(np.int32)
    codes = codes[prims]
    # Behind neighbours: the number of leading bits that they share.
    differing = codes[:-1] ^ codes[1:]
    shared = np.where(differing == 0, 64, 63 - np.floor(np.log2(np.maximum(differing, 1)))).astype(np.int64)
    left, right = (np.concatenate([np.arange(count), np.full(count - 1, -1)]) for _ in range(2))
    children = np.full((2 * count - 1, 2), -1)
    active, root = np.arange(count), 0
    while len(active):
        start, end = left[active], right[active]
        whole = (start == 0) & (end == count - 1)
        root = int(active[whole][0]) if whole.any() else root
        active, start, end = active[~whole], start[~whole], end[~whole]
        before, behind = shared[np.maximum(start - 1, 0)], shared[np.minimum(end, count - 2)]
        odd = (prims[np.maximum(start - 1, 0)] % 2 != prims[end] % 2)
        to_right = (start == 0) | ((end != count - 1) & ((behind > before) | ((behind == before) & odd)))
        parent = count + np.where(to_right, end, start - 1)
        left[parent[to_right]], children[parent[to_right], 0] = start[to_right], active[to_right]
        right[parent[~to_right]], children[parent[~to_right], 1] = end[~to_right], active[~to_right]
        active = np.unique(parent[(children[parent] >= 0).all(1)])
    lower, upper = (np.concatenate([each[prims], np.zeros((count - 1, 3), np.float32)]) for each in (low, high))
    levels = [np.array([root])]
    while len(inner := levels[-1][levels[-1] >= count]):
        levels.append(children[inner].reshape(-1))
    links = np.stack([np.arange(count), np.arange(1, count + 1), np.ones(count, np.int64)], 1)
    links = np.concatenate([links, np.concatenate([children[count:], np.zeros((count - 1, 1), np.int64)], 1)])
    for depth, level in reversed(list(enumerate(levels, 1))):
        inner = level[level >= count]
        lower[inner], upper[inner] = lower[children[inner]].min(1), upper[children[inner]].max(1)
        packed = inner[(right[inner] - left[inner] < leaf_size) | (depth >= DEEPEST)]
        links[packed] = np.stack([left[packed], right[packed] + 1, np.ones(len(packed), np.int64)], 1)
    return FlatTree(lower, upper, links.astype(np.int32), prims, [root])


def morton_codes(place: np.ndarray, extent: np.ndarray) -> np.ndarray:
    """The Morton codes of places in a box, (N,) int64 of 30 bits."""
    cells, code = np.clip(place / extent * 1024, 0, 1023).astype(np.int64), 0
    for bit in range(10):
        for axis in range(3):
            code = code | ((cells[:, axis] >> bit & 1) << (3 * bit + axis))
    return code


def joined(trees: list[FlatTree]) -> FlatTree:
    """Several trees in one set of arrays; triangles are counted on."""
    links, roots, nodes, prims = [], [], 0, 0
    for tree in trees:
        links.append(tree.links + np.where(tree.links[:, 2:] == 1, [[prims, prims, 0]], [[nodes, nodes, 0]]))
        roots += [root + nodes for root in tree.roots]
        nodes, prims = nodes + len(tree.links), prims + len(tree.prims)
    firsts = np.cumsum([0, *(len(tree.prims) for tree in trees)])
    return FlatTree(*(np.concatenate([getattr(tree, name) for tree in trees]) for name in ("lower", "upper")),
                    np.concatenate(links).astype(np.int32),
                    np.concatenate([tree.prims + first for tree, first in zip(trees, firsts)]).astype(np.int32), roots)
