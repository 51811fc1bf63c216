"""Copies of a plugin with parameters at the ends of their ranges."""

from __future__ import annotations

import copy
import math
from collections.abc import Iterator
from typing import TypeVar

import torch
from torch import Tensor, nn

from torch_radbp.plugin import Plugin
from torch_radbp.plugin.domain import Domain
from torch_radbp.scene.modules.parameters import Held, held_in

Made = TypeVar("Made", bound=Plugin)


def standing_alone(plugin: Made) -> Made:
    """A copy of a plugin in float64 on the CPU with all of its parts, shared ones included."""
    alone = copy.deepcopy(plugin).requires_grad_(False)
    for part in list(alone.modules()):
        for name in list(part.shared) if isinstance(part, Plugin) else ():
            part._modules[name] = standing_alone(part.shared.pop(name))
    return alone.to("cpu", torch.float64)


def _ends_of(domains: list[Domain]) -> list[float]:
    """The finite ends of the range of a parameter; for reflectances also 1."""
    if any(domain.is_pose or domain.is_index for domain in domains):
        return []
    low = [domain.low for domain in domains if domain.low_is_in and domain.low > -math.inf]
    high = [1.0 if domain.is_reflectance else domain.high for domain in domains
            if domain.is_reflectance or (domain.high_is_in and domain.high < math.inf)]
    return [*([max(low)] if low else []), *([min(high)] if high else [])]


def _parameters_of(plugin: Plugin) -> dict[str, tuple[Held, Tensor]]:
    """The parameters of a plugin that have a range, by name, each with its attribute and current value."""
    by_name = {name.removeprefix("."): held for name, held in held_in(plugin).items() if held.attribute is not None}
    return {name: (held, held.value) for name, held in by_name.items() if isinstance(held.value, nn.Parameter)}


def at_ends(plugin: Made) -> Iterator[tuple[str, Made]]:
    """Yields copies of a plugin with one parameter at one end of its range, with a name for each."""
    for name, (held, _) in _parameters_of(plugin).items():
        for end in _ends_of(held.domains):
            other = copy.deepcopy(plugin)
            with torch.no_grad():
                _parameters_of(other)[name][1].fill_(end)
            yield f"{name} = {end:g}", other


def white(plugin: Made) -> Made:
    """A copy of a plugin whose reflectances are all 1."""
    other = copy.deepcopy(plugin)
    with torch.no_grad():
        for held, value in _parameters_of(other).values():
            if any(domain.is_reflectance for domain in held.domains):
                value.fill_(1.0)
    return other
