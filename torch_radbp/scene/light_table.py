"""The emitters of a scene as tables: the elements that next-event estimation picks from, and the tables of their kinds."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from torch_radbp.emitter.kind import EmittingTriangles, Light, LightKind, SurfaceKind
from torch_radbp.sampling.alias import alias_table
from torch_radbp.scene.interaction import edges
from torch_radbp.scene.scene import Scene
from torch_radbp.scene.tensors import LightTable, TriangleTable
from torch_radbp.vec import attached, cross, rows, unit_normal

SMALLEST_SHARE = 1e-12  # of a lamp's area: smaller triangles are never picked


def kinds_of(emitters: Sequence[Light]) -> tuple[LightKind, ...]:
    """The kinds of some emitters; the same kinds in the same order in every scene, so that it has the same functions."""
    return tuple(sorted({emitter.kind() for emitter in emitters}, key=repr))


def light_table(scene: Scene, kinds: tuple[LightKind, ...], triangles: TriangleTable, counts: list[int],
                texture_of: Callable[[Light], int], images: bool) -> LightTable:
    """The elements that next-event estimation picks from.

    Args:
        scene: gives shapes and emitters.
        kinds: of the emitters.
        triangles: of all shapes, attached; says which belong to an emitter.
        counts: the number of triangles of each shape.
        texture_of: the number in the light bank of an emitter's texture.
        images: True if some of these textures have coordinates.

    Raises:
        ValueError: if no emitter can be picked, or a surface cannot carry its emitter.
    """
    emitting = (triangles.emitter >= 0).nonzero().squeeze(1)
    surfaces, area = emitting_triangles(triangles, emitting, images)
    carriers = [(shape.emitter, count) for shape, count in zip(scene.shapes, counts) if shape.emitter is not None]
    lamps = [emitter for emitter in scene.emitters if not emitter.kind().on_surface]
    emitters = [emitter for emitter, _ in carriers] + lamps
    weights = weights_of(emitters, area, [count for _, count in carriers])
    integer = {"dtype": torch.int32, "device": area.device}
    repeats = torch.tensor([count for _, count in carriers] + [1] * len(lamps), device=area.device)

    def column(value: Callable[[Light], int]) -> Tensor:
        return torch.tensor([value(emitter) for emitter in emitters], **integer).repeat_interleave(repeats)

    kind, texture = column(lambda emitter: kinds.index(emitter.kind())), column(texture_of)
    picked = weights[:len(area)] > 0
    # A degenerate triangle is never picked, and must not make gradients infinite.
    surfaces = surfaces._replace(inverse_area=torch.where(picked, 1.0 / torch.where(picked, area, 1.0), 0.0))
    row, tables, choice = torch.zeros_like(kind), [], alias_table(weights)
    for number, each in enumerate(kinds):
        own = (kind == number).nonzero().squeeze(1)
        row[own] = torch.arange(len(own), **integer)
        tables.append(surface_table(each, surfaces, own) if each.on_surface else
                      each.table([emitter for emitter in lamps if emitter.kind() == each], area))
    surround = [index for index, emitter in enumerate(lamps) if emitter.kind().surround]
    surround_pmf = choice.pmf[len(area) + surround[0]] if surround else area.new_zeros(())
    return LightTable(choice, kind, row, texture, tuple(tables), surround_pmf)


def emitting_triangles(triangles: TriangleTable, emitting: Tensor, images: bool) -> tuple[EmittingTriangles, Tensor]:
    """Some triangles of a scene, `emitting` (S,), and their areas (S,); attached, but for the inverse areas."""
    corners = tuple(rows(triangles.vertices, corner[emitting]) for corner in triangles.corners)
    p = tuple(corner.p for corner in corners)
    _, e1, e2 = edges(*p)
    area = 0.5 * torch.linalg.vector_norm(cross(e1, e2).stack(), dim=-1)
    smooth = rows(triangles.smooth, emitting)
    shaded = corners[0].n is not None and (smooth is None or bool(smooth.any()))
    return EmittingTriangles(
        p, attached(rows(triangles.n, emitting), unit_normal(e1, e2)),
        shading=tuple(corner.n for corner in corners) if shaded else None, smooth=smooth if shaded else None,
        uv=tuple(corner.uv for corner in corners) if images else None, inverse_area=area), area


def surface_table(kind: SurfaceKind, surfaces: EmittingTriangles, own: Tensor) -> EmittingTriangles:
    """The rows `own` of the emitting triangles, which are of one kind."""
    table = surfaces if len(own) == len(surfaces.inverse_area) else part(surfaces, own)
    kind.check(table)
    return table


def part(record, index: Tensor):
    """The rows `index` of every tensor of a record, plain tuples included."""
    if isinstance(record, tuple):
        parts = [part(each, index) for each in record]
        return type(record)(*parts) if hasattr(record, "_fields") else tuple(parts)
    return rows(record, index)


def weights_of(emitters: list[Light], area: Tensor, counts: list[int]) -> Tensor:
    """The weights with which elements are picked, (E,): an emitter's weight, spread over its triangles by area.

    Args:
        emitters: those on surfaces first.
        area: (S,) of their triangles.
        counts: the number of triangles of each of them.

    Raises:
        ValueError: if a `sampling_weight` is negative or not finite, or all weights are 0.
    """
    for emitter in emitters:
        if not 0 <= emitter.sampling_weight < float("inf"):
            raise ValueError(f"sampling_weight of a {emitter.type} emitter must be at least 0 and finite, got "
                             f"{emitter.sampling_weight}")
    weights = []
    for emitter, own in zip(emitters, area.detach().split(counts)):
        share = own / own.sum()
        # Tiny triangles are never picked: the derivative of 1 / area might overflow.
        weights.append(torch.where(share > SMALLEST_SHARE, share, 0.0) * emitter.sampling_weight)
    weights.append(area.new_tensor([emitter.sampling_weight for emitter in emitters[len(counts):]]))
    weights = torch.cat(weights)
    if not bool(weights.any()):
        raise ValueError("next-event estimation has no emitter to pick: the sampling_weight of every emitter is 0, or the "
                         "area of its surface is; give at least one a weight greater than 0")
    return weights
