"""The materials of a scene as tables: the appearance of each, and its textures."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.bsdf.contract import check_contract
from torch_radbp.bsdf.number import NumberOf
from torch_radbp.bsdf.twosided import TwoSided
from torch_radbp.interface.bsdf import Kind
from torch_radbp.interface.texture import Reader
from torch_radbp.plugin import BSDF, Texture
from torch_radbp.scene.cache.pack_cache import PackCache
from torch_radbp.scene.modules.scene import Scene
from torch_radbp.scene.packing.attributes import textures_of
from torch_radbp.scene.tables.appearance import Appearance
from torch_radbp.scene.tables.scene_tensors import MaterialTable
from torch_radbp.tensors.differentiated import differentiated
from torch_radbp.texture.bitmap import reader_of


class MaterialTextures(NamedTuple):
    """The material textures of a scene that are of one kind, read by one reader from one table."""

    reader: Reader
    textures: tuple[Texture, ...]  # in the order of its bank
    reach: frozenset[int]  # ids of the tensors that their values depend on, see `Inventory.reach`
    settled: frozenset[int]  # the same without tensors that are differentiated


class Materials(NamedTuple):
    """The material tables of a scene, with what they imply for its layout."""

    table: MaterialTable
    appearances: tuple[Appearance, ...]
    textures: tuple[MaterialTextures, ...]
    bending: bool  # differentiated parameters steer directions that hybrid sampling differentiates
    bends_ideally: bool  # so do those of ideal mirrors and glass
    ideal_by_attributes: bool  # mesh attributes steer such directions
    still: tuple[tuple[bool, ...], ...]  # see `Layout.still`
    back_sides: bool  # a material looks different from behind
    described: tuple[tuple[BSDF, Kind], ...]  # the materials, one for each side, and how they scatter

    @property
    def readers(self) -> tuple[Reader, ...]:
        return tuple(group.reader for group in self.textures)


def material_tables(cache: PackCache, scene: Scene, bsdfs: tuple[BSDF, ...], dtype: torch.dtype,
                    device: torch.device) -> Materials:
    """Builds the material tables of a scene."""
    two_sided = tuple(isinstance(bsdf, TwoSided) for bsdf in bsdfs)
    sides = one_sided(bsdfs)
    described = {id(bsdf): (bsdf.kind(), bsdf.textures()) for bsdf in sides}
    for bsdf in {id(bsdf): bsdf for bsdf in sides}.values():
        check_contract(bsdf, *described[id(bsdf)], dtype, device)
    kinds, textures = zip(*(described[id(bsdf)] for bsdf in sides)) if sides else ((), ())
    looks = [Appearance(kind, tuple(map(reader_of, each))) for kind, each in zip(kinds, textures)]
    appearances = tuple(dict.fromkeys(looks))
    readers = tuple(dict.fromkeys(reader for look in appearances for reader in look.readers))
    of_reader: dict[Reader, dict[int, Texture]] = {reader: {} for reader in readers}
    for look, textures_of_look in zip(looks, textures):
        for reader, texture in zip(look.readers, textures_of_look):
            of_reader[reader].setdefault(id(texture), texture)
    row = {reader: {key: number for number, key in enumerate(by_id)} for reader, by_id in of_reader.items()}
    slots = [[row[reader][id(texture)] for reader, texture in zip(look.readers, each)]
             for look, each in zip(looks, textures)]
    columns = [[appearances.index(look) for look in looks],
               *([each[k] if k < len(each) else 0 for each in slots] for k in range(max(map(len, slots), default=0)))]
    differs = tuple(front != back for front, back in zip(looks, looks[len(bsdfs):]))
    appearance, *values = (cache(_column, tuple(each), torch.int32, device) for each in columns)
    table = MaterialTable(appearance, tuple(values), cache(_column, (False,) * len(bsdfs) + two_sided, torch.bool, device),
                          cache(_column, differs, torch.bool, device) if any(differs) else None,
                          cache(_column, len(bsdfs), torch.int32, device))
    inventory = cache.inventory(scene)
    by_reader = {reader: tuple(by_id.values()) for reader, by_id in of_reader.items()}
    read = tuple(MaterialTextures(reader, textures, inventory.reach(textures),
                                  inventory.reach(textures) & inventory.settled_reach)
                 for reader, textures in by_reader.items())
    bending, ideally = (any(differentiated(source) for kind, each in zip(kinds, textures) if kind.delta or not ideal
                            for slot in kind.bending for source in each[slot].sources()) for ideal in (False, True))
    by_attributes = any(look.readers[slot].attributes for look in appearances if look.kind.delta
                        for slot in look.kind.bending)
    moves = [[is_differentiated(texture) for texture in each] for each in textures]
    still = tuple(tuple(not any(column) for column in zip(*(each for each, look in zip(moves, looks) if look == appearance)))
                  for appearance in appearances)
    return Materials(table, appearances, read, bending, ideally, by_attributes, still, any(two_sided),
                     tuple((bsdf, described[id(bsdf)][0]) for bsdf in {id(bsdf): bsdf for bsdf in sides}.values()))


def is_differentiated(texture: Texture) -> bool:
    """True if a texture's values depend on a differentiated parameter, one that moves them over the surface included."""
    if any(map(differentiated, texture.sources())):
        return True
    texture = texture.texture if isinstance(texture, NumberOf) else texture
    to_uv = getattr(texture, "to_uv", None)
    return (to_uv is not None and differentiated(to_uv)) or any(map(is_differentiated, texture.parts()))


def _column(values: tuple[int | bool, ...] | int, kind: torch.dtype, device: torch.device) -> Tensor:
    """A column of a table, or a 0-d tensor if `values` is one number."""
    return torch.tensor(values, dtype=kind, device=device)


def one_sided(bsdfs: Iterable[BSDF]) -> list[BSDF]:
    """All materials as seen from the front (the normal's side), followed by all as seen from the back."""
    sides = [bsdf.sides() if isinstance(bsdf, TwoSided) else (bsdf, bsdf) for bsdf in bsdfs]
    return [front for front, _ in sides] + [back for _, back in sides]


def is_plain(bsdf: BSDF) -> bool:
    """True if a material has no delta lobes and its textures, if any, have no discontinuities."""
    kinds = [side.kind() for side in one_sided([bsdf])]
    return all(kind.smooth and not (kind.delta or kind.follows or kind.straight or kind.turns_normals)
               for kind in kinds) and not any(texture.jumps() for _, texture in textures_of(bsdf))
