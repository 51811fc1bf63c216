"""Bakes any shape to a triangle mesh with surface coordinates."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import torch
from torch import Tensor

from torch_radbp.formats.trimesh_arrays import is_trimesh
from torch_radbp.install_hint import install_with
from torch_radbp.plugin import BSDF, Emitter, Shape, boolean, integer
from torch_radbp.public_call import public_call
from torch_radbp.shape.instance import Instance, instanced
from torch_radbp.shape.mesh import TensorMesh
from torch_radbp.shape.shapegroup import ShapeGroup
from torch_radbp.shape.surface import Surface, Triangles

if TYPE_CHECKING:
    import trimesh

GAP = 4  # texels between charts


class ShapeTriangles(NamedTuple):
    """The triangles of a shape in world space, with material and emitter."""

    surface: Triangles
    bsdf: BSDF
    emitter: Emitter | None


@public_call
def mesh(shape: Shape | trimesh.Trimesh | trimesh.Scene, *, unwrap: bool = False, resolution: int = 1024) -> TensorMesh:
    """Bakes a shape to triangles in world space, with surface coordinates for bitmaps.

        scene.body = rb.bake.mesh(scene.body)  # an sdfgrid, say; the material stays

    Of a shape that has no surface coordinates, or if asked for, the surface is cut into charts that are laid side by side in
    the unit square, none over another (the library xatlas, of the extra `bake`). It takes some seconds for
    20,000 triangles. Vertices on the borders of charts are doubled: optimised further they would move apart, so bake last.

    A group, or an instance of one, becomes a single mesh; its shapes must have one material. Normals are those of the
    vertices; a shape that is shaded flat stays so. Attributes that all its shapes have are kept.

    Args:
        shape: an `sdfgrid`, a `sphere`, a `shapegroup`, an `instance`, a mesh, ..., or a mesh of trimesh, which is first
            read as a shape `mesh`; `to_trimesh` of the result leads back.
        unwrap: find new surface coordinates also where there are some. What reads the old ones, such as bitmaps of the
            material, does not follow.
        resolution: of the bitmaps that are meant for it, texels to a side; charts keep a distance of a few of them.

    Returns:
        A shape `mesh` with the material and the emitter of the shape (the same modules), of its dtype and device, detached.

    Raises:
        TypeError: if it is no shape.
        ValueError: if the shapes of a group have several materials.
        ImportError: if xatlas is needed and not installed.

    Reference: Levy et al. 2002, "Least Squares Conformal Maps for Automatic Texture Atlas Generation".
    """
    shape = TensorMesh.of_trimesh(shape) if is_trimesh(shape) else shape
    if not isinstance(shape, Surface | ShapeGroup | Instance):
        raise TypeError(f"a shape becomes a mesh, got {type(shape).__name__}")
    boolean("unwrap", unwrap), integer("resolution", resolution, 16)
    with torch.no_grad():
        body = body_of(shape)
    surface = body.surface
    if unwrap or surface.uv is None:
        surface = _unwrapped(surface, resolution)
    baked = TensorMesh(vertex_positions=surface.vertices, faces=surface.faces, vertex_normals=surface.normals,
                       vertex_texcoords=surface.uv, bsdf=body.bsdf, emitter=body.emitter).to(surface.vertices)
    for name, values in surface.attributes:
        baked.add_attribute(name, values)
    return baked


def body_of(shape: Surface | ShapeGroup | Instance) -> ShapeTriangles:
    """All triangles of a shape, a group or an instance, as one surface.

    Raises:
        ValueError: if they have several materials.
    """
    if isinstance(shape, Surface):
        return ShapeTriangles(shape.oriented()._replace(ball=None), shape.bsdf, shape.emitter)
    group = shape.shapegroup if isinstance(shape, Instance) else shape
    surfaces, names = list(group.shapes.values()), list(group.shapes)
    if len({id(each.bsdf) for each in surfaces}) != 1:
        raise ValueError(f"a mesh has one material, and the shapes of the group, {', '.join(names)}, have several or none "
                         f"that they share: bake each by itself, rb.bake.mesh(group.{names[0] if names else 'NAME'})")
    surface = _joined([each.oriented() for each in surfaces])
    surface = instanced(surface, shape.to_world) if isinstance(shape, Instance) else surface
    return ShapeTriangles(surface, surfaces[0].bsdf, None)


def _joined(surfaces: list[Triangles]) -> Triangles:
    """Joins surfaces to one; attributes that only some have are dropped, but flat ones get normals."""
    if any(each.normals is None for each in surfaces) and any(each.normals is not None for each in surfaces):
        surfaces = [flat_with_normals(each) if each.normals is None else each for each in surfaces]
    starts = torch.tensor([0, *(len(each.vertices) for each in surfaces[:-1])]).cumsum(0).tolist()

    def rows(parts: list[Tensor | None]) -> Tensor | None:
        return None if any(part is None for part in parts) else torch.cat(parts)

    attributes = [dict(each.attributes) for each in surfaces]
    shared = [name for name, values in attributes[0].items()
              if all(name in columns and columns[name].shape[1] == values.shape[1] for columns in attributes)]
    return Triangles(torch.cat([each.vertices for each in surfaces]),
                     torch.cat([each.faces + start for each, start in zip(surfaces, starts)]),
                     rows([each.normals for each in surfaces]), rows([each.uv for each in surfaces]),
                     attributes=tuple((name, torch.cat([columns[name] for columns in attributes])) for name in shared))


def flat_with_normals(surface: Triangles) -> Triangles:
    """A flat surface with face normals at its vertices, which triangles no longer share."""
    corner = surface.faces.flatten()
    first, second, third = surface.vertices[surface.faces].unbind(1)
    normals = torch.nn.functional.normalize(torch.linalg.cross(second - first, third - first), dim=1)
    return Triangles(surface.vertices[corner], torch.arange(len(corner), device=corner.device).view(-1, 3),
                     normals.repeat_interleave(3, 0), None if surface.uv is None else surface.uv[corner],
                     attributes=tuple((name, values if name.startswith("face_") else values[corner])
                                      for name, values in surface.attributes))


def _unwrapped(surface: Triangles, resolution: int) -> Triangles:
    """A surface with charts by xatlas as surface coordinates."""
    try:
        import xatlas
    except ImportError as error:
        raise ImportError(f"surface coordinates are found by the library xatlas: {install_with('bake')}") from error
    packing = xatlas.PackOptions()
    packing.resolution, packing.padding, packing.bilinear = resolution, GAP, True
    atlas = xatlas.Atlas()
    vertices, normals = (None if part is None else part.detach().cpu().float().contiguous().numpy()
                         for part in (surface.vertices, surface.normals))
    atlas.add_mesh(vertices, surface.faces.cpu().int().contiguous().numpy().astype("uint32"), normals)
    atlas.generate(pack_options=packing)
    vertex, faces, uv = (torch.from_numpy(part.astype(kind)).to(surface.vertices.device)
                         for part, kind in zip(atlas[0], ("int64", "int64", "float64")))
    return Triangles(surface.vertices[vertex], faces, None if surface.normals is None else surface.normals[vertex],
                     uv.to(surface.vertices.dtype),
                     attributes=tuple((name, values if name.startswith("face_") else values[vertex])
                                      for name, values in surface.attributes))
