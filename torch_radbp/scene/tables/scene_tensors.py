"""`SceneTensors`: the scene as one record of flat tensors, which is all that the path tracer reads."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torch_radbp.interface.balls import Balls
from torch_radbp.interface.emitter import LightKind, Table
from torch_radbp.interface.instances import Instances
from torch_radbp.interface.medium import MediumKind
from torch_radbp.interface.texture import OutsideReader, Reader, TableReader
from torch_radbp.sampling.alias import AliasTable
from torch_radbp.scene.tables.appearance import Appearance
from torch_radbp.scene.tables.light_choice import TreeChoice
from torch_radbp.scene.tables.placement import InstanceTable
from torch_radbp.tensors.differentiated import any_differentiated, detached
from torch_radbp.tensors.vec import Vec2, Vec3

SAME = -2  # in the place of a medium's number: a surface that changes nothing


@dataclass(frozen=True)
class Layout:
    """The static features of a scene, for which code is compiled: absent ones cost nothing. A constant in records."""

    bending: bool  # differentiated parameters steer directions that hybrid sampling differentiates
    bends_ideally: bool  # so do those of ideal mirrors and glass
    shading_normals: bool  # some differ from the triangles' own normals
    back_sides: bool  # some materials are different, or turned, from behind
    appearances: tuple[Appearance, ...]  # of materials
    readers: tuple[Reader, ...]  # of their textures
    radiance: TableReader  # of the textures of emitters
    radiance_bitmaps: bool  # some of them depend on u and v
    attributes: tuple[str, ...]  # names of mesh attributes that textures read
    lights: tuple[LightKind, ...]  # kinds of light
    media: tuple[MediumKind, ...] = ()  # that light travels through, by their numbers
    around: int | None = None  # the number of the medium in which the sensors stand; None: empty space
    from_lamps: bool = False  # paths begin at lamps, and end at the camera, which stands in the place of the lights
    # Rays are traced through media segment by segment, since they pass surfaces there, or some vary in space or emit.
    traces_segments: bool = False
    # Then the numbers of media in closed form that shapes enclose, so that a ray in them that meets nothing has left them.
    enclosed_media: tuple[int, ...] = ()
    # Then the appearances of surfaces that a part of the light passes straight: their number in `appearances`, the row of a
    # material that has it, and it.
    panes: tuple[tuple[int, int, Appearance], ...] = ()
    lit: tuple[OutsideReader, ...] = ()  # of those textures of emitters that are read outside
    scatterer: Appearance | None = None  # of a part of a scene, what light is scattered by; None: nothing
    vertex: Any = None  # of a part of a scene, the `path.vertex.VertexKind` of its lanes; hashable
    # Of each value of each of `appearances` whether no parameter that it comes from is differentiated. Of a part: of the
    # scatterer alone, where that is known; else nothing.
    still: tuple[tuple[bool, ...], ...] = ()

    @property
    def vertex_attributes(self) -> tuple[str, ...]:
        """The names of vertex attributes, in the order of `VertexTable.attributes`."""
        return tuple(name for name in self.attributes if not name.startswith("face_"))

    @property
    def face_attributes(self) -> tuple[str, ...]:
        """The names of face attributes, in the order of `TriangleTable.attributes`."""
        return tuple(name for name in self.attributes if name.startswith("face_"))

    @property
    def traces_cones(self) -> bool:
        """True if textures depend on the footprint of a sample, so that paths carry ray cones."""
        return any(reader.needs_footprint for reader in self.readers)

    @property
    def reads_outside(self) -> bool:
        """True if there are network textures, which are evaluated outside of compiled code."""
        return bool(self.lit) or any(reader.outside for reader in self.readers)

    @property
    def scattering_media(self) -> tuple[int, ...]:
        """The numbers of the media that scatter light."""
        return tuple(number for number, kind in enumerate(self.media) if kind.scatters)

    @property
    def heterogeneous_media(self) -> tuple[int, ...]:
        """The numbers of the media that vary in space, in which free flights are sampled by tracking."""
        return tuple(number for number, kind in enumerate(self.media) if kind.heterogeneous)

    @property
    def emitting_media(self) -> tuple[int, ...]:
        """The numbers of the media whose emission counts: of all that emit, but of none for paths that begin at lamps."""
        return tuple(number for number, kind in enumerate(self.media)
                     if kind.emission is not None and not self.from_lamps)

    @property
    def surface_lights(self) -> dict[int, LightKind]:
        """The kinds of light on surfaces, by their index in `lights`."""
        return {number: kind for number, kind in enumerate(self.lights) if kind.on_surface}

    @property
    def lit_surfaces(self) -> bool:
        """True if some triangles emit light."""
        return bool(self.surface_lights)

    @property
    def visible_surfaces(self) -> bool:
        """True if some emitting triangles are visible as emitters."""
        return any(not kind.delta for kind in self.surface_lights.values())

    @property
    def surround(self) -> tuple[int, LightKind] | None:
        """The kind of light of the environment with its index in `lights`; None: there is no environment."""
        return next(((number, kind) for number, kind in enumerate(self.lights) if kind.surround), None)


class VertexTable(NamedTuple):
    """The V vertices of all surfaces; attached."""

    p: Vec3  # (V,) each; position, world space or that of the group
    n: Vec3 | None  # unit shading normal, unused for surfaces with flat faces; None if no surface has any
    uv: Vec2 | None  # surface coordinates, None if no texture reads them
    attributes: tuple[Vec3, ...]  # mesh attributes that textures read; 0 where a mesh has none of that name


class TriangleTable(NamedTuple):
    """The T triangles of all shapes, in order: those of the scene in the world, then those of each group in its frame."""

    vertices: VertexTable
    corners: tuple[Tensor, Tensor, Tensor]  # (T,) int32 each, rows of `vertices`
    n: Vec3  # unit geometric normal, detached; with a derivative it is computed from the edges
    smooth: Tensor | None  # (T,) bool: shaded with vertex normals; None: so are all, or none
    clearance: Tensor  # (T,) distance off the triangle at which rays leave it (self-intersection), detached
    along: Vec3 | None  # unit tangent along which u grows, 0 where undefined; None if no material is anisotropic
    material: Tensor  # (T,) int32, row of `MaterialTable`
    emitter: Tensor  # (T,) int32, element of `LightTable`; -1: emits nothing
    balls: Balls | None  # the triangles that tessellate spheres, for ray casting
    attributes: tuple[Vec3, ...]  # (T,) each, mesh attributes of faces; attached
    numbers: tuple[Tensor, Tensor] | None = None  # (T,) int32: of the triangle in its shape, of the shape from 1; for AOVs
    instances: InstanceTable | None = None  # of groups; None: there are none
    plain: Tensor | None = None  # (T,) bool: reflected light is discontinuous only at shadow borders; None: of no triangle
    boundary: Tensor | None = None  # (T,) int32, row of `BoundaryTable`; None: rays are not followed through media

    @property
    def casting_instances(self) -> Instances | None:
        """The instances in the form that ray casters are built from."""
        return None if self.instances is None else self.instances.casting


class MaterialTable(NamedTuple):
    """The M materials of a scene, two rows each: first all seen from the front (the normal's side), then from the back."""

    appearance: Tensor  # (2 M,) int32, index into `Layout.appearances`
    slots: tuple[Tensor, ...]  # (2 M,) int32 for each parameter: its texture, a row of its reader's bank
    turned: Tensor  # (2 M,) bool: the shading frame is flipped towards the viewer
    differs: Tensor | None  # (M,) bool: another appearance from behind, so that lanes queue by the side; None: no material
    count: Tensor  # () int32, M
    narrow: Tensor | None = None  # (2 M,) bool: of small roughness, see `path/light_share.py`; None: nobody asks


class BoundaryTable(NamedTuple):
    """The kinds of boundaries between media, a row each; surfaces that bound no medium have a row, too."""

    inside: Tensor  # (B,) int32 number of the medium behind the surface; -1: empty space, `SAME`: that before it
    outside: Tensor  # (B,) int32 likewise before it, on the side of its normal
    invisible: Tensor  # (B,) bool: all light passes straight through


class LightTable(NamedTuple):
    """The E elements for light selection: triangles of emitters on surfaces first, then other emitters.

    The elements of one kind of light are the rows of that kind's table, in order.
    """

    choice: AliasTable | TreeChoice
    kind: Tensor  # (E,) int32, index into `Layout.lights`
    row: Tensor  # (E,) int32, row in the table of the kind
    radiance: Tensor  # (E,) int32 texture of the light bank; 0 of a kind that reads none
    tables: tuple[Table, ...]  # one for each of `Layout.lights`
    surround_pmf: Tensor  # () probability of selecting the environment
    outside: tuple[Tensor, ...] = ()  # for each of `Layout.lit` (E,) int32, texture of its bank; -1: another reads it

    @property
    def by_place(self) -> bool:
        """True if lights are selected by a tree, given the point to be illuminated."""
        return isinstance(self.choice, TreeChoice)


class SceneTensors(NamedTuple):
    """All tables that the path tracer reads; attached to the parameters of the scene."""

    triangles: TriangleTable
    materials: MaterialTable
    textures: tuple[Any, ...]  # the banks of `Layout.readers`
    lights: LightTable
    radiance: Any  # the bank of `Layout.radiance`
    lit: tuple[Any, ...]  # the banks of `Layout.lit`
    media: tuple[Any, ...]  # the tables of `Layout.media`
    boundaries: BoundaryTable | None  # None: media have none
    layout: Layout

    @property
    def device(self) -> torch.device:
        return self.triangles.material.device

    @property
    def dtype(self) -> torch.dtype:
        return self.triangles.vertices.p.x.dtype

    @property
    def lights_move(self) -> bool:
        """True if the position or direction of a light that is not a surface is differentiated."""
        return any_differentiated([table for kind, table in zip(self.layout.lights, self.lights.tables)
                                   if not (kind.surround or kind.on_surface)])


def of_triangles(scene: SceneTensors, of_rows: Tensor) -> Tensor:
    """(T,) bool: triangles whose material, on one side or on both, has a property; `of_rows`: (2 M,) bool, of each material
    on each side."""
    return of_rows.view(2, -1).any(0)[scene.triangles.material.long()]


def extent_of(scene: Any) -> Tensor:
    """() float64, the longest side of the bounding box of all vertices of a `SceneTensors` or `Geometry`."""
    ends = [part.aminmax() for part in scene.triangles.vertices.p]
    return torch.stack([end.max - end.min for end in ends]).amax().double()


def proposal_of(scene: SceneTensors) -> SceneTensors:
    """The scene by which directions, lobes and lights are sampled: the same tables, detached."""
    return detached(scene)
