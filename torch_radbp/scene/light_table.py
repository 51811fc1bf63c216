"""The emitters of a scene as tables: the elements for next-event estimation, poses, and the environment map."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.emitter.envmap import Envmap
from torch_radbp.emitter.illumination import linear_inverse
from torch_radbp.plugin import Emitter
from torch_radbp.sampling.alias import alias_table
from torch_radbp.sampling.grid import grid_distribution
from torch_radbp.scene.interaction import edges
from torch_radbp.scene.scene import Scene
from torch_radbp.scene.tensors import (
    AREA,
    CONSTANT,
    DIRECTIONAL,
    ENVIRONMENT,
    POINT,
    PROJECTOR,
    SPOT,
    EmittingTriangles,
    EnvironmentMap,
    LightTable,
    PosedLights,
    TriangleTable,
)
from torch_radbp.texture.bitmap import LUMINANCE
from torch_radbp.vec import Frame, Vec2, Vec3, attached, cross, rows, unit_normal

KINDS = {"constant": CONSTANT, "envmap": ENVIRONMENT, "point": POINT, "spot": SPOT, "projector": PROJECTOR,
         "directional": DIRECTIONAL}
FLAGS = {CONSTANT: "constant_light", ENVIRONMENT: "environment_map", POINT: "point_lights", SPOT: "spots",
         PROJECTOR: "projectors", DIRECTIONAL: "directional_lights"}
SMALLEST_SHARE = 1e-12  # of a lamp's area: smaller triangles are never picked


class Lamp(NamedTuple):
    """An emitter that belongs to no shape."""

    emitter: Emitter
    texture: int  # in the light bank

    @property
    def kind(self) -> int:
        return KINDS[self.emitter.type]


def kinds_of(lamps: list[Lamp]) -> dict[str, bool]:
    """The flags of `Layout` for lights that belong to no shape."""
    found = {lamp.kind for lamp in lamps}
    return {flag: kind in found for kind, flag in FLAGS.items()}


def light_table(scene: Scene, triangles: TriangleTable, radiance: Tensor, counts: list[int],
                lamps: list[Lamp]) -> LightTable:
    """The elements that next-event estimation picks from.

    Args:
        scene: gives shapes and emitters.
        triangles: of all shapes, attached.
        radiance: (T,) int32, the texture that each triangle emits; -1: none.
        counts: the number of triangles of each shape.
        lamps: the emitters that belong to no shape.
    """
    emitting = (radiance >= 0).nonzero().squeeze(1)
    corners = tuple(rows(triangles.vertices, corner[emitting]) for corner in triangles.corners)
    _, e1, e2 = edges(*(corner.p for corner in corners))
    area = 0.5 * torch.linalg.vector_norm(cross(e1, e2).stack(), dim=-1)
    total = sum(emitter.sampling_weight for emitter in scene.emitters)
    shapes = [(shape, count) for shape, count in zip(scene.shapes, counts) if shape.emitter is not None]
    weights = [area.new_zeros(0)]
    for (shape, _), own in zip(shapes, area.detach().split([count for _, count in shapes])):
        share = own / own.sum()
        # Tiny triangles are never picked: the derivative of 1 / area might overflow.
        weights.append(torch.where(share > SMALLEST_SHARE, share, 0.0) * shape.emitter.sampling_weight)
    pmf = torch.cat(weights) / (total or 1.0)
    # A degenerate triangle is never picked, and must not make gradients infinite.
    picked = pmf > 0
    surfaces = EmittingTriangles(
        corners, n=attached(rows(triangles.n, emitting), unit_normal(e1, e2)), smooth=rows(triangles.smooth, emitting),
        radiance=radiance[emitting], pmf=pmf,
        inverse_area=torch.where(picked, 1.0 / torch.where(picked, area, 1.0), 0.0))
    weights.append(area.new_tensor([lamp.emitter.sampling_weight for lamp in lamps]))
    posed = [lamp for lamp in lamps if lamp.kind >= POINT]
    surround = next((lamp for lamp in lamps if lamp.kind in (CONSTANT, ENVIRONMENT)), None)
    none = torch.zeros_like(surfaces.radiance)

    def elements(of_triangles: Tensor, of_lamps: list[int]) -> Tensor:
        return torch.cat([of_triangles, of_triangles.new_tensor(of_lamps)])

    environment = None
    if surround is not None and surround.kind == ENVIRONMENT:
        environment = environment_map(surround.emitter, area)
    return LightTable(
        choice=alias_table(torch.cat(weights)), surfaces=surfaces,
        kind=elements(none + AREA, [lamp.kind for lamp in lamps]),
        surface=elements(torch.arange(len(none), dtype=none.dtype, device=none.device), [0] * len(lamps)),
        pose=elements(none, [posed.index(lamp) if lamp.kind >= POINT else 0 for lamp in lamps]),
        radiance=elements(surfaces.radiance, [lamp.texture for lamp in lamps]),
        posed=posed_lights(posed, area) if posed else None,
        surround=none.new_tensor(0 if surround is None else surround.texture),
        surround_pmf=area.new_tensor(0.0 if surround is None else surround.emitter.sampling_weight / total),
        environment=environment)


def posed_lights(lamps: list[Lamp], like: Tensor) -> PosedLights:
    """The rows of the lights without extent, attached."""
    place, to_local, cone, to_uv = (torch.stack(column).to(like) for column in zip(*(lamp.emitter.pose() for lamp in lamps)))
    cutoff, sharpness = (column.contiguous() for column in cone.unbind(1))
    return PosedLights(Vec3.of(place), rows_of(to_local), cutoff, sharpness, Vec2.of(to_uv))


def rows_of(matrix: Tensor) -> Frame:
    """The rows of (P, 3, 3) matrices, so that `Frame.to_local` multiplies by them."""
    return Frame(*(Vec3.of(row) for row in matrix.unbind(1)))


def environment_map(emitter: Envmap, like: Tensor) -> EnvironmentMap:
    """The tables of an environment map: its pose, and the distribution of the cells between its texels.

    A cell is picked in proportion to its solid angle and to the mean luminance of its corners, which is that of the
    interpolated image; inside a cell, directions are uniform over solid angle. A black cell is never picked, since it sends
    no light; the derivatives of its texels come from BSDF sampling. Of a map that is black everywhere, all cells are picked
    uniformly over solid angle.

    Reference: Pharr, Jakob and Humphreys 2023, "Physically Based Rendering", section 12.5.
    """
    data = emitter.data.detach().to(like)
    rows, columns = data.shape[:2]
    half = torch.linspace(0, math.pi / 2, max(rows, 2), dtype=torch.float64, device=like.device)
    edges = torch.sin(half) ** 2
    solid_angle = ((4 * math.pi / columns) * edges.diff()[:, None]).to(like)
    texel = data.abs() @ like.new_tensor(LUMINANCE)
    luminance = texel.expand(max(rows, 2), columns)
    luminance = luminance[:-1] + luminance[1:]
    luminance = luminance + luminance.roll(-1, 1)
    if emitter.mis_compensation:
        average = (luminance * solid_angle).sum() / (4 * math.pi)
        average = average * (1 + 1e-6)  # a map of one value has nothing above it
        luminance, texel = (luminance - average).clamp_min(0.0), (texel - 0.25 * average).clamp_min(0.0)
    if not luminance.any():
        luminance, texel = torch.ones_like(luminance), torch.full_like(texel, 0.25)
    pick, pmf = grid_distribution(luminance * solid_angle)
    name = "to_world of the envmap"
    density = (pmf.reshape(-1, columns) / solid_angle).reshape(-1)
    picked = pmf.reshape(-1, columns) > 0
    picked = picked & picked.roll(1, 1)
    picked = torch.cat([picked[:1], picked[:-1] & picked[1:], picked[-1:]])[:rows]  # all cells around a texel
    weighing = torch.where(picked, 4 * texel / (luminance * solid_angle).sum(), 0.0)
    integer = {"dtype": torch.int32, "device": like.device}
    to_local = linear_inverse(name, emitter.to_world).to(like)
    return EnvironmentMap(
        to_local=rows_of(to_local[None]), volume=torch.linalg.det(to_local.detach()).abs(),
        to_world=Frame(*(Vec3(*row.unbind()) for row in emitter.to_world.detach()[:3, :3].to(like).unbind())),
        rows=torch.tensor(rows, **integer), columns=torch.tensor(columns, **integer), pick=pick,
        density=density.to(like), edges=edges.to(like),
        weighing=weighing.reshape(-1).to(like))
