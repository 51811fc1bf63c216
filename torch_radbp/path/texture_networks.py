"""Evaluates network textures (modules) for the lanes of a bounce, all queues together.

All lanes of a bounce that read the same modules ask them together, whatever queues they are in: a module takes its time for
each call, not only for each place.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import torch
from torch import Tensor

from torch_radbp.interface.texture import Place, TextureValue
from torch_radbp.jit.recording.recording import outside
from torch_radbp.scene.tables.appearance import Appearance
from torch_radbp.scene.tables.scene_tensors import Layout, SceneTensors
from torch_radbp.tensors.partition import sorted_by_torch
from torch_radbp.tensors.vec import Vec2, Vec3
from torch_radbp.texture.module_bank import ModuleBank, Sorted

Asking = tuple[Appearance | None, tuple[Place, ...]]  # of some lanes, as for `texture_values_at`
Given = Sequence[Sequence[Tensor]]  # the rows and the coordinates of places, see `outside`


def texture_values_at(scene: SceneTensors, scatterer: Appearance | None,
                      places: tuple[Place, ...]) -> tuple[TextureValue, ...]:
    """The values of network textures at points; attached as autograd records it.

    Args:
        scene: the whole scene; attached or detached.
        scatterer: the appearance of the lanes' surface; None: it has no material.
        places: one for each of these textures, attached or detached.
    """
    return values_of_queues(scene, [(scatterer, places)])[0]


def values_of_queues(scene: SceneTensors, asking: Sequence[Asking]) -> list[tuple[TextureValue, ...]]:
    """The values of network textures for several queues at once; as `texture_values_at`.

    Args:
        scene: the whole scene; attached or detached.
        asking: for each queue its appearance and points, as for `texture_values_at`.
    """
    found = asked_outside(values_of, scene, asking, lambda place: 3)
    return [tuple(TextureValue(Vec3(*channels)) for channels in own) for own in found]


def values_of(banks: Sequence[int], scene: SceneTensors, given: Given) -> list[Sequence[Tensor]]:
    """Evaluates modules at points, channel by channel.

    Args:
        banks: for each of `given` the index of its table of modules; see `banks_asked`.
    """
    return of_banks(banks, scene, given, ModuleBank.values)


def asked_outside(work: Callable, scene: SceneTensors, asking: Sequence[Asking],
                  results: Callable[[Place], int]) -> list[list[Sequence[Tensor]]]:
    """Calls a function of modules once on the points of all queues, outside of compiled code.

    Args:
        work: a function of indices of tables, `scene`, and rows and coordinates of points.
        scene, asking: as for `values_of_queues`.
        results: the number of tensors that it returns for a point.
    """
    places = [place for _, own in asking for place in own]
    if not places:
        return [[] for _ in asking]
    banks = tuple(bank for scatterer, own in asking for bank, _ in zip(banks_asked(scene.layout, scatterer), own))
    found = iter(outside(partial(work, banks), scene, [(place.row, *place.at) for place in places],
                         [results(place) for place in places]))
    return [[next(found) for _ in own] for _, own in asking]


def of_banks(banks: Sequence[int], scene: SceneTensors, given: Given, find: Callable) -> list[Sequence[Tensor]]:
    """Calls `find` once for each table of modules, on all points that read it, and splits the results by point.

    Args:
        banks: as for `values_of`.
        find: a function of a table, rows, coordinates and sorted lanes; returns tensors, (N,) each.
    """
    answers: dict[int, Sequence[Tensor]] = {}
    asked = {bank: [number for number, other in enumerate(banks) if other == bank] for bank in dict.fromkeys(banks)}
    joined = {bank: [channels[0] if len(asking) == 1 else torch.cat(channels)
                     for channels in zip(*(given[number] for number in asking))] for bank, asking in asked.items()}
    for (bank, asking), lanes in zip(asked.items(), sorted_by_module(
            [module_banks(scene)[bank] for bank in joined], [row for row, *_ in joined.values()])):
        row, *at = joined[bank]
        found = find(module_banks(scene)[bank], row, coordinates(at), lanes)
        parts = [channel.split([len(given[number][0]) for number in asking]) for channel in found]
        answers.update(zip(asking, zip(*parts)))
    return [answers[number] for number in range(len(banks))]


def sorted_by_module(banks: Sequence[ModuleBank], rows: Sequence[Tensor]) -> list[Sorted]:
    """The lanes of several tables of modules, sorted by module, with a single wait for the device.

    Args:
        banks: the tables.
        rows: (N,) for each table, the module of each lane, as for `ModuleBank.sorted`.
    """
    orders, ends = zip(*(sorted_by_torch(row + 1, len(bank.functions) + 1) for bank, row in zip(banks, rows)))
    numbers = iter((ends[0] if len(ends) == 1 else torch.cat(ends)).tolist())
    return [bank.divided(row, order, [next(numbers) for _ in range(len(end))])
            for bank, row, order, end in zip(banks, rows, orders, ends)]


def coordinates(at: Sequence[Tensor]) -> Vec2 | Vec3:
    """Two or three coordinates, (N,) each, as a vector: the point at which a texture is looked up."""
    return Vec2(*at) if len(at) == 2 else Vec3(*at)


def number_outside(layout: Layout, scatterer: Appearance | None, nee: bool) -> int:
    """The number of network texture values that a lane reads at an event; see `VertexKind.places`."""
    if scatterer is None:
        return len(layout.lit)
    return len(scatterer.outside) + (2 if nee else 1) * len(layout.lit)


def banks_asked(layout: Layout, scatterer: Appearance | None) -> list[int]:
    """The indices of the tables of modules that an event reads, in the order of `VertexKind.places`."""
    readers = () if scatterer is None else scatterer.outside
    lit = range(len(layout.readers), len(layout.readers) + len(layout.lit))
    return [*map(layout.readers.index, readers), *lit, *lit]


def module_banks(scene: SceneTensors) -> tuple:
    """The tables of modules that serve as textures of materials and emitters, in one tuple.

    `scene` may be any record of a scene's structure.
    """
    return (*scene.textures, *scene.lit)
