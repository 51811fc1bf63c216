"""The tables of a scene's triangles. Detached columns are computed again only where vertices or faces have changed."""

from __future__ import annotations

import itertools
from collections.abc import Hashable, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.interface.balls import TRIANGLES, Ball, Balls
from torch_radbp.interface.instances import Instances
from torch_radbp.scene.cache.pack_cache import PackCache
from torch_radbp.scene.tables.placement import InstanceTable, boxes, instance_table
from torch_radbp.scene.tables.scene_tensors import TriangleTable, VertexTable
from torch_radbp.scene.tables.triangle_corners import at_corners, clearance, edges
from torch_radbp.shape.instance import Instance
from torch_radbp.shape.surface import Surface, Triangles
from torch_radbp.tensors.differentiated import differentiated
from torch_radbp.tensors.interleaved import interleaved
from torch_radbp.tensors.vec import Vec2, Vec3, masked, max_component, normalize, scaled, unit_normal, where

BLOCK = 1 << 15  # number of triangles that are processed at a time
FEW = 1 << 10  # number of triangles examined before all of a surface are
FLAT = 1e-5  # largest difference between a vertex normal and that of its face on a flat surface


class PlacedShape(NamedTuple):
    """A shape as triangles in world space, or in the frame of its group."""

    surface: Triangles  # attached
    vertices: Tensor  # (V, 3) of the surface, detached; the same object as in the last rendering if unchanged
    faces: Tensor  # (F, 3) likewise
    ball: Ball | None  # the tessellated sphere that the shape is, likewise


class TriangleNumbering(NamedTuple):
    """How the AOVs `prim_index` and `shape_index` number the triangles of a shape."""

    counted: bool  # if not, they are one primitive, of number 0
    shape: int  # the number of the shape in the scene; 0: it belongs to a group


class Columns(NamedTuple):
    """Which optional columns the triangle tables of a scene have, and what each shape belongs to."""

    normals: bool  # of vertices
    uv: bool
    attributes: tuple[str, ...]  # of vertices
    face_attributes: tuple[str, ...]
    tangents: bool  # along u
    material: tuple[int, ...]  # of each shape, row of `MaterialTable`
    emitting: tuple[bool, ...]  # whether each shape belongs to an emitter
    plain: tuple[bool, ...]  # of each shape, see `TriangleTable`
    numbers: tuple[TriangleNumbering, ...] | None = None  # of each shape, for AOVs
    boundary: tuple[int, ...] | None = None  # of each shape, row of `BoundaryTable`; None: as for `TriangleTable`


def placed_shapes_of(cache: PackCache, shapes: Sequence[Surface], instanced: Sequence[bool], dtype: torch.dtype,
                     reaches: Sequence[frozenset[int]]) -> tuple[PlacedShape, ...]:
    """The current triangles of shapes, in world space, or for shapes shown by instances in the frame of their group.

    Args:
        cache: what is known from the last rendering.
        shapes: of the scene, then of each group.
        instanced: for each, whether instances show it.
        dtype: of the scene.
        reaches: for each, the ids of what it depends on, as `Inventory.reach`.
    """
    surfaces = [cache(without_flat_normals, cache(oriented, cache.twin(id(shape), shape), connections(cache, shape)))
                for shape in shapes]
    columns = [(((id(shape), "vertices"), surface.vertices.to(dtype)), ((id(shape), "faces"), surface.faces))
               for shape, surface in zip(shapes, surfaces)]
    for (vertices, _), reach in zip(columns, reaches):
        cache.presume(*vertices, reach)
    if any(not vertices.is_cpu for (_, vertices), _ in columns):
        cache.compare([column for own in columns for column in own], [vertices for (_, vertices), _ in columns])
    placed = tuple(PlacedShape(surface, cache.frozen(*vertices), cache.frozen(*faces),
                               None if shown else frozen_ball(cache, id(shape), surface.ball))
                   for shape, surface, (vertices, faces), shown in zip(shapes, surfaces, columns, instanced))
    for shape, ((_, vertices), _) in zip(placed, columns):
        if id(vertices) in cache.numbers:
            cache.numbers[id(shape.vertices)] = cache.numbers[id(vertices)]
    return placed


def frozen_ball(cache: PackCache, place: Hashable, ball: Ball | None) -> Ball | None:
    """A detached copy of a shape's `Ball` (the sphere that it tessellates); `place`: its key in the last rendering."""
    return None if ball is None else cache(Ball, cache.frozen((place, "ball"), ball.placement), ball.turned)


def connections(cache: PackCache, shape: Surface) -> tuple[NamedTuple, ...]:
    """The topology of a shape's triangles and the like, detached; computed again only if the shape's values have changed.

    Empty for shapes whose triangles depend on none.
    """
    recipe = shape.connections()
    if recipe is None:
        return ()
    make, arguments = recipe
    return (cache(make, *(cache.frozen((id(shape), make, number), value) if isinstance(value, Tensor) else value
                         for number, value in enumerate(arguments))),)


def oriented(shape: Surface, connections_of_shape: tuple[NamedTuple, ...]) -> Triangles:
    """The triangles of a shape in world space, turned inside out if it says so; `connections_of_shape`: its topology."""
    return shape.oriented(*connections_of_shape)


def without_flat_normals(surface: Triangles) -> Triangles:
    """Drops vertex normals that equal the face normals and carry no derivative."""
    if surface.normals is None or differentiated(surface.normals) or differentiated(surface.vertices):
        return surface
    some = surface.faces[::max(1, len(surface.faces) // FEW)]
    flat = flat_normals(surface, some) and flat_normals(surface, surface.faces)
    return surface._replace(normals=None) if flat else surface


def flat_normals(surface: Triangles, faces: Tensor) -> bool:
    """True if vertex normals equal the normals of some faces of a surface, (F, 3)."""
    normals, _ = normals_and_clearances(surface.vertices, faces)
    return bool((surface.normals[faces] - normals.stack()[:, None]).abs().max() < FLAT)


def triangle_table(cache: PackCache, shapes: Sequence[PlacedShape], columns: Columns, dtype: torch.dtype,
                   device: torch.device, instances: InstanceTable | None = None) -> TriangleTable:
    """Builds the table of the triangles of all shapes, in order, with the vertex table in it."""
    counts = tuple(len(shape.faces) for shape in shapes)
    surfaces = tuple(shape.surface for shape in shapes)
    vertices = cache(vertex_table, surfaces, columns.normals, columns.uv or columns.tangents, columns.attributes, dtype,
                    device)
    corners, material, emitter = cache(triangle_rows, tuple(shape.faces for shape in shapes),
                                      tuple(len(shape.vertices) for shape in shapes), columns.material, columns.emitting,
                                      device)
    n, clearances = cache(_concatenated,
                          tuple(cache(normals_and_clearances, shape.vertices, shape.faces) for shape in shapes),
                         dtype, device)
    smooth = tuple(shape.surface.normals is not None for shape in shapes)
    smooth = None if all(smooth) or not columns.normals else cache(of_each, smooth, counts, torch.bool, device)
    along = cache(_tangents, vertices, corners) if columns.tangents else None
    if not columns.uv:
        vertices = cache(VertexTable, vertices.p, vertices.n, None, vertices.attributes)
    return TriangleTable(vertices, corners, n, smooth, clearances, along, material=material, emitter=emitter,
                         balls=cache(balls_among, tuple(shape.ball for shape in shapes), counts, device),
                         attributes=cache(face_table, surfaces, counts, columns.face_attributes, dtype, device),
                         numbers=None if columns.numbers is None else cache(_numbers, columns.numbers, counts, device),
                         instances=instances,
                         plain=cache(of_each, columns.plain, counts, torch.bool, device) if any(columns.plain) else None,
                         boundary=(None if columns.boundary is None
                                   else cache(of_each, columns.boundary, counts, torch.int32, device)))


def shown_instances(cache: PackCache, groups: Sequence[Sequence[Instance]], shapes: Sequence[PlacedShape], normals: bool,
                    numbers: tuple[int, ...], dtype: torch.dtype, device: torch.device) -> InstanceTable | None:
    """Builds the table of a scene's instances, attached to their poses; None if it has no instances.

    Args:
        cache: what is known from the last rendering.
        groups: the instances of each group.
        shapes: of the scene, then of each group.
        normals: whether a vertex has a normal.
        numbers: of all instances, for AOVs.
        dtype, device: of the result.
    """
    if not groups:
        return None
    members = [len(instances[0].shapegroup.shapes) for instances in groups]
    poses = cache(_stacked, tuple(cache.in_twin((id(instance), "to_world"), instance.to_world)
                                for instances in groups for instance in instances), dtype)
    casting = cache(casting_of, cache.frozen("poses of instances", poses), tuple(map(len, groups)), tuple(members),
                   tuple(shape.vertices for shape in shapes), tuple(shape.faces for shape in shapes))
    return cache(instance_table, poses, normals, casting, cache(_instance_numbers, numbers, device))


def _instance_numbers(numbers: tuple[int, ...], device: torch.device) -> Tensor:
    """The AOV numbers of instances as a column of the table of instances, whose row 0 is the scene itself."""
    return torch.tensor((0, *numbers), dtype=torch.int32, device=device)


def _stacked(poses: tuple[Tensor, ...], dtype: torch.dtype) -> Tensor:
    """Stacks poses into one tensor, (I, 4, 4)."""
    return torch.stack(poses).to(dtype)


def casting_of(poses: Tensor, counts: tuple[int, ...], members: tuple[int, ...], vertices: tuple[Tensor, ...],
               faces: tuple[Tensor, ...]) -> Instances:
    """The record of instances that ray casters are built from.

    Args:
        poses: (I, 4, 4) detached.
        counts: the number of instances of each group.
        members: the number of shapes in each group.
        vertices: (V, 3) of all shapes, those of groups last.
        faces: (F, 3) likewise.
    """
    outside_groups = len(vertices) - sum(members)

    def firsts(sizes: list[int]) -> tuple[int, ...]:
        in_groups = iter(sizes[outside_groups:])
        sums = [sum(itertools.islice(in_groups, count)) for count in members]
        return tuple(itertools.accumulate(sums, initial=sum(sizes[:outside_groups])))

    to_world, in_groups = poses[:, :3].contiguous(), iter(vertices[outside_groups:])
    points = [torch.cat(list(itertools.islice(in_groups, count))) for count in members]
    return Instances(to_world, firsts(list(map(len, vertices))), firsts(list(map(len, faces))),
                     tuple(itertools.accumulate(counts, initial=0)), boxes(points, to_world.split(counts)))


def balls_among(balls: Sequence[Ball | None], counts: Sequence[int], device: torch.device) -> Balls | None:
    """Joins the tessellated spheres of all shapes, with the numbers of their triangles; None if there are none.

    Args:
        balls: of each shape, detached.
        counts: the number of triangles of each.
        device: of the result.
    """
    firsts = list(itertools.accumulate(counts, initial=0))
    numbered = [(first, ball) for first, ball in zip(firsts, balls) if ball is not None]
    if not numbered:
        return None
    first = [first + number * TRIANGLES for first, ball in numbered for number in range(len(ball.turned))]
    turned = [is_turned for _, ball in numbered for is_turned in ball.turned]
    return Balls(torch.tensor(first, dtype=torch.int32, device=device), torch.tensor(turned, device=device),
                 torch.cat([ball.placement for _, ball in numbered]).to(device, torch.float64))


def vertex_table(surfaces: Sequence[Triangles], normals: bool, uv: bool, attributes: tuple[str, ...], dtype: torch.dtype,
                 device: torch.device) -> VertexTable:
    """Joins the vertices of all surfaces; normals, uv and attributes on request, zero where a surface has none."""
    none = torch.zeros(0, 3, dtype=dtype, device=device)

    def column(parts: list[Tensor | None], width: int) -> Tensor:
        rows = [surface.vertices.new_zeros(len(surface.vertices), width) if part is None else part
                for surface, part in zip(surfaces, parts)]
        return torch.cat([none[:, :width], *(row.to(dtype) for row in rows)])

    return interleaved(VertexTable(
        Vec3(*column([surface.vertices for surface in surfaces], 3).unbind(1)),
        Vec3(*column([surface.normals for surface in surfaces], 3).unbind(1)) if normals else None,
        Vec2(*column([surface.uv for surface in surfaces], 2).unbind(1)) if uv else None,
        tuple(Vec3(*column(channels(surfaces, name), 3).unbind(1)) for name in attributes)))


def face_table(surfaces: Sequence[Triangles], counts: Sequence[int], attributes: tuple[str, ...], dtype: torch.dtype,
               device: torch.device) -> tuple[Vec3, ...]:
    """Joins the face attributes of all surfaces; zero where a surface has none. Attached."""
    def column(name: str) -> Tensor:
        parts = [torch.zeros(count, 3, dtype=dtype, device=device) if part is None else part.to(dtype)
                 for count, part in zip(counts, channels(surfaces, name))]
        return torch.cat(parts)

    return tuple(Vec3.of(column(name)) for name in attributes)


def channels(surfaces: Sequence[Triangles], name: str) -> list[Tensor | None]:
    """A mesh attribute of each surface, in three channels; None for surfaces without it."""
    columns = [dict(surface.attributes).get(name) for surface in surfaces]
    return [None if values is None else values.expand(-1, 3) for values in columns]


def triangle_rows(faces: Sequence[Tensor], vertices: Sequence[int], material: Sequence[int], emitting: Sequence[bool],
                  device: torch.device) -> tuple[tuple[Tensor, Tensor, Tensor], Tensor, Tensor]:
    """For each triangle its corners as rows of the joined vertices, its material, and its index among emitting triangles;
    (T,) int32.

    Args:
        faces: (F, 3) of each shape.
        vertices: the number of vertices of each.
        material: the row of each in the table of materials.
        emitting: whether each belongs to an emitter.
        device: of the result.
    """
    firsts, counts = itertools.accumulate(vertices, initial=0), tuple(map(len, faces))
    none = torch.zeros(0, 3, dtype=torch.int32, device=device)
    rows = torch.cat([none, *(faces_of_shape.to(torch.int32) + first for faces_of_shape, first in zip(faces, firsts))])
    materials = of_each(material, counts, torch.int32, device)
    return interleaved((rows.unbind(1), materials, emitter_rows(emitting, counts, device)))


def of_each(values: Sequence[int | bool], counts: Sequence[int], dtype: torch.dtype, device: torch.device) -> Tensor:
    """Repeats the value of each shape for each of its triangles, (T,)."""
    return torch.tensor(values, dtype=dtype, device=device).repeat_interleave(torch.tensor(counts, device=device))


def emitter_rows(emitting: Sequence[bool], counts: Sequence[int], device: torch.device) -> Tensor:
    """The index of each triangle among those that emit light, (T,) int32; -1: it emits none."""
    if not any(emitting):
        return torch.full((sum(counts),), -1, dtype=torch.int32, device=device)
    emitting = of_each(emitting, counts, torch.bool, device)
    return torch.where(emitting, emitting.cumsum(0) - 1, -1).to(torch.int32)


def _numbers(shapes: Sequence[TriangleNumbering], counts: Sequence[int], device: torch.device) -> tuple[Tensor, Tensor]:
    """The index of each triangle in its shape, and the number of that shape, (T,) int32 each, for AOVs."""
    none = torch.zeros(0, dtype=torch.int32)
    numbers = [torch.arange(count, dtype=torch.int32) * shape.counted for shape, count in zip(shapes, counts)]
    return torch.cat([none, *numbers]).to(device), of_each([shape.shape for shape in shapes], counts, torch.int32, device)


def normals_and_clearances(vertices: Tensor, faces: Tensor) -> tuple[Vec3, Tensor]:
    """The unit normals of triangles, and the distances off them at which rays start to avoid self-intersection; (F,) each.

    Args:
        vertices: (V, 3) positions, detached.
        faces: (F, 3) integers.
    """
    columns, positions = [], Vec3.of(vertices)
    # By blocks, so that intermediate results stay in the processor's cache.
    for block in faces.split(BLOCK):
        corners = at_corners(positions, block.unbind(1))
        _, e1, e2 = edges(*corners)
        columns.append((*unit_normal(e1, e2), clearance(corners)))
    *n, clearances = (torch.cat(parts) for parts in zip(*columns))
    return Vec3(*n), clearances


def _concatenated(parts: Sequence[tuple[Vec3, Tensor]], dtype: torch.dtype, device: torch.device) -> tuple[Vec3, Tensor]:
    """Joins the normals and clearances of all shapes, (T,) each."""
    none = torch.zeros(0, dtype=dtype, device=device)
    *n, clearances = (torch.cat([none, *column]) for column in zip((none,) * 4, *((*n, offset) for n, offset in parts)))
    return interleaved((Vec3(*n), clearances))


def _tangents(vertices: VertexTable, corners: tuple[Tensor, Tensor, Tensor]) -> Vec3:
    """The unit tangents of triangles along which u grows, attached."""
    return growth_of_u(*edges(*at_corners(vertices.p, corners))[1:], *at_corners(vertices.uv, corners))


def growth_of_u(e1: Vec3, e2: Vec3, uv0: Vec2, uv1: Vec2, uv2: Vec2) -> Vec3:
    """The unit tangent of triangles along which u grows and v is constant; 0 where it is undefined. Attached.

    Args:
        e1, e2: (T,) edges from the first vertex.
        uv0, uv1, uv2: (T,) coordinates of the vertices.
    """
    d1, d2 = Vec2(uv1.x - uv0.x, uv1.y - uv0.y), Vec2(uv2.x - uv0.x, uv2.y - uv0.y)
    sign = torch.sign(d1.x * d2.y - d1.y * d2.x).detach()
    tangent = scaled(e1 * (sign * d2.y) - e2 * (sign * d1.y))
    is_defined = max_component(tangent.detach().map(torch.abs)) > 0
    return masked(is_defined, normalize(where(is_defined, tangent, Vec3.full(sign, 1.0))))
