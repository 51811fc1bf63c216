"""`SceneTensors`: the scene as one record of flat tensors, which is all that the tracer reads."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torch_radbp.emitter.kind import LightKind, Table
from torch_radbp.medium.kind import MediumKind
from torch_radbp.sampling.alias import AliasTable
from torch_radbp.scene.appearance import Appearance
from torch_radbp.scene.light_choice import TreeChoice
from torch_radbp.scene.placement import InstanceTable
from torch_radbp.shape.ball import Balls
from torch_radbp.shape.placement import Instances
from torch_radbp.tensors.differentiated import detached
from torch_radbp.tensors.vec import Vec2, Vec3
from torch_radbp.texture.reader import OutsideReader, Reader, TableReader


@dataclass(frozen=True)
class Layout:
    """The features of a scene: static, so that absent ones cost nothing. For records of tensors it is one constant."""

    bending: bool  # parameters with derivatives steer directions that hybrid sampling follows
    bends_ideally: bool  # by ideal mirrors and glass
    shading_normals: bool  # some differ from the triangles' own normals
    back_sides: bool  # some materials are different, or turned, from behind
    appearances: tuple[Appearance, ...]  # of materials
    readers: tuple[Reader, ...]  # of their textures
    radiance: TableReader  # of the textures of emitters
    radiance_bitmaps: bool  # some of them have coordinates
    attributes: tuple[str, ...]  # of meshes, that textures read
    lights: tuple[LightKind, ...]  # kinds of light
    media: tuple[MediumKind, ...] = ()  # that light travels through
    lit: tuple[OutsideReader, ...] = ()  # of those textures of emitters that are read outside
    scatterer: Appearance | None = None  # of a part of a scene, what light is scattered by; None: nothing
    # Of each value of each of `appearances` whether no parameter that it comes from is differentiated. Of a part: of the
    # scatterer alone, where that is known; else nothing.
    still: tuple[tuple[bool, ...], ...] = ()

    @property
    def vertex_attributes(self) -> tuple[str, ...]:
        """The attributes of vertices, in the order of `VertexTable.attributes`."""
        return tuple(name for name in self.attributes if not name.startswith("face_"))

    @property
    def face_attributes(self) -> tuple[str, ...]:
        """The attributes of triangles, in the order of `TriangleTable.attributes`."""
        return tuple(name for name in self.attributes if name.startswith("face_"))

    @property
    def traces_cones(self) -> bool:
        """True if textures depend on how much of a surface a sample sees, so that paths carry cones."""
        return any(reader.needs_footprint for reader in self.readers)

    @property
    def reads_outside(self) -> bool:
        """True if some textures are read outside of the functions of a bounce."""
        return bool(self.lit) or any(look.outside for look in self.appearances)

    @property
    def surface_lights(self) -> dict[int, LightKind]:
        """The kinds of light on surfaces, by their number in `lights`."""
        return {number: kind for number, kind in enumerate(self.lights) if kind.on_surface}

    @property
    def lit_surfaces(self) -> bool:
        """True if some triangles belong to an emitter."""
        return bool(self.surface_lights)

    @property
    def visible_surfaces(self) -> bool:
        """True if some of them are seen to emit."""
        return any(not kind.delta for kind in self.surface_lights.values())

    @property
    def surround(self) -> tuple[int, LightKind] | None:
        """The kind of light that rays meet which leave the scene, with its number in `lights`; None: there is none."""
        return next(((number, kind) for number, kind in enumerate(self.lights) if kind.surround), None)


class VertexTable(NamedTuple):
    """The V vertices of some surfaces; attached."""

    p: Vec3  # (V,) each; position, world space or that of the group
    n: Vec3 | None  # unit shading normal, unused for surfaces with flat faces; None if no surface has any
    uv: Vec2 | None  # surface coordinates, None if no texture reads them
    attributes: tuple[Vec3, ...]  # those that textures read; 0 where a mesh has none of that name


class TriangleTable(NamedTuple):
    """The T triangles of all shapes, in order: those of the scene in the world, then those of each group in its frame."""

    vertices: VertexTable
    corners: tuple[Tensor, Tensor, Tensor]  # (T,) int32 each, rows of `vertices`
    n: Vec3  # unit geometric normal, detached: where it needs a derivative, `unit_normal` of the edges gives it
    smooth: Tensor | None  # (T,) bool: shaded with the normals of its vertices; None: so are all, or none
    clearance: Tensor  # (T,) distance off the triangle at which rays leave it, detached
    along: Vec3 | None  # unit direction in which u grows, 0 where it is not defined; None if no material is oriented
    material: Tensor  # (T,) int32, row of `MaterialTable`
    emitter: Tensor  # (T,) int32, element of `LightTable`; -1: emits nothing
    balls: Balls | None  # those of them that tessellate spheres, for ray casting
    attributes: tuple[Vec3, ...]  # (T,) each, as those of vertices; attached
    numbers: tuple[Tensor, Tensor] | None = None  # (T,) int32: of the triangle in its shape, of the shape from 1; for AOVs
    instances: InstanceTable | None = None  # of groups; None: there are none
    plain: Tensor | None = None  # (T,) bool: light jumps inside of it at borders of shadows alone; None: of no triangle

    @property
    def casting_instances(self) -> Instances | None:
        """Those instances as ray casters know them."""
        return None if self.instances is None else self.instances.casting


class MaterialTable(NamedTuple):
    """Two rows for each of M materials: first all seen from the side of the normal, then all seen from behind."""

    appearance: Tensor  # (2 M,) int32, of `Layout.appearances`
    slots: tuple[Tensor, ...]  # (2 M,) int32 each: the texture that gives this value, a row of its reader's bank
    turned: Tensor  # (2 M,) bool: the shading frame is turned towards the viewer
    differs: Tensor | None  # (M,) bool: another appearance from behind, so that lanes queue by the side; None: no material
    count: Tensor  # () int32, M


class LightTable(NamedTuple):
    """The E elements for next-event estimation: triangles of emitters on surfaces first, then other emitters.

    Those of one kind are the rows of its table, in order.
    """

    choice: AliasTable | TreeChoice
    kind: Tensor  # (E,) int32, of `Layout.lights`
    row: Tensor  # (E,) int32, of the table of the kind
    radiance: Tensor  # (E,) int32 texture of the light bank; 0 of a kind that reads none
    tables: tuple[Table, ...]  # of `Layout.lights`
    surround_pmf: Tensor  # () probability of picking the surround
    outside: tuple[Tensor, ...] = ()  # for each of `Layout.lit` (E,) int32, texture of its bank; -1: another reads it

    @property
    def by_place(self) -> bool:
        """True if lights are picked with regard to the place that they are to illuminate."""
        return isinstance(self.choice, TreeChoice)


class SceneTensors(NamedTuple):
    """Everything that the tracer reads; attached to the parameters of the scene."""

    triangles: TriangleTable
    materials: MaterialTable
    textures: tuple[Any, ...]  # the banks of `Layout.readers`
    lights: LightTable
    radiance: Any  # the bank of `Layout.radiance`
    lit: tuple[Any, ...]  # the banks of `Layout.lit`
    media: tuple[Any, ...]  # the tables of `Layout.media`
    layout: Layout

    @property
    def device(self) -> torch.device:
        return self.triangles.material.device

    @property
    def dtype(self) -> torch.dtype:
        return self.triangles.vertices.p.x.dtype


def proposal_of(scene: SceneTensors) -> SceneTensors:
    """The scene by which directions, lobes and lights are sampled: the same tables without derivatives."""
    return detached(scene)
