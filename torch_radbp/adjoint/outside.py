"""The derivatives of values that are computed outside of the functions of a bounce."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.adjoint.scatter import Gradients
from torch_radbp.path.event import Event
from torch_radbp.path.integrand import Integrand
from torch_radbp.path.texture_networks import banks_outside
from torch_radbp.scene.tensors import SceneTensors
from torch_radbp.texture.reader import Given, Place
from torch_radbp.vec import Vec3


class OutsideValues:
    """The values given to one queue of a bounce, recorded, so that their adjoints reach the parameters behind them.

    They are computed again, for these lanes alone: between the passes nothing is kept of them.

    Args:
        integrand: of the detached scene.
        numbered: the same record with the numbers of the wanted leaves, as `Gradients` counts them, and None for the rest.
        event: what happens to the lanes.
        places: of the values.
        moving: whether the places carry derivatives.
    """

    def __init__(self, integrand: Integrand, numbered: SceneTensors, event: Event, places: tuple[Place, ...], moving: bool):
        self.recorded: list[tuple[Tensor, list[Tensor], list[int]]] = []  # values, wanted parameters and their numbers
        self.given: tuple[Given, ...] = ()
        if not places:
            return
        scatterer, given = integrand.scatterer(event), []
        numbers = banks_outside(numbered._replace(layout=integrand.scene.layout), scatterer)
        for bank, own, place in zip(banks_outside(integrand.scene, scatterer), numbers, places):
            at = place.at.stack().requires_grad_(moving)
            parameters = tuple(tuple(leaf.detach().requires_grad_(number is not None) for leaf, number in zip(*pair))
                               for pair in zip(bank.parameters, own.parameters))
            with torch.enable_grad():
                values = bank._replace(parameters=parameters).values(place.row, at)
            given.append(Given(Vec3.of(values.detach()), slopes(values, at) if moving else ()))
            self.recorded.append((values, [leaf for module in parameters for leaf in module if leaf.requires_grad],
                                  [number for module in own.parameters for number in module if number is not None]))
        self.given = tuple(given)

    def add_adjoint(self, adj_given: tuple[Vec3, ...], gradients: Gradients) -> None:
        """Adds what the adjoints of the values contribute to the gradients of the parameters behind them."""
        for (values, parameters, numbers), adjoint in zip(self.recorded, adj_given):
            if values.requires_grad and parameters:
                found = torch.autograd.grad(values, parameters, adjoint.stack(), allow_unused=True)
                for number, gradient in zip(numbers, found):
                    if gradient is not None:
                        gradients.add_whole(number, gradient)


def slopes(values: Tensor, place: Tensor) -> tuple[Vec3, ...]:
    """The derivatives of values, (N, 3), by each coordinate of the places, (N, D), that they were computed from; detached.

    Each value must depend on its own place only.
    """
    if not values.requires_grad:
        return tuple(Vec3.full(coordinate, 0.0) for coordinate in place.detach().unbind(1))
    found = [torch.autograd.grad(values, place, channel.expand_as(values), retain_graph=True, allow_unused=True)[0]
             for channel in torch.eye(values.shape[1]).to(values)]
    of_channel = [torch.zeros_like(place) if slope is None else slope for slope in found]
    return tuple(Vec3(*(slope[:, k].contiguous() for slope in of_channel)) for k in range(place.shape[1]))
