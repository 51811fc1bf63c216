"""The ranges of a scene's parameters, and the clamping of values to these.

It sets `Scene.clamping`, which `Scene.clamp_` calls.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable

import torch
from torch import Tensor
from torch.nn.utils import parametrize

from torch_radbp.plugin import nearest
from torch_radbp.plugin.domain import Domain
from torch_radbp.scene.modules.parameters import Held, held_values
from torch_radbp.scene.modules.scene import Scene

MARGIN = 1e-3  # how far values stay from an end that is not in their range, as a share of it, or in their unit


def clamp(scene: Scene, names: str | Iterable[str] | None = None) -> None:
    """Clamps parameters to their ranges, in place; see `Scene.clamp_`."""
    held = held_values(scene)
    chosen = held if names is None else [names] if isinstance(names, str) else list(names)
    for name in chosen:
        if name not in held:
            raise AttributeError(f"the scene has no parameter {name!r}; {nearest(name, held)}")
    with torch.no_grad():
        for name in chosen:
            bring_inside(name, held[name], named=names is not None)


def bring_inside(name: str, held: Held, named: bool = True) -> None:
    """Clamps one value to its range; a reflectance is clamped to 1 only if it requires a gradient or `named` is True."""
    low, high = range_of(held.domains, reflectances=True)
    # A texture that computes its values does so from parameters, which have ranges of their own; buffers are not optimised.
    if low == -math.inf and high == math.inf or held.attribute is None or held.attribute in held.owner._buffers:
        return
    value = held.value
    least, greatest = torch.stack(value.aminmax()).tolist()
    if greatest > high and not named and not requires_gradient(held):
        low, high = range_of(held.domains, reflectances=False)
    if not (least < low or greatest > high):  # nor if one is NaN, which is to be seen
        return
    inside = torch.where(value.isfinite(), value.clamp(low, high), value)
    if held.attribute in held.owner._parameters and value.is_leaf:
        value.copy_(inside)
    else:
        assign(name, held, inside)


def requires_gradient(held: Held) -> bool:
    """True if a value, or a tensor that its parametrisation computes it from, requires a gradient."""
    owner, attribute = held.owner, held.attribute
    if parametrize.is_parametrized(owner, attribute):
        return any(parameter.requires_grad for parameter in owner.parametrizations[attribute].parameters())
    return held.value.requires_grad


def assign(name: str, held: Held, inside: Tensor) -> None:
    """Assigns to a parametrised tensor such that its parametrisation yields the value `inside`."""
    owner, attribute = held.owner, held.attribute
    if not parametrize.is_parametrized(owner, attribute):
        raise RuntimeError(f"parameter {name!r} is computed from other tensors and out of its range: clamp these")
    without = [type(step).__name__ for step in owner.parametrizations[attribute] if not hasattr(step, "right_inverse")]
    if without:
        raise RuntimeError(f"parameter {name!r} is out of its range, and {without[0]}, its parametrisation, has no "
                           f"right_inverse by which it could be brought back: give it one, or a range")
    setattr(owner, attribute, inside)


def range_of(domains: Collection[Domain], reflectances: bool) -> tuple[float, float]:
    """The intersection of some domains as least and greatest value; with `reflectances`, those of reflectances end at 1."""
    low, high = -math.inf, math.inf
    for domain in domains:
        greatest = min(domain.high, 1.0) if domain.is_reflectance and reflectances else domain.high
        margin = MARGIN * (greatest - domain.low if math.isfinite(greatest - domain.low) else 1.0)
        low = max(low, domain.low + (0.0 if domain.low_is_in else margin))
        high = min(high, greatest - (0.0 if domain.high_is_in else margin))
    return low, high


def held_by(scene: Scene, optimizer: torch.optim.Optimizer) -> dict[str, Held]:
    """The values of a scene, by name, that depend on the parameters of an optimizer."""
    moved = {id(parameter) for group in optimizer.param_groups for parameter in group["params"]}
    return {name: held for name, held in held_values(scene).items() if not moved.isdisjoint(held.reach)}


Scene.clamping = staticmethod(clamp)
