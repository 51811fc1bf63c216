"""Derivatives of network textures (modules), whose values are computed before compiled code runs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.adjoint.scatter import Gradients
from torch_radbp.interface.texture import Place, TextureValue
from torch_radbp.jit.recording.lane_count import LaneCount
from torch_radbp.path.texture_networks import Asking, Given, asked_outside, banks_asked, coordinates, module_banks, of_banks
from torch_radbp.scene.tables.appearance import Appearance
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.tensors.vec import Vec2, Vec3
from torch_radbp.texture.module_bank import ModuleBank, Sorted

HELD = 1 << 17  # lanes that have reached a bounce, whose adjoints are held back at the most, but for one bounce


class ModuleAdjoint(NamedTuple):
    """The adjoints of texture values that modules (neural networks) have computed at N points."""

    bank: int  # see `banks_asked`
    row: Tensor  # (N,) int32, index of the module in the bank; -1: none
    at: Vec2 | Vec3  # (N,) inputs of the module
    adjoint: Vec3  # (N,) of the values there
    # Where only a device knows how many there are, those that count; None: all.
    first: int | LaneCount | None = None
    last: int | LaneCount | None = None

    def without_unused_rows(self) -> ModuleAdjoint:
        """The same adjoints, with a module index of -1 in lanes beyond those that count, so that no module runs there."""
        if not isinstance(self.last, LaneCount):
            return self
        place = torch.arange(len(self.row), device=self.row.device)
        first = self.first.alone if isinstance(self.first, LaneCount) else self.first
        return self._replace(row=torch.where((place >= first) & (place < self.last.alone), self.row, -1))


class ModuleGradients:
    """Accumulates the gradients of the parameters of network textures from the adjoints of their values.

    The values are computed once more: between the passes nothing is kept of modules but values. Adjoints of several bounces
    are held back until modules run on all of them at once, in fewer batches.

    Args:
        scene: detached.
        numbered: a record of the scene's structure with the gradient index of each leaf; None: not differentiated.
        gradients: added to.
    """

    def __init__(self, scene: SceneTensors, numbered: SceneTensors, gradients: Gradients):
        self.scene, self.numbered, self.gradients = scene, numbered, gradients
        self.held: list[ModuleAdjoint] = []
        self.lanes = 0  # that reached the bounces of which something is held

    def numbers(self, bank: int) -> Sequence[Sequence[int | None]]:
        """For a table of modules, the gradient index of each parameter of each module; None: not differentiated."""
        return module_banks(self.numbered)[bank].parameters

    def wanted(self, bank: int) -> list[list[bool]]:
        """For a table of modules, whether each parameter of each module is differentiated."""
        return [[leaf is not None for leaf in leaves] for leaves in self.numbers(bank)]

    def adjoints(self, scatterer: Appearance | None, places: tuple[Place, ...],
                 adj_values: tuple[Vec3, ...]) -> tuple[ModuleAdjoint, ...]:
        """The adjoints of network texture values whose modules have differentiated parameters.

        Args:
            scatterer, places: as for `texture_values_at`.
            adj_values: the adjoints of all values.
        """
        asked = zip(banks_asked(self.scene.layout, scatterer), places, adj_values)
        return tuple(ModuleAdjoint(bank, place.row, place.at, adjoint) for bank, place, adjoint in asked
                     if any(map(any, self.wanted(bank))))

    def hold(self, adjoints: Sequence[ModuleAdjoint], lanes: int) -> None:
        """Queues the adjoints of a bounce with `lanes` lanes, until modules run on many at once."""
        if adjoints:
            self.held += [adjoint.without_unused_rows() for adjoint in adjoints]
            self.lanes += lanes

    def add_held(self) -> None:
        """Runs the modules backward on all queued adjoints, and adds the gradients of their parameters."""
        held, self.held, self.lanes = self.held, [], 0
        for bank in dict.fromkeys(part.bank for part in held):
            parts = [(part.row, *part.adjoint, *part.at) for part in held if part.bank == bank]
            row, *channels = map(torch.cat, zip(*parts))
            own, adjoint, at = self.numbers(bank), Vec3(*channels[:3]), coordinates(channels[3:])
            for module, parameter, gradient in module_banks(self.scene)[bank].gradients(self.wanted(bank), row, at, adjoint):
                self.gradients.add_whole(own[module][parameter], gradient)


def values_that_move(scene: SceneTensors, asking: Sequence[Asking]) -> list[tuple[TextureValue, ...]]:
    """The values of network textures for the queues of a bounce, with their derivatives by texture coordinates.

    Args:
        scene: detached.
        asking: for each queue its appearance and points.
    """
    found = asked_outside(moving_values_of, scene, asking, lambda place: 3 * (1 + len(place.at)))
    return [tuple(TextureValue(values, tuple(slopes)) for values, *slopes in map(triples, own)) for own in found]


def moving_values_of(banks: Sequence[int], scene: SceneTensors, given: Given) -> list[Sequence[Tensor]]:
    """Modules' values and derivatives by their inputs, channel by channel; args as for `texture_networks.values_of`."""
    return of_banks(banks, scene, given, channels_that_move)


def channels_that_move(bank: ModuleBank, row: Tensor, at: Vec2 | Vec3, lanes: Sorted) -> list[Tensor]:
    """The values of a network texture and their derivatives by its inputs, as one list of channels."""
    return [channel for values in bank.values_and_slopes(row, at, lanes) for channel in values]


def triples(channels: Sequence[Tensor]) -> list[Vec3]:
    """Groups channels by three into colour vectors."""
    return [Vec3(*channels[first:first + 3]) for first in range(0, len(channels), 3)]
