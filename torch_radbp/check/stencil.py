"""The stencils of finite differences, within a parameter's domain: central, or to one side."""

from __future__ import annotations

import warnings
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.func import functional_call

from torch_radbp.plugin.domain import LEEWAY, Domain
from torch_radbp.scene.cache.pack_cache import PackCache
from torch_radbp.scene.modules.parameters import check_parameters, held_values
from torch_radbp.scene.modules.scene import Scene
from torch_radbp.scene.packing.attributes import attributes_read, check_attributes

PARTS = (1.0, 0.25, 1 / 16)  # of a step that was not asked for, if it leaves a narrow domain
ROUNDING = 1e-6  # how far a place may be outside of a range, as a share of its numbers: 0.9 + 0.1 in float32 is more than 1


class Stencil(NamedTuple):
    """Three equidistant offsets, in steps, and the weights of their images for a derivative times the step."""

    words: str
    offsets: tuple[int, int, int]
    weights: tuple[float, float, float]


BOTH_SIDES = Stencil("to both sides", (-1, 0, 1), (-0.5, 0.0, 0.5))
STENCILS = (BOTH_SIDES, Stencil("to one side", (0, 1, 2), (-1.5, 2.0, -0.5)),
            Stencil("to one side", (-2, -1, 0), (0.5, -2.0, 1.5)))


class ParameterMove(NamedTuple):
    """The movement of a parameter for finite differences: `step` times `direction` times the stencil's offsets."""

    step: float
    stencil: Stencil
    direction: Tensor


def inside(scene: Scene, name: str, direction: Tensor, step: float, *, chosen: bool, turns: bool) -> ParameterMove:
    """Chooses step and stencil such that a parameter stays within its domain.

    Args:
        scene: has the parameter.
        name: of the parameter.
        direction: of its shape.
        step: the largest.
        chosen: the step is the user's; else a part of it will do.
        turns: entries of the parameter that stand at the upper end of their range may move down instead of up.

    Raises:
        ValueError: if steps to both sides leave the domain.
    """
    parameter, first, floor = scene.get_parameter(name), None, floor_of(scene, name)
    floor = floor if bool((parameter >= floor).all()) else -torch.inf  # differences do not cross it
    if (why := _outside(scene, name, parameter, LEEWAY)) is not None:
        raise ValueError(why)
    # A scene that is a little outside already, as a rendering tolerates it, has no better places.
    leeway = ROUNDING if _outside(scene, name, parameter, ROUNDING) is None else LEEWAY
    for h in [step * part for part in ((1.0,) if chosen else PARTS)]:
        for d in (direction, turned_inwards(scene, parameter, direction, h)) if turns else (direction,):
            for stencil in STENCILS:
                places = [parameter.detach() + offset * h * d for offset in stencil.offsets]
                out = [why for place in places if (why := _outside(scene, name, place, leeway)) is not None]
                first = first or (out[0] if out else None)
                if not out and bool((torch.stack(places) >= floor - ROUNDING * abs(floor)).all()):
                    return ParameterMove(h, stencil, d)
    advice = "give a smaller step" if chosen else "give another direction, which leads into it"
    raise ValueError(f"differences of {name!r} by steps of {step:.3g} along this direction leave its domain to both "
                     f"sides; {advice} ({first})")


def turned_inwards(scene: Scene, parameter: Tensor, direction: Tensor, step: float) -> Tensor:
    """The direction with its sign flipped in entries that two steps would take beyond the upper end of their range."""
    high = min([domain.high for domain in domains_of(scene, parameter)], default=torch.inf)
    return torch.where(parameter.detach() + 2 * step * direction > high, -direction.abs(), direction)


def floor_of(scene: Scene, name: str) -> float:
    """The value below which plugins clamp a parameter; minus infinity if there is none."""
    return max([domain.floor for domain in domains_of(scene, scene.get_parameter(name))], default=-torch.inf)


def domains_of(scene: Scene, parameter: Tensor) -> list[Domain]:
    """The domains of all attributes that use a tensor of the scene."""
    domains = [domain for held in held_values(scene).values() for domain in held.domains
               if held.attribute is not None and getattr(held.owner, held.attribute) is parameter]
    return domains + [domain for shape in scene.shapes for owner in (shape.bsdf, shape.emitter) if owner is not None
                      for name, domain, _ in attributes_read(owner) if getattr(shape, name, None) is parameter]


def _outside(scene: Scene, name: str, value: Tensor, leeway: float) -> str | None:
    """Why a value of a parameter is outside of its domain, by more than a tolerance; None: it is inside."""
    with torch.no_grad(), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            functional_call(DomainOf(scene, leeway), {f"scene.{name}": value})
        except ValueError as error:
            return str(error).partition("; ")[0]
    return None


class DomainOf(nn.Module):
    """A module whose call makes the checks of parameters' ranges that every rendering makes, for `functional_call`."""

    def __init__(self, scene: Scene, leeway: float):
        super().__init__()
        self.scene, self.leeway = scene, leeway

    def forward(self) -> None:
        cache = PackCache()
        check_parameters(self.scene, cache, list(self.scene.named_sensors), self.leeway)
        check_attributes(self.scene, cache, self.leeway)
