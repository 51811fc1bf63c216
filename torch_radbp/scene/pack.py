"""`pack`: from the modules of a `Scene` to `SceneTensors`, by ordinary differentiable torch."""

from __future__ import annotations

from collections.abc import Collection, Hashable, Iterable
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torch_radbp.bsdf.twosided import TwoSided
from torch_radbp.emitter.kind import Light
from torch_radbp.plugin import BSDF, Texture
from torch_radbp.scene.appearance import Appearance
from torch_radbp.scene.attributes import any_differentiated, check_attributes, textures_of
from torch_radbp.scene.geometry import Columns, Numbers, placed_shape, shown_instances, triangle_table
from torch_radbp.scene.light_table import Emission, kinds_of, light_table
from torch_radbp.scene.network_check import check_networks
from torch_radbp.scene.pack_cache import PackCache
from torch_radbp.scene.parameters import check_extent, check_parameters, check_places, largest_coordinate
from torch_radbp.scene.scene import Scene
from torch_radbp.scene.tensors import Layout, MaterialTable, SceneTensors
from torch_radbp.shape.instance import Instance
from torch_radbp.shape.surface import Surface
from torch_radbp.tensors.differentiated import differentiated
from torch_radbp.texture.bitmap import BitmapReader, reader_of
from torch_radbp.texture.colour import ColourReader
from torch_radbp.texture.mixed import MixedReader, reader_for
from torch_radbp.texture.reader import OutsideReader, Reader, TableReader
from torch_radbp.texture.rgb import RGB


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
    def reader(self) -> TableReader:
        """How lanes read all of them: colours among images are images of one texel."""
        reader = reader_for(self.textures or [RGB(value=0.0)])
        kinds = reader.readers if isinstance(reader, MixedReader) else (reader,)
        return BitmapReader() if all(isinstance(kind, (BitmapReader, ColourReader)) for kind in kinds) else reader

    @property
    def has_bitmaps(self) -> bool:
        return any(reader_of(texture).needs_uv for texture in self.textures)


def pack(scene: Scene, cache: PackCache | None = None, light_choice: str | None = None, aovs: bool = False,
         seen: Collection[str] | None = None) -> SceneTensors:
    """The tensors of a scene, attached to its parameters.

    Args:
        scene: as it is now.
        cache: what is known from the last rendering.
        light_choice: how next-event estimation picks a light; see `Renderer`.
        aovs: with coordinates and numbers, which quantities may be about that no image needs.
        seen: the names of the sensors that are rendered, whose parameters are checked; None: all.

    Raises:
        ValueError: if a parameter is not in its domain, or derivatives of a module would be wrong; the message names it.
        TypeError: if the parameters are not of one dtype, or a module has been compiled.
    """
    cache = PackCache() if cache is None else cache
    check_parameters(scene, cache, scene.named_sensors if seen is None else seen)
    dtype, device = scene.dtype, scene.device
    radiance = BankBuilder()
    bsdfs, shapes, emitters = list(scene.bsdfs()), scene.shapes, scene.emitters  # once: a scene may have many objects
    materials = material_tables(cache, bsdfs, dtype, device)
    appearances, readers = materials.appearances, materials.readers
    groups = list(scene.groups.values())
    placed = [placed_shape(cache, shape, instances is not None, dtype) for shape, instances in zip(shapes, scene.shown_by)]
    check_extent(scene, shapes, [cache(largest_coordinate, shape.vertices) for shape in placed])
    radiated = {id(emitter): emitter.radiated() for emitter in emitters}
    outside = {name: texture for name, texture in radiated.items() if texture is not None and reader_of(texture).outside}
    textures = {name: 0 if texture is None or name in outside else radiance.add(texture)
                for name, texture in radiated.items()}
    lit, lit_banks, lit_rows = lit_outside(outside, dtype, device)
    named = {name for reader in (*readers, radiance.reader) for name in reader.attributes}
    attributes = tuple(sorted(named))
    if attributes:
        check_attributes(scene, cache)
    attributes_move = any_differentiated(scene, attributes)
    layout = Layout(
        bending=materials.bending or attributes_move,
        bends_ideally=materials.bends_ideally or (materials.ideal_by_attributes and attributes_move),
        shading_normals=any(shape.surface.normals is not None for shape in placed),
        back_sides=materials.back_sides, appearances=appearances,
        readers=readers, radiance=radiance.reader,
        radiance_bitmaps=radiance.has_bitmaps or any(reader.needs_uv for reader in lit), attributes=attributes,
        lights=kinds_of(emitters), lit=lit)
    row = {id(bsdf): index for index, bsdf in enumerate(bsdfs)}
    columns = Columns(layout.shading_normals, layout.radiance_bitmaps or aovs or any(look.needs_uv for look in appearances),
                      layout.vertex_attributes, layout.face_attributes, any(look.kind.oriented for look in appearances),
                      tuple(row[id(shape.bsdf)] for shape in shapes),
                      tuple(shape.emitter is not None for shape in shapes), plain_shapes(cache, shapes, emitters),
                      numbers_of(scene, shapes) if aovs else None)
    instances = shown_instances(cache, groups, placed, layout.shading_normals,
                                instance_numbers(scene, groups) if aovs else (0,) * sum(map(len, groups)), dtype, device)
    if instances is not None:
        check_places(scene, groups, instances.casting.boxes)
    triangles = triangle_table(cache, placed, columns, dtype, device, instances)

    def emission(emitter: Light, count: int | None) -> Emission:
        return Emission(emitter.kind(), emitter.type, emitter.sampling_weight, textures[id(emitter)],
                        lit_rows.get(id(emitter), (-1,) * len(lit)), count)

    carriers = [emission(shape.emitter, len(own.faces)) for shape, own in zip(shapes, placed)
                if shape.emitter is not None]
    lamps = [emitter for emitter in emitters if not emitter.kind().on_surface]
    bank = cache(bank_of, layout.radiance, twins(cache, "radiance", radiance.textures or [RGB(value=0.0)]), dtype, device)
    lights = light_table(cache, triangles, (*carriers, *(emission(lamp, None) for lamp in lamps)),
                         tuple(cache.twin(id(lamp), lamp) for lamp in lamps), layout, bank, lit_banks, light_choice)
    check_networks(cache, (*readers, *lit), (*materials.textures, *lit_banks), dtype, device)
    return SceneTensors(triangles, materials.table, materials.textures, lights, bank, lit_banks, layout)


def lit_outside(textures: dict[int, Texture], dtype: torch.dtype, device: torch.device
                ) -> tuple[tuple[OutsideReader, ...], tuple[Any, ...], dict[int, tuple[int, ...]]]:
    """`Layout.lit`, its banks, and `Emission.outside` of those emitters that have such a texture.

    Args:
        textures: of these emitters, by the ids of the emitters.
        dtype, device: of the scene.
    """
    readers = tuple(dict.fromkeys(map(reader_of, textures.values())))
    own = {reader: list(dict.fromkeys(texture for texture in textures.values() if reader_of(texture) == reader))
           for reader in readers}
    rows = {name: tuple(own[reader].index(texture) if texture in own[reader] else -1 for reader in readers)
            for name, texture in textures.items()}
    return readers, tuple(reader.bank(own[reader], dtype, device) for reader in readers), rows


def plain_shapes(cache: PackCache, shapes: list[Surface], emitters: list[Light]) -> tuple[bool, ...]:
    """For each shape, whether the light that it sends back jumps at borders of shadows alone; see `scene.nearby`."""
    if any(emitter.picture_jumps() or emitter.picture_ends() for emitter in emitters):
        return (False,) * len(shapes)
    known = {id(bsdf): is_plain(bsdf) for bsdf in {id(shape.bsdf): shape.bsdf for shape in shapes}.values()}
    return tuple(shape.emitter is None and known[id(shape.bsdf)] for shape in shapes)


def is_plain(bsdf: BSDF) -> bool:
    """True if a material scatters light smoothly, and equally in all of its places or by textures that do not jump."""
    kinds = [side.kind() for side in one_sided([bsdf])]
    return all(kind.smooth and not (kind.delta or kind.follows or kind.straight or kind.turns_normals)
               for kind in kinds) and not any(texture.jumps() for _, texture in textures_of(bsdf))


def numbers_of(scene: Scene, shapes: list[Surface]) -> tuple[Numbers, ...]:
    """How the triangles of each shape of a scene are counted."""
    number = numbers_in(scene)
    return tuple(Numbers(not shape.whole, number.get(id(shape), 0)) for shape in shapes)


def instance_numbers(scene: Scene, groups: list[list[Instance]]) -> tuple[int, ...]:
    """The number of each instance of a scene, group by group."""
    number = numbers_in(scene)
    return tuple(number[id(instance)] for instances in groups for instance in instances)


def numbers_in(scene: Scene) -> dict[int, int]:
    """The numbers of shapes and instances by their ids: from 1 on, in the order of the scene."""
    places = [id(child) for child in scene.children() if isinstance(child, (Surface, Instance))]
    return {place: count for count, place in enumerate(places, 1)}


def twins(cache: PackCache, place: Hashable, textures: Iterable[Texture]) -> tuple[Texture, ...]:
    """The twins of some textures; see `PackCache.twin`."""
    return tuple(cache.twin((place, number), texture) for number, texture in enumerate(textures))


def bank_of(reader: Reader, textures: tuple[Texture, ...], dtype: torch.dtype, device: torch.device) -> Any:
    """The bank of the textures of one reader, attached."""
    return reader.bank(textures, dtype, device)


class Materials(NamedTuple):
    """The materials of a scene as tables."""

    table: MaterialTable
    appearances: tuple[Appearance, ...]
    readers: tuple[Reader, ...]
    textures: tuple[Any, ...]  # the banks of the readers
    bending: bool  # parameters with derivatives steer directions that hybrid sampling follows
    bends_ideally: bool  # by ideal mirrors and glass
    ideal_by_attributes: bool  # attributes of meshes steer such directions
    back_sides: bool  # whether a material looks the same from behind as from the front, seen from there


def material_tables(cache: PackCache, bsdfs: list[BSDF], dtype: torch.dtype, device: torch.device) -> Materials:
    """The rows of all materials, their appearances, and their textures."""
    two_sided = tuple(isinstance(bsdf, TwoSided) for bsdf in bsdfs)
    sides = one_sided(bsdfs)
    described = {id(bsdf): (bsdf.kind(), bsdf.textures()) for bsdf in sides}
    kinds, textures = zip(*(described[id(bsdf)] for bsdf in sides)) if sides else ((), ())
    looks = [Appearance(kind, tuple(map(reader_of, own))) for kind, own in zip(kinds, textures)]
    appearances = tuple(dict.fromkeys(looks))
    readers = tuple(dict.fromkeys(reader for look in appearances for reader in look.readers))
    of_reader: dict[Reader, dict[int, Texture]] = {reader: {} for reader in readers}
    for look, own in zip(looks, textures):
        for reader, texture in zip(look.readers, own):
            of_reader[reader].setdefault(id(texture), texture)
    row = {reader: {key: number for number, key in enumerate(found)} for reader, found in of_reader.items()}
    slots = [[row[reader][id(texture)] for reader, texture in zip(look.readers, own)] for look, own in zip(looks, textures)]
    columns = [[appearances.index(look) for look in looks],
               *([own[k] if k < len(own) else 0 for own in slots] for k in range(max(map(len, slots), default=0)))]
    differs = tuple(front != back for front, back in zip(looks, looks[len(bsdfs):]))
    appearance, *values = (cache(column, tuple(each), torch.int32, device) for each in columns)
    table = MaterialTable(appearance, tuple(values), cache(column, (False,) * len(bsdfs) + two_sided, torch.bool, device),
                          cache(column, differs, torch.bool, device) if any(differs) else None,
                          cache(column, len(bsdfs), torch.int32, device))
    # A module that is read outside is taken as it is: only it knows what its values depend on.
    banks = tuple(reader.bank(list(of_reader[reader].values()), dtype, device) if reader.outside else
                  cache(bank_of, reader, twins(cache, reader, of_reader[reader].values()), dtype, device)
                  for reader in readers)
    bending, ideally = (any(differentiated(source) for kind, own in zip(kinds, textures) if kind.delta or not ideal
                            for slot in kind.bending for source in own[slot].sources()) for ideal in (False, True))
    by_attributes = any(look.readers[slot].attributes for look in appearances if look.kind.delta
                        for slot in look.kind.bending)
    return Materials(table, appearances, readers, banks, bending, ideally, by_attributes, any(two_sided))


def column(values: tuple[int | bool, ...] | int, kind: torch.dtype, device: torch.device) -> Tensor:
    """A column of a table, or a number."""
    return torch.tensor(values, dtype=kind, device=device)


def one_sided(bsdfs: Iterable[BSDF]) -> list[BSDF]:
    """All materials as seen from the side of the normal, then all from behind."""
    sides = [bsdf.sides() if isinstance(bsdf, TwoSided) else (bsdf, bsdf) for bsdf in bsdfs]
    return [front for front, _ in sides] + [back for _, back in sides]
