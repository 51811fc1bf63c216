"""The transform from the frame of a group to the world, for hits on instances.

A scene without instances has none of this: what its tables hold is in the world already.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.interface.instances import Instances
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.vec import Vec3, dot, max_component, normalize
from torch_radbp.transforms import matrix_inverse

Rows = tuple[Vec3, Vec3, Vec3]  # (I,) or (N,) of a matrix each

# Of float32: distance off a triangle at which rays leave it, in units of the largest number that is added up where rays and
# vertices are transformed. Less than for coordinates of vertices: it counts only where these numbers cancel.
ROUNDINGS = 4


class InstanceTable(NamedTuple):
    """The transforms of all instances, in the order in which hits count them: row 0 is the scene itself."""

    linear: Rows  # rows of the linear part of `to_world`, attached
    origin: Vec3  # (I,) where the group's origin is, attached
    normal: Rows | None  # rows of its inverse transpose; attached; None if no vertex has a normal
    side: Tensor  # (I,) -1 for mirrored poses, else 1; detached
    clearance: Tensor  # (I,) least distance off triangles at which rays leave them, detached; 0 in row 0
    number: Tensor  # (I,) int32 of the instance in the scene, 0 in row 0; for AOVs
    casting: Instances | None  # what ray casters need; None in parts of a scene


def instance_table(matrices: Tensor, normals: bool, casting: Instances, number: Tensor) -> InstanceTable:
    """Builds the table of instances, attached to their poses.

    Args:
        matrices: (I, 4, 4) poses in the order of `casting`.
        normals: whether there are vertex normals.
        casting: the record of these instances for ray casters.
        number: the column `InstanceTable.number`.
    """
    identity = torch.eye(4, dtype=matrices.dtype, device=matrices.device)[None]
    matrices = torch.cat([identity, matrices])
    linear = matrices[:, :3, :3]
    inverse = matrix_inverse(linear.double()).to(matrices.dtype) if normals else None  # in float64, despite autocast
    side = torch.sign(torch.linalg.det(linear.detach().double())).to(matrices.dtype)
    # A point is a sum of products with its coordinates and of the origin, and so is a ray that goes the other way.
    summed = casting.boxes.abs().amax((1, 2)) + 2 * casting.to_world[:, :, 3].abs().amax(1)
    none = torch.zeros(1, dtype=matrices.dtype, device=matrices.device)
    clearance = torch.cat([none, ROUNDINGS * 2.0**-24 * power_of_two_above(summed.to(matrices.dtype))])
    return InstanceTable(_rows_of(linear), Vec3.of(matrices[:, :3, 3]),
                         None if inverse is None else _rows_of(inverse.transpose(1, 2)), side, clearance, number, casting)


def for_lanes(table: InstanceTable | None) -> InstanceTable | None:
    """The columns of the instance table that lanes read, without those for ray casters."""
    return None if table is None else table._replace(casting=None)


def _rows_of(matrices: Tensor) -> Rows:
    """The three rows of (I, 3, 3) matrices as vectors."""
    return tuple(Vec3.of(row) for row in matrices.unbind(1))


def boxes(vertices: Sequence[Tensor], to_world: Sequence[Tensor]) -> Tensor:
    """The corners of a bounding box around each instance, (I, 8, 3).

    Args:
        vertices: (V, 3) of each group.
        to_world: (I, 3, 4) of the instances of each.
    """
    corners_of_groups = []
    for vertices_of_group, places in zip(vertices, to_world):
        low, high = vertices_of_group.amin(0).to(places), vertices_of_group.amax(0).to(places)
        corners = torch.cartesian_prod(*torch.stack([low, high], 1))
        corners_of_groups.append((places[:, None, :, :3] * corners[None, :, None]).sum(-1) + places[:, None, :, 3])
    return torch.cat(corners_of_groups)


def points_in_world(scene, hit, points: tuple[Vec3, ...]) -> tuple[Vec3, ...]:
    """Transforms (N,) points of hit triangles from the frame of their group to the world; attached to instance poses."""
    table = scene.triangles.instances
    if table is None:
        return points
    matrix, origin = lookup((table.linear, table.origin), hit.instance)
    return tuple(product(matrix, point) + origin for point in points)


def shown_direction(scene, hit, direction: Vec3) -> Vec3:
    """Transforms (N,) directions along hit triangles, unit or zero, to the world; attached to instance poses."""
    table = scene.triangles.instances
    return direction if table is None else normalize(product(lookup(table.linear, hit.instance), direction))


def shown_normals(scene, hit, normals: tuple[Vec3, ...]) -> tuple[Vec3, ...]:
    """Transforms (N,) unit vertex normals of hit triangles to the world; attached to instance poses."""
    table = scene.triangles.instances
    if table is None:
        return normals
    matrix = lookup(table.normal, hit.instance)
    return tuple(normalize(product(matrix, normal)) for normal in normals)


def product(matrix: Rows, vector: Vec3) -> Vec3:
    """The product of a matrix, given by its rows, and a vector."""
    return Vec3(*(dot(row, vector) for row in matrix))


def power_of_two_above(x: Tensor) -> Tensor:
    """The least power of two greater than x > 0, as `torch.frexp` gives it, detached; 0 for 0."""
    kind, exponent = (torch.int32, 0x7F800000) if x.dtype == torch.float32 else (torch.int64, 0x7FF << 52)
    return 2.0 * (x.detach().view(kind) & exponent).view(x.dtype)


def detached_largest_coordinate(points: tuple[Vec3, ...]) -> Tensor:
    """(N,) the largest magnitude of a coordinate of some points, detached."""
    largest = [max_component(point.detach().map(torch.abs)) for point in points]
    total = largest[0]
    for other in largest[1:]:
        total = torch.maximum(total, other)
    return total
