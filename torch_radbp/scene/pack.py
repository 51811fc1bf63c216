"""`pack`: from the modules of a `Scene` to `SceneTensors`, by ordinary differentiable torch."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torch_radbp.bsdf.twosided import TwoSided
from torch_radbp.plugin import BSDF, Texture
from torch_radbp.scene.appearance import Appearance
from torch_radbp.scene.differentiated import differentiated
from torch_radbp.scene.interaction import at_corners, clearance, edges
from torch_radbp.scene.light_table import kinds_of, light_table
from torch_radbp.scene.parameters import check_extent, check_parameters
from torch_radbp.scene.scene import Scene
from torch_radbp.scene.tensors import Layout, MaterialTable, SceneTensors, TriangleTable, VertexTable
from torch_radbp.shape.surface import Triangles
from torch_radbp.texture.bank import TextureBank
from torch_radbp.texture.bitmap import reader_of, texture_bank
from torch_radbp.texture.reader import Reader
from torch_radbp.texture.rgb import RGB
from torch_radbp.vec import Vec2, Vec3, masked, max_component, normalize, scaled, unit_normal, where

BLOCK = 1 << 15  # number of triangles that are processed at a time
FEW = 1 << 10  # number of triangles examined before all of a surface are
FLAT = 1e-5  # largest difference between a vertex normal and that of its face on a flat surface


class BankBuilder:
    """Collects textures; each is stored once however often it is used."""

    def __init__(self) -> None:
        self.textures: list[Texture] = []
        self.index: dict[int, int] = {}

    def add(self, texture: Texture) -> int:
        """The index of `texture` in the bank."""
        if id(texture) not in self.index:
            self.index[id(texture)] = len(self.textures)
            self.textures.append(texture)
        return self.index[id(texture)]

    @property
    def has_bitmaps(self) -> bool:
        return any(texture.has_coordinates if hasattr(texture, "has_coordinates") else reader_of(texture).needs_uv
                   for texture in self.textures)

    def build(self, dtype: torch.dtype, device: torch.device) -> TextureBank:
        return texture_bank(self.textures or [RGB(value=0.0)], dtype, device)


def pack(scene: Scene) -> SceneTensors:
    """The tensors of a scene, attached to its parameters.

    Raises:
        ValueError: if a parameter is not in its domain; the message names it.
        TypeError: if the parameters are not of one dtype.
    """
    check_parameters(scene)
    dtype, device = scene.dtype, scene.device
    radiance = BankBuilder()
    bsdfs = list(scene.bsdfs())
    materials, appearances, readers, banks = material_tables(bsdfs, dtype, device)
    surfaces = [without_flat_normals(shape.oriented()) for shape in scene.shapes]
    check_extent(scene, [surface.vertices for surface in surfaces])
    counts = [len(surface.faces) for surface in surfaces]
    row = {id(bsdf): index for index, bsdf in enumerate(bsdfs)}
    material = [row[id(shape.bsdf)] for shape in scene.shapes]
    radiated = {id(emitter): emitter.radiated() for emitter in scene.emitters}
    textures = {name: 0 if texture is None else radiance.add(texture) for name, texture in radiated.items()}
    layout = Layout(
        bending=any(differentiated(bsdf.textures()[slot].texels()) for bsdf in one_sided(bsdfs)
                    for slot in bsdf.kind().bending),
        shading_normals=any(surface.normals is not None for surface in surfaces),
        back_sides=bool(materials.turned.any()), sides_differ=sides_differ(materials), appearances=appearances,
        readers=readers, radiance_bitmaps=radiance.has_bitmaps, lights=kinds_of(scene.emitters))
    needs_uv = layout.radiance_bitmaps or any(look.needs_uv for look in appearances)
    oriented = any(look.kind.oriented for look in appearances)
    triangles = triangle_table(surfaces, layout.shading_normals, needs_uv, oriented, dtype, device)
    repeats = torch.tensor(counts, device=device)
    emitting = torch.tensor([shape.emitter is not None for shape in scene.shapes], device=device).repeat_interleave(repeats)
    triangles = triangles._replace(
        material=torch.tensor(material, dtype=torch.int32, device=device).repeat_interleave(repeats),
        emitter=torch.where(emitting, emitting.cumsum(0) - 1, -1).to(torch.int32))
    lights = light_table(scene, layout.lights, triangles, counts, lambda emitter: textures[id(emitter)],
                         layout.radiance_bitmaps)
    return SceneTensors(triangles, materials, banks, lights,
                        radiance.build(dtype, device), layout)


def without_flat_normals(surface: Triangles) -> Triangles:
    """The surface without vertex normals if they equal those of its faces, and no derivative can tell them apart."""
    if surface.normals is None or differentiated(surface.normals) or differentiated(surface.vertices):
        return surface
    some = surface.faces[::max(1, len(surface.faces) // FEW)]
    flat = flat_normals(surface, some) and flat_normals(surface, surface.faces)
    return surface._replace(normals=None) if flat else surface


def flat_normals(surface: Triangles, faces: Tensor) -> bool:
    """True if the vertex normals of some faces of a surface, (F, 3), equal the normals of these faces."""
    normals, _ = normals_and_clearances(Vec3.of(surface.vertices), faces.unbind(1))
    return bool((surface.normals[faces] - normals.stack()[:, None]).abs().max() < FLAT)


class Materials(NamedTuple):
    """The materials of a scene as tables."""

    table: MaterialTable
    appearances: tuple[Appearance, ...]
    readers: tuple[Reader, ...]
    textures: tuple[Any, ...]  # the banks of the readers


def material_tables(bsdfs: list[BSDF], dtype: torch.dtype, device: torch.device) -> Materials:
    """The rows of all materials, their appearances, and their textures."""
    two_sided = [isinstance(bsdf, TwoSided) for bsdf in bsdfs]
    sides = one_sided(bsdfs)
    textures = [bsdf.textures() for bsdf in sides]
    looks = [Appearance(bsdf.kind(), tuple(map(reader_of, own))) for bsdf, own in zip(sides, textures)]
    appearances = tuple(dict.fromkeys(looks))
    readers = tuple(dict.fromkeys(reader for look in appearances for reader in look.readers))
    of_reader: dict[Reader, dict[int, Texture]] = {reader: {} for reader in readers}
    for look, own in zip(looks, textures):
        for reader, texture in zip(look.readers, own):
            of_reader[reader].setdefault(id(texture), texture)
    row = {reader: {key: number for number, key in enumerate(found)} for reader, found in of_reader.items()}
    slots = [[row[reader][id(texture)] for reader, texture in zip(look.readers, own)] for look, own in zip(looks, textures)]

    def column(values: Sequence[int | bool], kind: torch.dtype = torch.int32) -> Tensor:
        return torch.tensor(values, dtype=kind, device=device)

    table = MaterialTable(
        column([appearances.index(look) for look in looks]),
        tuple(column([own[k] if k < len(own) else 0 for own in slots]) for k in range(max(map(len, slots), default=0))),
        column([False] * len(bsdfs) + two_sided, torch.bool), column(len(bsdfs)))
    banks = tuple(reader.bank(list(of_reader[reader].values()), dtype, device) for reader in readers)
    return Materials(table, appearances, readers, banks)


def sides_differ(materials: MaterialTable) -> bool:
    """True if a material has another appearance from behind."""
    front, back = materials.appearance.chunk(2)
    return not torch.equal(front, back)


def one_sided(bsdfs: Iterable[BSDF]) -> list[BSDF]:
    """All materials as seen from the side of the normal, then all from behind."""
    sides = [bsdf.sides() if isinstance(bsdf, TwoSided) else (bsdf, bsdf) for bsdf in bsdfs]
    return [front for front, _ in sides] + [back for _, back in sides]


def concatenated_faces(surfaces: list[Triangles], device: torch.device) -> Tensor:
    """The faces of all surfaces, (F, 3) int32 rows of their concatenated vertices."""
    firsts = itertools.accumulate((len(surface.vertices) for surface in surfaces), initial=0)
    none = torch.zeros(0, 3, dtype=torch.int32, device=device)
    return torch.cat([none, *(surface.faces.to(torch.int32) + first for surface, first in zip(surfaces, firsts))])


def vertex_table(surfaces: list[Triangles], normals: bool, uv: bool, dtype: torch.dtype,
                 device: torch.device) -> VertexTable:
    """The vertices of all surfaces; if wanted with normals and uv, which are zero where a surface has none."""
    none = torch.zeros(0, 3, dtype=dtype, device=device)

    def column(parts: list[Tensor | None], width: int) -> Tensor:
        rows = [surface.vertices.new_zeros(len(surface.vertices), width) if part is None else part
                for surface, part in zip(surfaces, parts)]
        return torch.cat([none[:, :width], *(row.to(dtype) for row in rows)])

    return VertexTable(Vec3.of(column([surface.vertices for surface in surfaces], 3)),
                       Vec3.of(column([surface.normals for surface in surfaces], 3)) if normals else None,
                       Vec2.of(column([surface.uv for surface in surfaces], 2)) if uv else None)


def triangle_table(surfaces: list[Triangles], normals: bool, uv: bool, tangents: bool, dtype: torch.dtype,
                   device: torch.device) -> TriangleTable:
    """All triangles; materials and emitters are filled in by the caller."""
    vertices = vertex_table(surfaces, normals, uv or tangents, dtype, device)
    corners = tuple(corner.contiguous() for corner in concatenated_faces(surfaces, device).unbind(1))
    n, clearances = normals_and_clearances(vertices.p.detach(), corners)
    smooth = torch.tensor([surface.normals is not None for surface in surfaces], device=device)
    smooth = None if smooth.all() or not normals else smooth.repeat_interleave(
        torch.tensor([len(surface.faces) for surface in surfaces], device=device))
    along = None
    if tangents:
        along = growth_of_u(*edges(*at_corners(vertices.p, corners))[1:], *at_corners(vertices.uv, corners))
    if not uv:
        vertices = vertices._replace(uv=None)
    return TriangleTable(vertices, corners, n, smooth, clearances, along, None, None)


def normals_and_clearances(vertices: Vec3, corners: Sequence[Tensor]) -> tuple[Vec3, Tensor]:
    """The unit normals of triangles, and the distances off them at which rays start; (T,) each.

    Args:
        vertices: (V,) positions, detached.
        corners: three times (T,) integer rows of `vertices`.
    """
    columns = []
    # By blocks, so that intermediate results stay in the processor's cache.
    for block in zip(*(corner.split(BLOCK) for corner in corners)):
        positions = at_corners(vertices, block)
        _, e1, e2 = edges(*positions)
        columns.append((*unit_normal(e1, e2), clearance(positions)))
    *n, clearances = (torch.cat(parts) for parts in zip(*columns))
    return Vec3(*n), clearances


def growth_of_u(e1: Vec3, e2: Vec3, uv0: Vec2, uv1: Vec2, uv2: Vec2) -> Vec3:
    """The unit direction in a triangle along which u grows and v is constant; 0 where it is undefined. Attached.

    Args:
        e1, e2: (T,) edges from the first vertex.
        uv0, uv1, uv2: (T,) coordinates of the vertices.
    """
    d1, d2 = Vec2(uv1.x - uv0.x, uv1.y - uv0.y), Vec2(uv2.x - uv0.x, uv2.y - uv0.y)
    sign = torch.sign(d1.x * d2.y - d1.y * d2.x).detach()
    tangent = scaled(e1 * (sign * d2.y) - e2 * (sign * d1.y))
    known = max_component(tangent.detach().map(torch.abs)) > 0
    return masked(known, normalize(where(known, tangent, Vec3.full(sign, 1.0))))
