"""The values of textures that are computed outside of the functions of a bounce, and their derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

from torch import Tensor

from torch_radbp.adjoint.scatter import Gradients
from torch_radbp.jit.recording import outside
from torch_radbp.path.texture_networks import banks_outside, coordinates
from torch_radbp.scene.appearance import Appearance
from torch_radbp.scene.tensors import SceneTensors
from torch_radbp.tensors.vec import Vec3
from torch_radbp.texture.reader import Place, TextureValue


class ModuleGradients(NamedTuple):
    """The modules of a scene, and the gradients of their parameters."""

    scene: SceneTensors  # detached
    numbered: SceneTensors  # with the numbers of the wanted leaves, as `Gradients` counts them, and None for the rest
    gradients: Gradients  # added to

    def numbers(self, scatterer: Appearance | None, number: int) -> Sequence[Sequence[int | None]]:
        """Those of the parameters of the modules of one texture; args as for `add_adjoint`."""
        return banks_outside(self.numbered._replace(layout=self.scene.layout), scatterer)[number].parameters

    def wanted(self, scatterer: Appearance | None, number: int) -> list[list[bool]]:
        """Which of these have one."""
        return [[leaf is not None for leaf in leaves] for leaves in self.numbers(scatterer, number)]


def values_that_move(scene: SceneTensors, scatterer: Appearance | None,
                     places: tuple[Place, ...]) -> tuple[TextureValue, ...]:
    """The values of textures for one queue of a bounce, with their derivatives by the places.

    Args:
        scene: detached.
        scatterer: what the lanes are scattered by; None: they end.
        places: of the values.
    """
    found = []
    for number, place in enumerate(places):
        values, *slopes = triples(outside(partial(moving_values_of, scatterer, number), scene, (place.row, *place.at),
                                          3 * (1 + len(place.at))))
        found.append(TextureValue(values, tuple(slopes)))
    return tuple(found)


def moving_values_of(scatterer: Appearance | None, number: int, scene: SceneTensors, row: Tensor,
                     *at: Tensor) -> list[Tensor]:
    """The values of one of these textures and their derivatives, channel by channel; args as for `values_that_move`."""
    found = banks_outside(scene, scatterer)[number].values_and_slopes(row, coordinates(at))
    return [channel for values in found for channel in values]


def triples(channels: Sequence[Tensor]) -> list[Vec3]:
    """Three channels each."""
    return [Vec3(*channels[first:first + 3]) for first in range(0, len(channels), 3)]


def add_adjoint(modules: ModuleGradients, scatterer: Appearance | None, places: tuple[Place, ...],
                adj_values: tuple[Vec3, ...]) -> None:
    """Adds what the adjoints of such values contribute to the gradients of the parameters behind them.

    They are computed once more, batch by batch: between the passes nothing is kept but values.

    Args:
        scatterer, places: as for `values_that_move`.
        adj_values: of the values.
    """
    for number, (place, adjoint) in enumerate(zip(places, adj_values)):
        if any(map(any, modules.wanted(scatterer, number))):
            outside(partial(add_adjoint_of, scatterer, number), modules, (place.row, *place.at, *adjoint), 0)


def add_adjoint_of(scatterer: Appearance | None, number: int, modules: ModuleGradients, row: Tensor,
                   *at_and_adjoint: Tensor) -> tuple[()]:
    """As `add_adjoint`, of one of these textures."""
    at, adjoint = coordinates(at_and_adjoint[:-3]), Vec3(*at_and_adjoint[-3:])
    bank, own = banks_outside(modules.scene, scatterer)[number], modules.numbers(scatterer, number)
    for module, parameter, gradient in bank.gradients(modules.wanted(scatterer, number), row, at, adjoint):
        modules.gradients.add_whole(own[module][parameter], gradient)
    return ()
