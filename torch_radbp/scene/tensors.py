"""`SceneTensors`: the scene as one record of flat tensors, which is all that the tracer reads."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.bsdf.kind import Kind
from torch_radbp.sampling.alias import AliasTable
from torch_radbp.sampling.grid import GridDistribution
from torch_radbp.texture.bank import TextureBank
from torch_radbp.vec import Frame, Vec2, Vec3

# Kinds of light; POINT and those after it have a pose and no extent.
AREA, CONSTANT, ENVIRONMENT, POINT, SPOT, PROJECTOR, DIRECTIONAL = range(7)


class Layout(NamedTuple):
    """The features of a scene: static, so that absent ones cost nothing."""

    bending: bool  # parameters with derivatives steer ideal specular scattering
    shading_normals: bool  # some differ from the triangles' own normals
    light_normals: bool  # the same, on area lights
    back_sides: bool  # some materials are different, or turned, from behind
    kinds: tuple[Kind, ...]  # of materials
    anisotropic: bool  # some materials are, so that the shading frame follows the surface's coordinates
    reflectance_bitmaps: bool
    radiance_bitmaps: bool
    area_lights: bool
    constant_light: bool
    environment_map: bool
    point_lights: bool
    spots: bool
    projectors: bool
    directional_lights: bool

    @property
    def posed_lights(self) -> bool:
        """True if there are lights without extent."""
        return self.point_lights or self.spots or self.projectors or self.directional_lights

    @property
    def surround(self) -> bool:
        """True if rays that leave the scene meet light."""
        return self.constant_light or self.environment_map

    @property
    def only_surfaces_emit(self) -> bool:
        """True if all lights are area lights."""
        return not (self.posed_lights or self.distant_lights)

    @property
    def distant_lights(self) -> bool:
        """True if there are lights at infinity: directions rather than points."""
        return self.constant_light or self.environment_map or self.directional_lights


class VertexTable(NamedTuple):
    """The V vertices of some surfaces; attached."""

    p: Vec3  # (V,) each; position, world space
    n: Vec3 | None  # unit shading normal, unused for surfaces with flat faces; None if no surface has any
    uv: Vec2 | None  # surface coordinates, None if no texture reads them


class TriangleTable(NamedTuple):
    """The T triangles of all shapes, in order."""

    vertices: VertexTable
    corners: tuple[Tensor, Tensor, Tensor]  # (T,) int32 each, rows of `vertices`
    n: Vec3  # unit geometric normal, detached: where it needs a derivative, `unit_normal` of the edges gives it
    smooth: Tensor | None  # (T,) bool: shaded with the normals of its vertices; None: so are all, or none
    clearance: Tensor  # (T,) distance off the triangle at which rays leave it, detached
    along: Vec3 | None  # unit direction in which u grows, 0 where it is not defined; None if no material is anisotropic
    material: Tensor  # (T,) int32, row of `MaterialTable`
    emitter: Tensor  # (T,) int32, row of `EmittingTriangles`; -1: emits nothing


class EmittingTriangles(NamedTuple):
    """The S triangles of area lights, for light samples: few, where the scene has many; attached but for choices."""

    corners: tuple[VertexTable, VertexTable, VertexTable]  # (S,) the first vertices of all, the second and the third ones
    n: Vec3  # unit geometric normal
    smooth: Tensor | None  # (S,) as in `TriangleTable`
    radiance: Tensor  # (S,) int32, texture of the light bank
    pmf: Tensor  # (S,) probability with which next-event estimation picks it, detached
    inverse_area: Tensor  # (S,) 1 / area; 0 of a triangle that is never picked


class MaterialTable(NamedTuple):
    """Two rows for each of M materials: first all seen from the side of the normal, then all seen from behind."""

    kind: Tensor  # (2 M,) int32, of `Layout.kinds`
    slots: tuple[Tensor, ...]  # (2 M,) int32 each: the textures that the functions of the kind take
    turned: Tensor  # (2 M,) bool: the shading frame is turned towards the viewer
    count: Tensor  # () int32, M


class PosedLights(NamedTuple):
    """One row per light without extent; attached."""

    place: Vec3  # (P,) position; of a directional light the unit direction towards it
    to_local: Frame  # (P,) rows of the matrix from world directions to the light's, which shines along its +z
    cutoff: Tensor  # (P,) angle where a spot ends, radians
    sharpness: Tensor  # (P,) 1 / width of the fall-off of a spot before the cutoff, 1 / radians
    to_uv: Vec2  # (P,) factors from x / z and y / z to texture coordinates, around the middle


class EnvironmentMap(NamedTuple):
    """An image of the surroundings: R rows of texels, C columns; cells lie between the centres of four texels."""

    to_local: Frame  # (1,) rows of the matrix from world directions to the image's; attached
    to_world: Frame  # () rows of its inverse, detached
    volume: Tensor  # () absolute value of the determinant of `to_local`, detached
    rows: Tensor  # () int32, R
    columns: Tensor  # () int32, C
    pick: GridDistribution  # of the cells
    density: Tensor  # (cells,) over the solid angle of local directions, with which a cell is sampled
    weighing: Tensor  # (R C,) density at the texels themselves, for weights; 0 beside a cell that is never picked
    edges: Tensor  # (R,) sin^2(theta / 2) of the rows of texels, from pole to pole


class LightTable(NamedTuple):
    """The E elements for next-event estimation: triangles of area lights, the surround, lights with a pose."""

    choice: AliasTable
    kind: Tensor  # (E,) int32: AREA, CONSTANT, ...
    surfaces: EmittingTriangles
    surface: Tensor  # (E,) int32 row of `surfaces` of an area light, else 0
    pose: Tensor  # (E,) int32 row of `posed`, else 0
    radiance: Tensor  # (E,) int32 texture of the light bank
    posed: PosedLights | None  # None if there are none
    surround: Tensor  # () int32 texture of the constant emitter, 0 if there is none
    surround_pmf: Tensor  # () probability of picking the constant emitter or the environment map
    environment: EnvironmentMap | None


class SceneTensors(NamedTuple):
    """Everything that the tracer reads; attached to the parameters of the scene."""

    triangles: TriangleTable
    materials: MaterialTable
    reflectance: TextureBank
    lights: LightTable
    radiance: TextureBank
    layout: Layout

    @property
    def device(self) -> torch.device:
        return self.triangles.material.device

    @property
    def dtype(self) -> torch.dtype:
        return self.triangles.vertices.p.x.dtype
