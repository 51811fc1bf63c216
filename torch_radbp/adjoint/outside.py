"""The values of textures that are computed outside of the functions of a bounce, and their derivatives."""

from __future__ import annotations

from torch_radbp.adjoint.scatter import Gradients
from torch_radbp.path.event import Event
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.texture_networks import banks_outside
from torch_radbp.scene.tensors import SceneTensors
from torch_radbp.tensors.vec import Vec3
from torch_radbp.texture.reader import Place, TextureValue


def values_that_move(integrand: Integrand, event: Event, places: tuple[Place, ...]) -> tuple[TextureValue, ...]:
    """The values of textures for one queue of a bounce, with their derivatives by the places.

    Args:
        integrand: of the detached scene.
        event: what happens to the lanes.
        places: of the values.
    """
    banks = banks_outside(integrand.scene, integrand.scatterer(event)) if places else ()
    found = (bank.values_and_slopes(place.row, place.at) for bank, place in zip(banks, places))
    return tuple(TextureValue(values, tuple(slopes)) for values, *slopes in found)


def add_adjoint(integrand: Integrand, numbered: SceneTensors, event: Event, places: tuple[Place, ...],
                adj_values: tuple[Vec3, ...], gradients: Gradients) -> None:
    """Adds what the adjoints of such values contribute to the gradients of the parameters behind them.

    They are computed once more, batch by batch: between the passes nothing is kept but values.

    Args:
        integrand, event, places: as for `values_that_move`.
        numbered: the scene with the numbers of the wanted leaves, as `Gradients` counts them, and None for the rest.
        adj_values: of the values.
        gradients: added to.
    """
    scatterer = integrand.scatterer(event)
    numbers = banks_outside(numbered._replace(layout=integrand.scene.layout), scatterer) if places else ()
    for bank, own, place, adjoint in zip(banks_outside(integrand.scene, scatterer), numbers, places, adj_values):
        wanted = [[leaf is not None for leaf in leaves] for leaves in own.parameters]
        if any(map(any, wanted)):
            for module, number, gradient in bank.gradients(wanted, place.row, place.at, adjoint):
                gradients.add_whole(own.parameters[module][number], gradient)
