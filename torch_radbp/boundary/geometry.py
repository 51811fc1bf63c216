"""What functions of lanes read to tell where curves lie, at which an image jumps."""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torch_radbp.scene.placement import for_lanes, points_in_world, shown_normals
from torch_radbp.scene.tensors import SceneTensors, TriangleTable
from torch_radbp.tensors.differentiated import any_differentiated
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.vec import Vec3, max_component

Corners = tuple[Vec3, Vec3, Vec3]


class NormalsOnly(NamedTuple):
    """As `Layout`."""

    shading_normals: bool


class Geometry(NamedTuple):
    """The triangles of a scene as far as they matter here; attached. In place of `SceneTensors`."""

    triangles: TriangleTable
    layout: NormalsOnly
    lines: Any = None  # `term.LineNumbers`, where lines move over surfaces


class _ShownBy(NamedTuple):
    """What shows vertices of groups, in place of a `Hit`."""

    instance: Tensor  # (N,) int32, as hits count


class Between(NamedTuple):
    """Three vertices of a surface, rows of the scene's vertices; (N,) int32."""

    first: Tensor
    second: Tensor
    third: Tensor  # of a place on an edge the second once more


def geometry_of(scene: SceneTensors) -> Geometry:
    """The geometry of a scene; surface coordinates only if they have derivatives, by which lines of textures slide."""
    triangles = scene.triangles
    vertices = triangles.vertices._replace(attributes=())
    vertices = vertices if any_differentiated(vertices.uv) else vertices._replace(uv=None)
    triangles = triangles._replace(vertices=vertices, clearance=None, along=None, material=None, emitter=None, balls=None,
                                   attributes=(), numbers=None, instances=for_lanes(triangles.instances))
    return Geometry(triangles, NormalsOnly(scene.layout.shading_normals))


def point_at(geometry: Geometry, row: Tensor, instance: Tensor | None) -> Vec3:
    """Vertices, (N,) int32 rows, in the world; attached, float64. `instance`: see `Places`."""
    point, = in_world(geometry, (row,), instance)
    return point


def positions(geometry: Geometry, between: Between, instance: Tensor | None) -> Corners:
    """The vertices of triangles in the world, attached; float64."""
    return in_world(geometry, between, instance)


def in_world(geometry: Geometry, vertices: tuple[Tensor, ...], instance: Tensor | None) -> tuple[Vec3, ...]:
    """Some vertices of each lane, (N,) int32 rows each, in the world; attached, float64.

    Instances place them in float64, too: a triangle's own edges must lie in its plane by whichever way both are computed.
    Were they off by what float32 rounds, points close to them would take them for silhouettes.
    """
    points = tuple(lookup(geometry.triangles.vertices.p, row).map(torch.Tensor.double) for row in vertices)
    return points if instance is None else points_in_world(geometry, _ShownBy(instance), points)


def vertex_normals(geometry: Geometry, between: Between, instance: Tensor | None) -> Corners:
    """The shading normals there, unit length."""
    normals = tuple(lookup(geometry.triangles.vertices.n, row) for row in between)
    normals = normals if instance is None else shown_normals(geometry, _ShownBy(instance), normals)
    return tuple(normal.map(torch.Tensor.double) for normal in normals)


def largest_coordinate(*points: Vec3) -> Tensor:
    """The largest coordinate of several points of each lane, by absolute value, by which their rounding grows; (N,)."""
    return functools.reduce(torch.maximum, (max_component(point.map(torch.abs)) for point in points))
