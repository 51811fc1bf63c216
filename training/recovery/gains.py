"""The gains of views: unknown exposures that are recovered beside the parameters of the scene."""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from torch_radbp.photographs.exposure import Exposure
from torch_radbp.plugin import nearest
from torch_radbp.training import recipe_parameter as recipe
from torch_radbp.training.recovery.recovered import RecoveredParameter

NAME = "gains"


@dataclass
class RecoveredGains(RecoveredParameter):
    """The gains of all targets, (V,), or (V, 3) of the channels with a white balance; `module` is the `rb.Exposure`."""

    @property
    def attached(self) -> Tensor:
        return exposed(self.module)

    @property
    def leaves(self) -> dict[str, nn.Parameter]:
        balance = self.module.log_balance
        return {self.name: self.module.log_gain} | ({} if balance is None else {f"{self.name}:balance": balance})

    spec_of_grid = None
    bounds_of_leaf = None
    is_picture = False
    is_plain = False
    is_pose = False

    def settle(self, scene: nn.Module) -> None:
        """Nothing: they are no part of the scene."""


def exposed(exposure: Exposure) -> Tensor:
    """The gains of views, (V,), or (V, 3) if channels have their own."""
    return exposure.gains[:, 0] if exposure.log_balance is None else exposure.gains


def recovered_gains(spec: recipe.Gains, sensors: list[str], like: Tensor) -> RecoveredGains:
    """The gains of a recipe, at their initial values.

    Args:
        spec: the recipe's table.
        sensors: the names of the sensors of all targets.
        like: gives dtype and device.

    Raises:
        ValueError: no such sensor, or numbers that are not positive or not one for each target.
    """
    if spec.fixed is not None and spec.fixed not in sensors:
        raise ValueError(f"gains.fixed: no target has the sensor {spec.fixed!r}; {nearest(spec.fixed, sensors)}")
    fixed = None if spec.fixed is None else sensors.index(spec.fixed)
    exposure = Exposure(len(sensors), fixed=fixed, white_balance=spec.white_balance,
                        gains=_for_each(spec.initial, len(sensors), "initial")).to(like)
    truth = None
    if spec.truth is not None:
        truth = _for_each(spec.truth, len(sensors), "truth").to(like)
        truth = truth[:, None].expand(-1, 3).clone() if spec.white_balance else truth
    with torch.no_grad():
        before = exposed(exposure).clone()
    return RecoveredGains(NAME, exposure, NAME, spec, before, truth)


def _for_each(value: float | list[float], count: int, role: str) -> Tensor:
    """(count,) gains of a recipe's number or numbers."""
    gains = torch.tensor(value)
    if gains.dim() and len(gains) != count:
        raise ValueError(f"gains.{role} must be one number or one for each of the {count} targets, got {len(gains)}")
    if not (gains > 0).all():
        raise ValueError(f"gains.{role} must be positive, got {gains.min().item():g}")
    return gains.expand(count).clone()
