"""`pack`: converts the modules of a `Scene` to `SceneTensors`, by ordinary differentiable torch.

The work is divided into parts, each of which says what it depends on: nothing is done again of which nothing has changed
since the last rendering (see `PackCache.part`).
"""

from __future__ import annotations

from collections.abc import Collection
from functools import partial
from typing import Any, NamedTuple

import torch

from torch_radbp.emitter.point import Point
from torch_radbp.interface.emitter import Light, stacked
from torch_radbp.interface.medium import Table
from torch_radbp.interface.texture import Reader, bank_of
from torch_radbp.plugin import BSDF, Medium, Texture
from torch_radbp.scene.cache.pack_cache import PackCache
from torch_radbp.scene.modules.parameters import check_extent, check_parameters, check_places, largest_vertex_coordinate
from torch_radbp.scene.modules.scene import Scene
from torch_radbp.scene.packing.attributes import any_attribute_differentiated, check_attributes
from torch_radbp.scene.packing.enclosed import enclosed_media
from torch_radbp.scene.packing.geometry import (
    Columns,
    PlacedShape,
    TriangleNumbering,
    placed_shapes_of,
    shown_instances,
    triangle_table,
)
from torch_radbp.scene.packing.light_table import Emission, kinds_of, light_table, takes_tree
from torch_radbp.scene.packing.material_tables import Materials, MaterialTextures, is_plain, material_tables
from torch_radbp.scene.packing.network_check import check_networks
from torch_radbp.scene.packing.radiances import Radiances, bank_of_radiances, radiances_of
from torch_radbp.scene.tables.scene_tensors import SAME, BoundaryTable, Layout, LightTable, SceneTensors, TriangleTable
from torch_radbp.shape.instance import Instance
from torch_radbp.shape.surface import Surface
from torch_radbp.tensors.asked_later import asked_later, presuming

# Parts that others ask for: the shapes as triangles, and the materials.
PLACED, MATERIALS = "placed", "materials"


class Objects(NamedTuple):
    """The objects of a scene by category."""

    scene: Scene
    bsdfs: tuple[BSDF, ...]
    shapes: tuple[Surface, ...]
    grouped: tuple[bool, ...]  # for each shape, whether instances show it
    groups: tuple[tuple[Instance, ...], ...]  # for each group its instances
    emitters: tuple[Light, ...]
    lamps: tuple[Light, ...]  # those that are on no surface
    media: tuple[Medium, ...]
    dtype: torch.dtype
    device: torch.device


def pack(scene: Scene, cache: PackCache | None = None, light_choice: str | None = None, aovs: bool = False,
         seen: Collection[str] | None = None) -> SceneTensors:
    """Packs a scene to tensors that are attached to its parameters.

    Args:
        scene: as it is now.
        cache: what is known from the last rendering.
        light_choice: how next-event estimation picks a light; see `Renderer`.
        aovs: include coordinates and numbers that only AOVs need.
        seen: the names of the sensors that are rendered, whose parameters are checked; None: all.

    Raises:
        ValueError: if a parameter is not in its domain, or derivatives of a module would be wrong; the message names it.
        TypeError: if the parameters are not of one dtype, or a module has been compiled.
    """
    cache = PackCache() if cache is None else cache
    check_parameters(scene, cache, scene.named_sensors if seen is None else seen)
    objects, inventory = cache.structure(objects_of, scene), cache.inventory(scene)
    dtype, device, settled = objects.dtype, objects.device, inventory.settled_reach
    of_shapes = inventory.reach((*objects.shapes, *(instance for instances in objects.groups for instance in instances)))
    materials = cache.part(MATERIALS, material_tables, scene, settled, scene, objects.bsdfs, dtype, device)
    radiances = cache.part("radiances", radiances_of, scene, settled, objects.emitters)
    placed = cache.part(PLACED, placed_shapes, scene, of_shapes, objects)
    layout = cache.part("layout", layout_of, scene, settled, objects, materials, radiances, placed)
    if layout.attributes:
        check_attributes(scene, cache)
    columns = cache.part("columns", _columns_of, scene, settled, objects, layout, aovs)
    triangles = cache.part("triangles", triangles_of, scene, of_shapes, objects, placed, columns)
    bank = cache.part("radiance", bank_of_radiances, scene, inventory.reach(radiances.banked), radiances, dtype, device)
    lit_banks = radiances.lit_banks(dtype, device)
    emissions = cache.part("emissions", emissions_of, scene, settled, objects, radiances, placed)
    bounding = (bank, lit_banks) if takes_tree(light_choice, emissions) else (None, ())  # what gives lights their bounds
    lights = cache.part("lights", _lights_of, scene, inventory.reach(objects.lamps), objects, triangles, emissions, layout,
                        light_choice, *bounding)
    textures = tuple(bank_of_textures(cache, number, group, objects) for number, group in enumerate(materials.textures))
    check_networks(cache, (*layout.readers, *layout.lit), (*textures, *lit_banks), dtype, device)
    media = cache.part("media", tables_of_media, scene, inventory.reach(objects.media), objects)
    boundaries = cache.part("boundaries", boundary_table, scene, settled, objects) if layout.traces_segments else None
    return SceneTensors(triangles, materials.table, textures, lights, bank, lit_banks, media, boundaries, layout)


def objects_of(scene: Scene) -> Objects:
    """Collects the objects of a scene by category."""
    emitters = tuple(scene.emitters) or (Point(intensity=0.0),)  # media alone emit; tables are not empty
    return Objects(scene, tuple(scene.bsdfs()), tuple(scene.shapes), tuple(each is not None for each in scene.shown_by),
                   tuple(map(tuple, scene.groups.values())), emitters,
                   tuple(emitter for emitter in emitters if not emitter.kind().on_surface), tuple(scene.media),
                   scene.dtype, scene.device)


def placed_shapes(cache: PackCache, objects: Objects) -> tuple[PlacedShape, ...]:
    """All shapes of the scene as triangles; raises ValueError if one is too large."""
    inventory = cache.inventory(objects.scene)
    placed = placed_shapes_of(cache, objects.shapes, objects.grouped, objects.dtype,
                              [inventory.reach((shape,)) for shape in objects.shapes])
    for shape, placed_shape in zip(objects.shapes, placed):
        vertices = placed_shape.vertices
        if presuming() and not vertices.is_cpu and not cache.knows(largest_vertex_coordinate, vertices):
            asked_later(vertices.abs().amax().reshape(1), partial(check_extent, objects.scene, [shape]))
        else:
            known = cache.numbers.get(id(vertices))
            check_extent(objects.scene, [shape], [cache(
                largest_vertex_coordinate, vertices, instead=partial(largest_vertex_coordinate, vertices, known))])
    return placed


def layout_of(cache: PackCache, objects: Objects, materials: Materials, radiances: Radiances,
              placed: tuple[PlacedShape, ...]) -> Layout:
    """The static layout of a scene: the features that it uses, for which code is compiled."""
    named = {name for reader in (*materials.readers, radiances.reader) for name in reader.attributes}
    attributes = tuple(sorted(named))
    attributes_move = any_attribute_differentiated(objects.scene, attributes)
    return Layout(
        bending=materials.bending or attributes_move,
        bends_ideally=materials.bends_ideally or (materials.ideal_by_attributes and attributes_move),
        shading_normals=any(shape.surface.normals is not None for shape in placed),
        back_sides=materials.back_sides, appearances=materials.appearances,
        readers=materials.readers, radiance=radiances.reader,
        radiance_bitmaps=radiances.has_bitmaps or any(reader.needs_uv for reader in radiances.lit), attributes=attributes,
        lights=kinds_of(objects.emitters), media=tuple(medium.kind() for medium in objects.media),
        **sides_of(cache, objects, materials, placed), lit=radiances.lit, still=materials.still)


def _columns_of(cache: PackCache, objects: Objects, layout: Layout, aovs: bool) -> Columns:
    """The optional columns of the scene's triangle table; `aovs` as for `pack`."""
    row = {id(bsdf): index for index, bsdf in enumerate(objects.bsdfs)}
    return Columns(layout.shading_normals,
                   layout.radiance_bitmaps or aovs or any(look.needs_uv for look in layout.appearances),
                   layout.vertex_attributes, layout.face_attributes, any(look.kind.oriented for look in layout.appearances),
                   tuple(row[id(shape.bsdf)] for shape in objects.shapes),
                   tuple(shape.emitter is not None for shape in objects.shapes), plain_shapes(objects),
                   _numbers_of(objects) if aovs else None,
                   boundaries_of(objects)[1] if layout.traces_segments else None)


def triangles_of(cache: PackCache, objects: Objects, placed: tuple[PlacedShape, ...], columns: Columns) -> TriangleTable:
    """Builds the triangle table, instances included; raises ValueError if an instance is too far away."""
    groups, dtype, device = objects.groups, objects.dtype, objects.device
    numbers = (0,) * sum(map(len, groups)) if columns.numbers is None else instance_numbers(objects)
    instances = shown_instances(cache, groups, placed, columns.normals, numbers, dtype, device)
    if instances is not None:
        check_places(objects.scene, groups, instances.casting.boxes)
    return triangle_table(cache, placed, columns, dtype, device, instances)


def emissions_of(cache: PackCache, objects: Objects, radiances: Radiances,
                 placed: tuple[PlacedShape, ...]) -> tuple[Emission, ...]:
    """For each emitter what next-event estimation needs to know about it, those on surfaces first."""
    def emission(emitter: Light, count: int | None) -> Emission:
        return Emission(emitter.kind(), emitter.type, emitter.sampling_weight, radiances.row[id(emitter)],
                        radiances.lit_rows[id(emitter)], count)

    carriers = [emission(shape.emitter, len(placed_shape.faces)) for shape, placed_shape in zip(objects.shapes, placed)
                if shape.emitter is not None]
    return (*carriers, *(emission(lamp, None) for lamp in objects.lamps))


def _lights_of(cache: PackCache, objects: Objects, triangles: TriangleTable, emissions: tuple[Emission, ...], layout: Layout,
               light_choice: str | None, bank: Any, lit_banks: tuple[Any, ...]) -> LightTable:
    """Builds the light table; `bank`, `lit_banks`: tables of emitters' textures, read if a tree selects lights."""
    lamps = tuple(cache.twin(number, lamp) for number, lamp in enumerate(objects.lamps))
    return light_table(cache, triangles, emissions, lamps, layout, bank, lit_banks, light_choice)


def tables_of_media(cache: PackCache, objects: Objects) -> tuple[Table, ...]:
    """The parameter tables of the media, attached."""
    like = torch.empty(0, dtype=objects.dtype, device=objects.device)
    return tuple(stacked([cache.twin(number, medium).row()], like) for number, medium in enumerate(objects.media))


def sides_of(cache: PackCache, objects: Objects, materials: Materials, placed: tuple[PlacedShape, ...]) -> dict[str, Any]:
    """The fields of `Layout` about boundaries between media, and about panes (surfaces that light passes straight).

    Surfaces with network textures or textures filtered by a sample's footprint do not count as panes.
    """
    around, straight = objects.scene.around, [look.kind.straight for look in materials.appearances]
    segments = bool(objects.media) and (any(straight) or any(shape.bounds_media for shape in objects.shapes) or any(
        medium.kind().heterogeneous or medium.kind().emission is not None for medium in objects.media))
    panes = tuple((number, materials.table.appearance.tolist().index(number), look)
                  for number, look in enumerate(materials.appearances) if segments and straight[number]
                  and not (look.kind.invisible or look.outside or look.needs_footprint))
    enclosed = enclosed_media(cache, objects.shapes, placed, objects.media, around) if segments else ()
    return {"around": None if around is None else objects.media.index(around), "traces_segments": segments, "panes": panes,
            "enclosed_media": enclosed}


def boundaries_of(objects: Objects) -> tuple[tuple[tuple[int, int, bool], ...], tuple[int, ...]]:
    """The kinds of boundaries: the media inside and outside, and whether rays pass straight; and the kind of each shape."""
    def side(shape: Surface, medium: Medium | None) -> int:
        if not shape.bounds_media:
            return SAME
        return -1 if medium is None else objects.media.index(medium)

    of_shapes = [(side(shape, shape.interior), side(shape, shape.exterior),
                  shape.bsdf.kind().invisible and shape.emitter is None) for shape in objects.shapes]
    rows = tuple(dict.fromkeys(of_shapes))
    return rows, tuple(map(rows.index, of_shapes))


def boundary_table(cache: PackCache, objects: Objects) -> BoundaryTable:
    """The table of the scene's kinds of boundaries between media."""
    columns = zip(*boundaries_of(objects)[0])
    return BoundaryTable(*(torch.tensor(column, dtype=dtype, device=objects.device)
                           for column, dtype in zip(columns, (torch.int32, torch.int32, torch.bool))))


def bank_of_textures(cache: PackCache, number: int, group: MaterialTextures, objects: Objects) -> Any:
    """The table of those material textures that one reader reads, attached; `number`: its index among these tables."""
    scene, dtype, device = objects.scene, objects.dtype, objects.device
    if group.reader.outside:  # a module that is read outside is taken as it is: only it knows what its values depend on
        return group.reader.bank(list(group.textures), dtype, device)
    twins = cache.part(("twins", number), twins_of, scene, group.settled, group.textures)
    return cache.part(("bank", number), bank_of_twins, scene, group.reach, group.reader, twins, dtype, device)


def twins_of(cache: PackCache, textures: tuple[Texture, ...]) -> tuple[Texture, ...]:
    """Copies of textures, the same objects in each rendering as long as their values are unchanged."""
    return tuple(cache.twin(number, texture) for number, texture in enumerate(textures))


def bank_of_twins(cache: PackCache, reader: Reader, twins: tuple[Texture, ...], dtype: torch.dtype,
                  device: torch.device) -> Any:
    """Builds the table of copied textures of one kind, attached."""
    return cache(bank_of, reader, twins, dtype, device)


def plain_shapes(objects: Objects) -> tuple[bool, ...]:
    """For each shape, whether its reflected light jumps at borders of shadows only, so that points may slide over it."""
    if any(emitter.picture_jumps() or emitter.picture_ends() for emitter in objects.emitters):
        return (False,) * len(objects.shapes)
    plain = {id(bsdf): is_plain(bsdf) for bsdf in objects.bsdfs}
    return tuple(shape.emitter is None and plain[id(shape.bsdf)] for shape in objects.shapes)


def _numbers_of(objects: Objects) -> tuple[TriangleNumbering, ...]:
    """How the triangles of each shape are numbered in AOVs."""
    number = numbers_in(objects.scene)
    return tuple(TriangleNumbering(not shape.whole, number.get(id(shape), 0)) for shape in objects.shapes)


def instance_numbers(objects: Objects) -> tuple[int, ...]:
    """The AOV number of each instance, group by group."""
    number = numbers_in(objects.scene)
    return tuple(number[id(instance)] for instances in objects.groups for instance in instances)


def numbers_in(scene: Scene) -> dict[int, int]:
    """The AOV numbers of shapes and instances by their ids: from 1 on, in the order of the scene."""
    places = [id(child) for child in scene.children() if isinstance(child, (Surface, Instance))]
    return {place: count for count, place in enumerate(places, 1)}
