"""Marching cubes: the triangles of a cell by the signs of a function at its corners.

Corner k of a cell is at (k & 1, k >> 1 & 1, k >> 2 & 1). Edge 4 a + j is along axis a, at (j & 1, j >> 1) along the two
axes that follow a in the cycle x, y, z. A case is the sum of 1 << k over the corners k inside, where the function is
negative.

On each face of the cell the zero set is drawn as lines between edges whose ends differ; together they are closed loops,
which become fans of triangles. On a face whose opposite corners agree there are two ways to draw them: each inside corner is
cut off by itself, whatever the cell, so that neighbours agree and the surface has no cracks.

Reference: Lorensen and Cline 1987, "Marching Cubes"; Duerst 1988, "Additional Reference to Marching Cubes", for the cracks.
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

CORNERS, EDGES, CASES = 8, 12, 256


class CaseTable(NamedTuple):
    """The triangles of all 256 cases; their corners are edges of the cell, counter-clockwise as seen from outside."""

    count: Tensor  # (256,) int64, number of triangles
    edges: Tensor  # (256, most, 3) int64


@cache
def case_table() -> CaseTable:
    """Computes the table of all cases, on the CPU."""
    cases = [[triangle for loop in loops(case) for triangle in fan(loop)] for case in range(CASES)]
    table = np.zeros((CASES, max(map(len, cases)), 3), np.int64)
    for case, triangles in enumerate(cases):
        if triangles:
            table[case, :len(triangles)] = triangles
    with torch.device("cpu"):
        return CaseTable(torch.tensor([len(triangles) for triangles in cases]), torch.from_numpy(table))


@cache
def edge_starts() -> Tensor:
    """(12, 3) int64, the corner at which each edge starts, with its coordinate along the axis at 0. On the CPU."""
    with torch.device("cpu"):
        return torch.tensor([_placed(edge // 4, 0, edge & 1, edge >> 1 & 1) for edge in range(EDGES)])


def _placed(axis: int, along: int, second: int, third: int) -> tuple[int, int, int]:
    """(x, y, z) from a value along an axis and the values along the next two axes in the cycle x, y, z."""
    place = [0, 0, 0]
    place[axis], place[(axis + 1) % 3], place[(axis + 2) % 3] = along, second, third
    return tuple(place)


@cache
def faces() -> list[list[tuple[int, int]]]:
    """The six faces of a cell, each as corners with the edge to the next corner, counter-clockwise from outside."""
    cycles = []
    for axis in range(3):
        for side in (0, 1):
            places = [(0, 0), (1, 0), (1, 1), (0, 1)] if side else [(0, 0), (0, 1), (1, 1), (1, 0)]
            corners = [sum(bit << k for k, bit in enumerate(_placed(axis, side, *place))) for place in places]
            following = corners[1:] + corners[:1]
            cycles.append([(corner, edge_between(corner, after)) for corner, after in zip(corners, following)])
    return cycles


def edge_between(one: int, other: int) -> int:
    """The edge between two neighbouring corners."""
    axis = (one ^ other).bit_length() - 1
    low = one & other
    return 4 * axis + (low >> (axis + 1) % 3 & 1) + 2 * (low >> (axis + 2) % 3 & 1)


def loops(case: int) -> list[list[int]]:
    """The closed polygons of a case, each as the edges that it crosses, in the order of the triangles."""
    following: dict[int, int] = {}
    for face in faces():
        inside = [bool(case >> corner & 1) for corner, _ in face]
        for number in range(4):
            if not inside[number] and inside[(number + 1) % 4]:  # the edge here leads inside; the next that leads outside:
                leaving = next(number + step for step in range(1, 4) if not inside[(number + step + 1) % 4])
                following[face[number][1]] = face[leaving % 4][1]
    polygons = []
    while following:
        loop = [next(iter(following))]
        while (edge := following.pop(loop[-1])) != loop[0]:
            loop.append(edge)
        polygons.append(loop)
    return polygons


def fan(loop: list[int]) -> list[tuple[int, int, int]]:
    """Triangulates a polygon, without triangles in a face of the cell, where the neighbour might have the same."""
    flats = [{edge for _, edge in face} for face in faces()]
    for first in range(len(loop)):
        turned = loop[first:] + loop[:first]
        triangles = [(turned[0], *pair) for pair in zip(turned[1:], turned[2:])]
        if not any(set(triangle) <= flat for triangle in triangles for flat in flats):
            return triangles
    raise AssertionError(f"every fan of the loop {loop} has a triangle in a face")
