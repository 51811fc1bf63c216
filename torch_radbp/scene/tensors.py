"""`SceneTensors`: the scene as one record of flat tensors, all that the tracer reads."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.sampling.alias import AliasTable
from torch_radbp.scene.lookup import TextureBank
from torch_radbp.vec import Vec2, Vec3

AREA, CONSTANT, POINT = 0, 1, 2  # kinds of light


class Layout(NamedTuple):
    """What a scene contains: static, so that nothing is computed for what is not there."""

    shading_normals: bool  # that differ from the triangles' own
    light_normals: bool  # the same, on area lights
    back_sides: bool
    reflectance_bitmaps: bool
    radiance_bitmaps: bool
    area_lights: bool
    constant_light: bool
    point_lights: bool


class TriangleTable(NamedTuple):
    """The T triangles of all shapes, in order."""

    p0: Vec3  # (T,) each; first vertex, world space
    e1: Vec3  # to the second vertex
    e2: Vec3  # to the third vertex
    n: Vec3  # unit geometric normal
    n0: Vec3 | None  # unit shading normals at the vertices, None if the scene has none
    n1: Vec3 | None
    n2: Vec3 | None
    uv0: Vec2 | None  # surface coordinates, None if no texture reads them
    uv1: Vec2 | None
    uv2: Vec2 | None
    material: Tensor  # (T,) int32, row of `MaterialTable`
    radiance: Tensor  # (T,) int32, texture of the light bank; -1: emits nothing
    light_pdf: Tensor  # (T,) density over area with which next-event estimation picks a point; 0 if none


class MaterialTable(NamedTuple):
    """One row per material: the texture that each side reads."""

    front: Tensor  # (M,) int32 reflectance texture on the side of the normal
    back: Tensor  # (M,) int32, -1: black


class LightTable(NamedTuple):
    """What next-event estimation picks from: E elements (triangles of area lights, the surround, points)."""

    choice: AliasTable
    kind: Tensor  # (E,) int32: AREA, CONSTANT or POINT
    prim: Tensor  # (E,) int32 triangle of an area light, else 0
    radiance: Tensor  # (E,) int32 texture of the light bank
    position: Vec3  # (E,) of a point light, else 0
    surround: Tensor  # (1,) int32 texture of the constant emitter, 0 if there is none
    surround_pmf: Tensor  # (1,) probability of picking it


class SceneTensors(NamedTuple):
    """Everything the tracer reads. Attached to the parameters that made it."""

    triangles: TriangleTable
    materials: MaterialTable
    reflectance: TextureBank
    lights: LightTable
    radiance: TextureBank
    layout: Layout

    @property
    def device(self) -> torch.device:
        return self.triangles.material.device
