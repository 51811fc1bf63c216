"""The scene's geometry as functions of lanes read it for boundary terms."""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torch_radbp.scene.tables.placement import for_lanes, points_in_world, shown_normals
from torch_radbp.scene.tables.scene_tensors import SceneTensors, TriangleTable
from torch_radbp.tensors.differentiated import any_differentiated
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.vec import Vec3, max_component

Corners = tuple[Vec3, Vec3, Vec3]


class NormalsOnly(NamedTuple):
    """What geometry reads of a scene's layout, its static properties: whether vertices have shading normals."""

    shading_normals: bool


class Geometry(NamedTuple):
    """The triangles of a scene, used in place of `SceneTensors` for boundary terms; attached."""

    triangles: TriangleTable
    layout: NormalsOnly
    lines: Any = None  # `term.LineNumbers`, where lines move over surfaces


class _ShownBy(NamedTuple):
    """The instances that show vertices, for functions that read the instance of a ray's hit."""

    instance: Tensor  # (N,) int32, as hits count


class Between(NamedTuple):
    """Three vertices for each lane, as rows of the vertex table; (N,) int32."""

    first: Tensor
    second: Tensor
    third: Tensor  # for a point on an edge the second again


def geometry_of(scene: SceneTensors) -> Geometry:
    """The triangles of a scene, as boundary terms read them; with texture coordinates only if these are differentiated."""
    triangles = scene.triangles
    vertices = triangles.vertices._replace(attributes=())
    vertices = vertices if any_differentiated(vertices.uv) else vertices._replace(uv=None)
    triangles = triangles._replace(vertices=vertices, clearance=None, along=None, material=None, emitter=None, balls=None,
                                   attributes=(), numbers=None, instances=for_lanes(triangles.instances))
    return Geometry(triangles, NormalsOnly(scene.layout.shading_normals))


def point_at(geometry: Geometry, row: Tensor, instance: Tensor | None) -> Vec3:
    """The world positions of vertices, attached, float64.

    Args:
        row: (N,) int32, rows of the vertex table.
        instance: (N,) int32, the instances that show them; None: the scene has none.
    """
    point, = in_world(geometry, (row,), instance)
    return point


def positions(geometry: Geometry, between: Between, instance: Tensor | None) -> Corners:
    """The world positions of the corners of triangles, attached; float64."""
    return in_world(geometry, between, instance)


def in_world(geometry: Geometry, vertices: tuple[Tensor, ...], instance: Tensor | None) -> tuple[Vec3, ...]:
    """The world positions of several vertices per lane, (N,) int32 rows each; attached, float64.

    Instances transform them in float64, too: if edges were off their triangles' planes by rounding of float32, they would be
    silhouettes from viewpoints close by.
    """
    points = tuple(lookup(geometry.triangles.vertices.p, row).map(torch.Tensor.double) for row in vertices)
    return points if instance is None else points_in_world(geometry, _ShownBy(instance), points)


def vertex_normals(geometry: Geometry, between: Between, instance: Tensor | None) -> Corners:
    """The unit shading normals at the three corners of triangles."""
    normals = tuple(lookup(geometry.triangles.vertices.n, row) for row in between)
    normals = normals if instance is None else shown_normals(geometry, _ShownBy(instance), normals)
    return tuple(normal.map(torch.Tensor.double) for normal in normals)


def largest_coordinate(*points: Vec3) -> Tensor:
    """The largest absolute coordinate of several points per lane, which bounds their rounding; (N,)."""
    return functools.reduce(torch.maximum, (max_component(point.map(torch.abs)) for point in points))
