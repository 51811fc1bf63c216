"""The emitters of a scene as tables: the elements for light selection, and one table for each kind of light."""

from __future__ import annotations

import itertools
import operator
from collections.abc import Hashable, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torch_radbp.interface.emitter import EmittingTriangles, Light, LightKind, SurfaceKind, Table
from torch_radbp.interface.emitter_bounds import LightBounds
from torch_radbp.sampling.alias import alias_table
from torch_radbp.scene.cache.pack_cache import PackCache
from torch_radbp.scene.tables.light_choice import MANY, EmitterTextures, TreeChoice, bounds_of_kind, tree_choice
from torch_radbp.scene.tables.scene_tensors import Layout, LightTable, TriangleTable
from torch_radbp.scene.tables.triangle_corners import edges
from torch_radbp.tensors.differentiated import linear
from torch_radbp.tensors.vec import attached, cross, rows, unit_normal

SMALLEST_SHARE = 1e-12  # of a lamp's area: smaller triangles are never picked


def kinds_of(emitters: Sequence[Light]) -> tuple[LightKind, ...]:
    """The distinct kinds of some emitters, in one fixed order, so that scenes with the same kinds share compiled code."""
    return tuple(sorted({emitter.kind() for emitter in emitters}, key=repr))


class Emission(NamedTuple):
    """What next-event estimation needs to know about an emitter."""

    kind: LightKind
    type: str
    sampling_weight: float
    texture: int  # in the light bank
    outside: tuple[int, ...]  # for each of `Layout.lit`, in its bank; -1: another reads it
    triangles: int | None  # number of its triangles; None: it is not a surface


def light_table(cache: PackCache, triangles: TriangleTable, emissions: tuple[Emission, ...], lamps: tuple[Light, ...],
                layout: Layout, radiance: Any, lit: tuple[Any, ...], light_choice: str | None) -> LightTable:
    """Builds the table of light elements, from which next-event estimation selects, and the distribution of these.

    Args:
        cache: what is known from the last rendering.
        triangles: of all shapes, attached; says which belong to an emitter.
        emissions: of all emitters, those on surfaces first.
        lamps: copies of the emitters that are not on surfaces.
        layout: gives the kinds of emitters.
        radiance: the bank of the emitters' textures.
        lit: the banks of their network textures.
        light_choice: one of `CHOICES`; None: what suits the number of emitters.

    Raises:
        ValueError: if no emitter can be picked, or a surface cannot carry its emitter.
    """
    surfaces, area = cache(emitting_triangles, triangles, layout, *cache(emitting_rows, triangles.emitter, triangles.smooth))
    weights = cache(weights_of, emissions, cache.frozen("areas of emitters", area))
    surfaces = cache(with_inverse_areas, surfaces, area, weights)
    kind, row, texture, outside = cache(element_columns, layout.lights, emissions, area.device)
    tables = tuple(cache(surface_table, each, surfaces, cache(rows_of_kind, kind, number)) if each.on_surface else
                   cache(lamp_table, each, tuple(lamp for lamp in lamps if lamp.kind() == each), weights)
                   for number, each in enumerate(layout.lights))
    if takes_tree(light_choice, emissions):
        textures = EmitterTextures(layout.radiance, radiance, layout.lit, lit)
        bounds = cache(bounds_of_lights, layout.lights, textures, tables, kind, texture, outside)
        bounds = tuple(each and LightBounds(*frozen(cache, ("bounds of lights", number), each))
                       for number, each in enumerate(bounds))
        choice = cache(choice_by_tree, bounds, emissions, kind, weights)
        return LightTable(choice, kind, row, texture, tables, cache(pmf_of_surround_beside, emissions, choice), outside)
    choice = cache(alias_table, weights)
    return LightTable(choice, kind, row, texture, tables, cache(pmf_of_surround, emissions, choice.pmf), outside)


def takes_tree(light_choice: str | None, emissions: tuple[Emission, ...]) -> bool:
    """True if next-event estimation selects lights by a tree; never if no emitter would be in the tree."""
    bounded = sum(emission.kind.bounded for emission in emissions)
    return bounded > 0 and (light_choice == "tree" or (light_choice is None and bounded >= MANY))


def frozen(cache: PackCache, place: Hashable, record: tuple) -> tuple:
    """A record whose tensors are replaced by detached copies, the same objects in each rendering while values last."""
    return tuple(type(part)(*frozen(cache, (place, number), part)) if isinstance(part, tuple) else
                 cache.frozen((place, number), part) for number, part in enumerate(record))


def bounds_of_lights(kinds: tuple[LightKind, ...], textures: EmitterTextures, tables: tuple[Table, ...], kind: Tensor,
                     texture: Tensor, outside: tuple[Tensor, ...]) -> tuple[LightBounds | None, ...]:
    """The bounds of all light elements, kind by kind, detached; None for kinds that have none."""
    return tuple(bounds_of_kind(each, tables[number], textures, texture[kind == number],
                                tuple(rows[kind == number] for rows in outside)) if each.bounded else None
                 for number, each in enumerate(kinds))


def choice_by_tree(bounds: tuple[LightBounds | None, ...], emissions: tuple[Emission, ...], kind: Tensor,
                   weights: Tensor) -> TreeChoice:
    """Builds the distribution of light elements by a tree over the emitters that have bounds.

    Args:
        bounds: for each kind of light those of its elements.
        emissions: of all emitters.
        kind: (E,) the kind of each element.
        weights: (E,) from `weights_of`.
    """
    repeats = torch.tensor([elements(emission) for emission in emissions], device=kind.device)
    sampling_weight = torch.tensor([emission.sampling_weight for emission in emissions], dtype=torch.float64,
                                   device=kind.device)
    return tree_choice(bounds, repeats, sampling_weight, weights, [(kind == number).nonzero().squeeze(1)
                                                                   for number in range(len(bounds))])


def pmf_of_surround_beside(emissions: tuple[Emission, ...], choice: TreeChoice) -> Tensor:
    """The probability of selecting the environment, which stands beside the light tree, (); 0 if there is none."""
    surround = [number for number, emission in enumerate(emissions) if emission.kind.surround]
    if not surround or choice.beside is None:
        return choice.pmf.new_zeros(())
    is_surround = (choice.beside.emitter == surround[0]).to(choice.pmf)
    return (is_surround * choice.beside.pmf).sum() * choice.beside.share.to(choice.pmf)


def element_columns(kinds: tuple[LightKind, ...], emissions: tuple[Emission, ...],
                    device: torch.device) -> tuple[Tensor, Tensor, Tensor, tuple[Tensor, ...]]:
    """For each light element its kind, its row in that kind's table, its texture, and its row in each table of network
    textures; (E,) int32 each."""
    integer = {"dtype": torch.int32, "device": device}
    repeats = torch.tensor([elements(emission) for emission in emissions], device=device)
    kind, texture, *outside = (torch.tensor(values, **integer).repeat_interleave(repeats) for values in (
        [kinds.index(emission.kind) for emission in emissions], [emission.texture for emission in emissions],
        *zip(*(emission.outside for emission in emissions))))
    row = torch.zeros_like(kind)
    for number in range(len(kinds)):
        elements_of_kind = (kind == number).nonzero().squeeze(1)
        row[elements_of_kind] = torch.arange(len(elements_of_kind), **integer)
    return kind, row, texture, tuple(outside)


def elements(emission: Emission) -> int:
    """The number of light elements of an emitter: its triangles, or one."""
    return 1 if emission.triangles is None else emission.triangles


def pmf_of_surround(emissions: tuple[Emission, ...], pmf: Tensor) -> Tensor:
    """The probability of selecting the environment, (); 0 if there is none."""
    firsts = itertools.accumulate(map(elements, emissions), initial=0)
    surround = [first for first, emission in zip(firsts, emissions) if emission.kind.surround]
    return pmf[surround[0]] if surround else pmf.new_zeros(())


def emitting_rows(emitter: Tensor, smooth: Tensor | None) -> tuple[Tensor, bool]:
    """The triangles that emit light, (S,) int64, and whether any of them is smooth; args: columns of `TriangleTable`."""
    emitting = (emitter >= 0).nonzero().squeeze(1)
    return emitting, smooth is None or bool(smooth.index_select(0, emitting).any())


def emitting_triangles(triangles: TriangleTable, layout: Layout, emitting: Tensor,
                       any_smooth: bool) -> tuple[EmittingTriangles, Tensor]:
    """The triangles that emit light, with unset inverse areas, and their areas (S,); attached.

    Args:
        triangles: of the scene, attached.
        layout: says what the textures of emitters read.
        emitting, any_smooth: of `emitting_rows`.
    """
    corners = tuple(rows(triangles.vertices, corner[emitting]) for corner in triangles.corners)
    p = tuple(corner.p for corner in corners)
    _, e1, e2 = edges(*p)
    area = linear(operator.mul, torch.linalg.vector_norm(cross(e1, e2).stack(), dim=-1), 0.5)
    smooth = rows(triangles.smooth, emitting)
    shaded = corners[0].n is not None and any_smooth
    columns = dict(zip(layout.vertex_attributes, zip(*(corner.attributes for corner in corners))))
    columns |= {name: (rows(column, emitting),) * 3 for name, column in zip(layout.face_attributes, triangles.attributes)}
    return EmittingTriangles(
        p, attached(rows(triangles.n, emitting), unit_normal(e1, e2)),
        shading=tuple(corner.n for corner in corners) if shaded else None, smooth=smooth if shaded else None,
        uv=tuple(corner.uv for corner in corners) if layout.radiance_bitmaps else None,
        attributes=tuple(columns[name] for name in layout.radiance.attributes), inverse_area=area), area


def with_inverse_areas(surfaces: EmittingTriangles, area: Tensor, weights: Tensor) -> EmittingTriangles:
    """The emitting triangles with inverse areas set, attached, where selection weights (E,) are positive."""
    # A degenerate triangle is never picked, and must not make gradients infinite.
    picked = weights[:len(area)] > 0
    return surfaces._replace(inverse_area=torch.where(picked, torch.where(picked, area, 1.0).reciprocal(), 0.0))


def lamp_table(kind: LightKind, lamps: tuple[Light, ...], like: Tensor) -> Table:
    """The rows of one kind of light (point, spot, ...) as a table, attached."""
    return kind.table(lamps, like)


def rows_of_kind(kinds: Tensor, number: int) -> Tensor:
    """The elements of light kind `number`, int64; `kinds`: (E,) the kind of each element."""
    return (kinds == number).nonzero().squeeze(1)


def surface_table(kind: SurfaceKind, surfaces: EmittingTriangles, elements: Tensor) -> EmittingTriangles:
    """The emitting triangles of one kind of light, selected from all by `elements`."""
    table = surfaces if len(elements) == len(surfaces.inverse_area) else part(surfaces, elements)
    kind.check(table)
    return table


def part(record, index: Tensor):
    """A record with every tensor (also in tuples in it) indexed by `index`."""
    if isinstance(record, tuple):
        parts = [part(each, index) for each in record]
        return type(record)(*parts) if hasattr(record, "_fields") else tuple(parts)
    return rows(record, index)


def weights_of(emissions: tuple[Emission, ...], area: Tensor) -> Tensor:
    """The unnormalised selection weights of elements, (E,): an emitter's weight, spread over its triangles by area.

    Args:
        emissions: of all emitters, those on surfaces first.
        area: (S,) of their triangles, detached.

    Raises:
        ValueError: if a `sampling_weight` is negative or not finite, or all weights are 0.
    """
    for emission in emissions:
        if not 0 <= emission.sampling_weight < float("inf"):
            raise ValueError(f"sampling_weight of a {emission.type} emitter must be at least 0 and finite, got "
                             f"{emission.sampling_weight}")
    counts = [emission.triangles for emission in emissions if emission.triangles is not None]
    weights = []
    for emission, areas in zip(emissions, area.split(counts)):
        share = areas / areas.sum()
        # Tiny triangles are never picked: the derivative of 1 / area might overflow.
        weights.append(torch.where(share > SMALLEST_SHARE, share, 0.0) * emission.sampling_weight)
    weights.append(area.new_tensor([emission.sampling_weight for emission in emissions[len(counts):]]))
    weights = torch.cat(weights)
    if not bool(weights.any()):
        raise ValueError("next-event estimation has no emitter to pick: the sampling_weight of every emitter is 0, or the "
                         "area of its surface is; give at least one a weight greater than 0")
    return weights
