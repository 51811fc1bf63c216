"""A module as a function of surface points, whose results are checked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import torch
from torch import Tensor, nn

from torch_radbp.interface.texture import LUMINANCE
from torch_radbp.plugin.domain import LEEWAY, Domain
from torch_radbp.tensors.asked_later import asked_later

SMOOTH = "keep square roots, norms, logarithms and quotients in the module away from 0"
OUTSIDE = "; let it end with a function onto that range, such as nn.Sigmoid()"


class Use(NamedTuple):
    """The use of a texture in a scene, for checks and messages."""

    name: str  # of the texture, in the scene
    domains: tuple[Domain, ...]  # domains of the attributes that it is used for


@dataclass(frozen=True, eq=False)
class ModuleFunction:
    """A module as a checked function of surface points."""

    module: nn.Module
    use: Use
    as_number: bool = False  # values become scalars: the luminance of three channels, as in Mitsuba
    as_slope: bool = False  # values are replaced by their derivatives by the point

    def with_parameters(self, parameters: Sequence[Tensor]) -> ModuleFunction:
        """The function of a copy of the module with other parameters, in the module's order."""
        standing_in = dict(zip(map(id, self.module.parameters()), parameters))
        return replace(self, module=with_parameters(self.module, standing_in, {}))

    def __call__(self, place: Tensor, checked: bool = False) -> Tensor:
        """(N, 3) values, attached; or the derivatives of the first channel by the point, padded with zeros.

        Args:
            place: (N, 2) or (N, 3).
            checked: its values at these places have been checked.

        Raises:
            TypeError: if the module returns no tensor, or one of another dtype or device.
            ValueError: if it returns a wrong shape, or a value is not finite or not in its domain.
        """
        return self.slopes(place, checked) if self.as_slope else self.values(place, checked)

    def slopes(self, place: Tensor, checked: bool) -> Tensor:
        """(N, 3) derivatives of the first channel by the point. Args as for a call.

        Raises:
            ValueError: if one is not finite, or the values do not depend on the place.
        """
        recorded = torch.is_grad_enabled()
        with torch.enable_grad():
            step = torch.zeros_like(place).requires_grad_()  # not the place itself, which may be a dual tensor
            height = self.values(place + step, checked)[:, 0]
            slopes = torch.autograd.grad(height.sum(), step, create_graph=recorded, allow_unused=True)[0] if (
                height.requires_grad) else None
        if slopes is None:
            raise ValueError(f"the heights that the module of the texture {self.use.name!r} returns do not depend on what "
                             f"it gets, as far as autograd can tell, so that they have no slope: compute them from the "
                             f"place, without .detach() and torch.no_grad(), or leave the bumpmap out")
        if not checked:
            count = slopes.numel()

            def told(numbers: list[float]) -> None:
                if numbers[0]:
                    raise ValueError(f"the slopes of the texture {self.use.name!r}, derivatives of its module by the place, "
                                     f"have {int(numbers[0])} of {count} values that are NaN or infinite; {SMOOTH}")

            asked_later((~torch.isfinite(slopes.detach())).sum().reshape(1), told)
        return torch.cat([slopes, slopes.new_zeros(len(slopes), 3 - slopes.shape[1])], 1)

    def values(self, place: Tensor, checked: bool) -> Tensor:
        """(N, 3) values of the module. Args as for a call."""
        values = self.run(place)
        if not checked:
            self.check(values, place)
        if self.as_number and values.shape[1] == 3:
            values = (values * values.new_tensor(LUMINANCE)).sum(1, keepdim=True)
        return values.expand(-1, 3)

    def run(self, place: Tensor):
        """Runs the module, and adds the texture's name to its errors. Args as for a call.

        Raises:
            RuntimeError: naming the texture, if the module raises anything but lack of memory.
        """
        try:
            return self.module(place)
        except torch.OutOfMemoryError:
            raise
        except Exception as error:
            raise RuntimeError(f"the module of the texture {self.use.name!r} has failed on places of shape "
                               f"{tuple(place.shape)} in {place.dtype}, which are (N, 2) with of=\"uv\" and (N, 3) with "
                               f"of=\"position\": {type(error).__name__}: {error}") from error

    def check(self, values: Tensor, place: Tensor) -> None:
        """Raises ValueError or TypeError unless values are as a call returns them."""
        lanes, name = len(place), f"the texture {self.use.name!r}"
        if not isinstance(values, Tensor):
            raise TypeError(f"the module of {name} must return a tensor, got {type(values).__name__}")
        if tuple(values.shape) not in ((lanes, 1), (lanes, 3)):
            raise ValueError(f"the module of {name} must return shape ({lanes}, 1) or ({lanes}, 3) for places of shape "
                             f"{tuple(place.shape)}, got {tuple(values.shape)}")
        if (values.dtype, values.device) != (place.dtype, place.device):
            raise TypeError(f"the module of {name} must return {place.dtype} on {place.device}, as the scene is, got "
                            f"{values.dtype} on {values.device}")
        extremes = values.detach().aminmax()
        if values.is_cpu:
            self.check_range(name, values, *torch.stack(extremes).tolist())
            return
        bad = (~torch.isfinite(values.detach())).sum().to(values.dtype)
        count = values.numel()

        def told(numbers: list[float]) -> None:
            least, greatest, found = numbers  # of values that are gone by now
            like = torch.zeros(count if found else 1)
            like[:int(found)] = torch.nan
            self.check_range(name, like, least, greatest)

        asked_later(torch.stack([*extremes, bad]), told)

    def check_range(self, name: str, values: Tensor, least: float, greatest: float) -> None:
        """Raises ValueError unless values with these extremes are in the domains of all uses."""
        for domain in self.use.domains:
            finite = abs(greatest - least) < torch.inf
            domain.check_range(name, values, least, greatest, LEEWAY, OUTSIDE if finite else f"; {SMOOTH}")
            domain.warn(name, greatest)


def with_parameters(module: nn.Module, parameters: dict[int, Tensor], copies: dict[int, nn.Module]) -> nn.Module:
    """A shallow copy of a module with other parameters.

    Args:
        module: left as it is.
        parameters: by the ids of those that they replace.
        copies: so far, by the ids of their originals; filled in.
    """
    if id(module) not in copies:
        copy = copies[id(module)] = type(module).__new__(type(module))
        vars(copy).update(vars(module))
        vars(copy)["_parameters"] = {name: parameters.get(id(old), old) for name, old in module._parameters.items()}
        vars(copy)["_modules"] = {name: None if child is None else with_parameters(child, parameters, copies)
                                  for name, child in module._modules.items()}
    return copies[id(module)]
