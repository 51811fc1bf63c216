"""The zero set of the trilinear interpolant of a grid, as triangles with derivatives.

Marching cubes on a lattice which is that of the grid, or finer if the grid is coarse. Along an edge of the lattice the
interpolant is linear, so that all vertices are on the zero set exactly. Which edges are cut follows from signs, and changes
in steps; where they are cut is differentiable with respect to the values at the ends.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.shape.marching_cubes import CORNERS, case_table, edge_starts
from torch_radbp.tensors.vec import Vec3, gather, max_component, normalize, scaled, where

LEAST_CELLS = 60  # of the lattice, along the longest side of the grid
ROUNDING = 16.0  # in units of the last place, of a number that would be zero without


class Net(NamedTuple):
    """The marching-cubes net of a grid: cut lattice edges, and triangles between them; detached; in voxels, x first."""

    faces: Tensor  # (F, 3) int64, counter-clockwise as seen from where values are positive
    voxel: Tensor  # (V, 3) int64, the grid point from which the vertex's voxel extends
    start: Tensor  # (V, 3) float64, where the cut edge starts, relative to that point, in [0, 1]
    axis: Tensor  # (V,) int64, along which it runs


class Cell(NamedTuple):
    """The voxels that contain points, and the points' positions in them."""

    voxel: tuple[Tensor, Tensor, Tensor]  # (V,) int64 each, x first
    place: Vec3  # (V,) positions of the points in their voxels, in [0, 1]; attached


def check_grid(name: str, values: Tensor) -> None:
    """Raises ValueError unless a grid, (Z, Y, X), has a voxel that the zero set goes through."""
    if min(values.shape) < 2:
        raise ValueError(f"{name} must have at least 2 values along each axis, got {tuple(values.shape)} (z, y, x)")
    inside = values < 0
    if bool(inside.all()) or not bool(inside.any()):
        raise ValueError(f"{name} must have values below 0 (inside) and others, or there is no surface; they are from "
                         f"{float(values.min()):g} to {float(values.max()):g}")


def subdivision(size: tuple[int, ...]) -> int:
    """The number of lattice cells per voxel along each axis for a grid of this size."""
    return -(-LEAST_CELLS // (max(size) - 1))


def zero_net(values: Tensor, of_voxels: bool) -> Net:
    """Runs marching cubes on a lattice of at least `LEAST_CELLS` cells along the longest side.

    Args:
        values: (Z, Y, X), detached.
        of_voxels: vertices on the border between voxels are repeated, one for each voxel.
    """
    check_grid("the grid", values)
    cells = subdivision(values.shape)
    voxels = occupied(values)
    signs = _refined(_at_corners(values, voxels.unbind(1)), cells) < 0
    case = _cases(signs)
    number, z, y, x = ((case > 0) & (case < 255)).nonzero().unbind(1)
    table = case_table()
    case = case[number, z, y, x].long()
    count = table.count.to(values.device)[case]
    row = torch.arange(len(case), device=values.device).repeat_interleave(count)
    triangle = torch.arange(len(row), device=values.device) - (count.cumsum(0) - count)[row]
    edges = table.edges.to(values.device)[case[row], triangle]
    number = number[row]
    corner = voxels[number] * cells + torch.stack([x, y, z], 1)[row]
    return _connected(edges, corner, number if of_voxels else None, voxels, cells, values.shape)


def _connected(edges: Tensor, corner: Tensor, number: Tensor | None, voxels: Tensor, cells: int,
               size: tuple[int, ...]) -> Net:
    """Joins the triangles of single cells to a net with shared vertices.

    Args:
        edges: (F, 3), of the cell that a triangle is in.
        corner: (F, 3), the lattice point from which that cell extends.
        number: (F,), the row of `voxels` that it is in; None: vertices belong to the first voxel that they touch.
        voxels: (M, 3).
        cells: how many a voxel has along each axis.
        size: of the grid, z first.
    """
    depth, height, width = (cells * (length - 1) + 1 for length in size)
    x, y, z = (edge_starts().to(edges.device)[edges] + corner[:, None]).unbind(2)
    key = 3 * ((z * height + y) * width + x) + edges // 4
    if number is not None:
        key = key + 3 * depth * height * width * number[:, None]
    key, faces = torch.unique(key, return_inverse=True)
    axis, key = key % 3, key // 3
    start = torch.stack([key % width, key // width % height, key // (width * height) % depth], 1)
    if number is None:
        last = torch.tensor(size, device=start.device).flip(0) - 2
        voxel = torch.minimum(start // cells, last)
    else:
        voxel = voxels[key // (depth * height * width)]
    return Net(faces, voxel, (start - cells * voxel).double() / cells, axis)


def occupied(values: Tensor) -> Tensor:
    """The voxels of a grid, (Z, Y, X), in which the interpolant changes sign; (M, 3) int64, their first grid points."""
    inside, outside = values < 0, values >= 0
    for axis in range(3):
        inside, outside = (part.narrow(axis, 0, part.shape[axis] - 1) | part.narrow(axis, 1, part.shape[axis] - 1)
                           for part in (inside, outside))
    return (inside & outside).nonzero().flip(1)


def _at_corners(values: Tensor, voxel: tuple[Tensor, ...]) -> list[Tensor]:
    """The grid's values at the 8 corners of voxels, (V,) each, in the order of `marching_cubes`; attached."""
    return [_at(values, tuple(first + (k >> axis & 1) for axis, first in enumerate(voxel))) for k in range(CORNERS)]


def _at(values: Tensor, point: tuple[Tensor, ...]) -> Tensor:
    """The grid's values at grid points, x first, (V,) each; attached."""
    x, y, z = point
    _, height, width = values.shape
    return gather(values.flatten(), (z * height + y) * width + x)


def _between(a: Tensor, b: Tensor, share: Tensor) -> Tensor:
    """Linear interpolation, exactly `a` and `b` at the ends, so that neighbouring voxels agree."""
    return a * (1.0 - share) + b * share


def _refined(corners: list[Tensor], cells: int) -> Tensor:
    """Samples the interpolant in M voxels on a lattice of `cells` per axis, (M, cells + 1, cells + 1, cells + 1)."""
    values = torch.stack(corners, 1).unflatten(1, (2, 2, 2))
    share = torch.linspace(0.0, 1.0, cells + 1, dtype=values.dtype, device=values.device)
    for axis in (1, 2, 3):
        a, b = values.unbind(axis)
        along = share.reshape([-1 if other == axis else 1 for other in range(4)])
        values = _between(a.unsqueeze(axis), b.unsqueeze(axis), along)
    return values


def _cases(inside: Tensor) -> Tensor:
    """The marching-cubes case of each cell, (M, n, n, n) uint8, from lattice signs (M, n + 1, n + 1, n + 1)."""
    count, bits = inside.shape[1] - 1, inside.to(torch.uint8)
    case = torch.zeros_like(bits[:, :count, :count, :count])
    for k in range(CORNERS):
        x, y, z = (slice(k >> axis & 1, (k >> axis & 1) + count) for axis in range(3))
        case |= bits[:, z, y, x] << k
    return case


def vertices(values: Tensor, net: Net) -> tuple[Cell, list[Tensor]]:
    """The voxels and positions at which a net's edges are cut, and the grid's values there; attached to `values`.

    An edge along which the interpolant is zero, up to rounding, is cut at its middle, which does not move.
    """
    voxel = net.voxel.unbind(1)
    corners = _at_corners(values, voxel)
    start = Vec3.of(net.start.to(values.dtype))
    along = [net.axis == axis for axis in range(3)]
    ends = [Vec3(*(torch.where(is_axis, end, part) for is_axis, part in zip(along, start))) for end in (0.0, 1.0)]
    low, high = (interpolant(corners, end) for end in ends)
    level = vanishes(low - high, sum(interpolant(magnitudes(corners), end) for end in ends))
    cut = torch.where(level, 0.5, low / torch.where(level, 1.0, low - high))
    return Cell(voxel, Vec3(*(torch.where(is_axis, cut, part) for is_axis, part in zip(along, start)))), corners


def magnitudes(values: list[Tensor]) -> list[Tensor]:
    """The detached absolute values of some tensors."""
    return [value.detach().abs() for value in values]


def vanishes(difference: Tensor, size: Tensor) -> Tensor:
    """True where the difference of two sums is zero up to rounding; `size`: the sum of absolute values of all terms."""
    return difference.detach().abs() <= ROUNDING * torch.finfo(size.dtype).eps * size


def interpolant(corners: list[Tensor], place: Vec3) -> Tensor:
    """Trilinear interpolation between the corners of voxels."""
    for share in place:
        corners = [_between(a, b, share) for a, b in zip(corners[::2], corners[1::2])]
    return corners[0]


def face_interpolants(corners: list[Tensor], place: Vec3, axis: int) -> tuple[Tensor, Tensor]:
    """Bilinear interpolation on the two faces of voxels across an axis."""
    low, high = ([corners[k] for k in range(CORNERS) if (k >> axis & 1) == end] for end in (0, 1))
    return bilinear(low, place, axis), bilinear(high, place, axis)


def bilinear(corners: list[Tensor], place: Vec3, axis: int) -> Tensor:
    """Bilinear interpolation of the values at four corners of a plane across an axis, first the first of the other axes."""
    first, second = (share for other, share in enumerate(place) if other != axis)
    return _between(_between(corners[0], corners[1], first), _between(corners[2], corners[3], first), second)


def voxel_gradient(values: Tensor, cell: Cell, corners: list[Tensor]) -> Vec3:
    """The gradient of the trilinear interpolant at points within voxels, per unit of the grid's cube; attached.

    Where it is zero up to rounding, it is zero, without derivative.
    """
    faces = [face_interpolants(corners, cell.place, axis) for axis in range(3)]
    sizes = [sum(face_interpolants(magnitudes(corners), cell.place.map(Tensor.detach), axis)) for axis in range(3)]
    level = [vanishes(high - low, size) for (low, high), size in zip(faces, sizes)]
    slope = Vec3(*((high - low) * (length - 1) for (low, high), length in zip(faces, reversed(values.shape))))
    none = level[0] & level[1] & level[2]
    return where(none, slope.map(torch.zeros_like), slope)


def smooth_normal(values: Tensor, cell: Cell, corners: list[Tensor]) -> Vec3:
    """Unit normals that are continuous across the borders of voxels; attached.

    The unit gradients of the eight voxels around the grid point that is nearest, each continued to the place itself, are
    interpolated between the voxels' centres. Voxels beyond the border of the grid are left out, and so are voxels in which
    the gradient is zero, as where all values are the same. If the others cancel, the normal is (1, 0, 0).

    Reference: Hansson-Soderlund, Evans and Akenine-Moller 2022, "Ray Tracing of Signed Distance Function Grids", section 5.
    """
    slopes, levels, shares = [], [], []
    for axis, length in enumerate(reversed(values.shape)):
        share, voxel = cell.place[axis], cell.voxel[axis]
        upper = (share.detach() >= 0.5)
        there = torch.where(upper, voxel < length - 2, voxel > 0)
        beyond = torch.where(upper, voxel + 2, voxel - 1).clamp(0, length - 1)
        others = [_at(values, tuple(beyond if other == axis else cell.voxel[other] + (k >> other & 1) for other in range(3)))
                  for k in range(CORNERS) if not k >> axis & 1]
        low, high = face_interpolants(corners, cell.place, axis)
        outer = bilinear(others, cell.place, axis)
        here, next_to_it = high - low, torch.where(upper, outer - high, low - outer)
        slopes.append([torch.where(upper, *pair) * (length - 1) for pair in ((here, next_to_it), (next_to_it, here))])
        fixed = cell.place.map(Tensor.detach)
        sizes = *face_interpolants(magnitudes(corners), fixed, axis), bilinear(magnitudes(others), fixed, axis)
        level = vanishes(here, sizes[0] + sizes[1])
        next_level = vanishes(next_to_it, torch.where(upper, sizes[1], sizes[0]) + sizes[2])
        levels.append([torch.where(upper, *pair) for pair in ((level, next_level), (next_level, level))])
        blend = torch.where(upper, share - 0.5, share + 0.5)
        shares.append(torch.where(there, blend, torch.where(upper, 0.0, 1.0)))
    normals = []
    for k in range(CORNERS):
        slope, level = ([of_axis[k >> axis & 1] for axis, of_axis in enumerate(each)] for each in (slopes, levels))
        normals.append(_direction(Vec3(*slope), level[0] & level[1] & level[2]))
    for share in shares:
        normals = [Vec3(*(_between(*parts, share) for parts in zip(a, b))) for a, b in zip(normals[::2], normals[1::2])]
    return unit_vector(normals[0], ROUNDING * torch.finfo(values.dtype).eps)


def _direction(a: Vec3, none: Tensor) -> Vec3:
    """The unit vector along `a`; zero, without derivative, where `none` is set."""
    return where(none, a.map(torch.zeros_like), normalize(scaled(a)))


def unit_vector(a: Vec3, least: float = 0.0) -> Vec3:
    """The unit vector along `a`; (1, 0, 0), without derivative, if no component exceeds `least`."""
    none = max_component(Vec3(*magnitudes(list(a)))) <= least
    direction = _direction(a, none)
    return direction._replace(x=torch.where(none, 1.0, direction.x))
