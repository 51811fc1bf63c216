"""Any module as a texture: a network from surface coordinates, or from positions, to values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn.parameter import is_lazy

from torch_radbp.domain import LEEWAY, Domain
from torch_radbp.jit.order import partition
from torch_radbp.plugin import Plugin, Texture, nearest
from torch_radbp.texture.bitmap import LUMINANCE
from torch_radbp.texture.reader import OutsideReader
from torch_radbp.vec import Vec2, Vec3

PLACES = {"uv": 2, "position": 3}  # with the number of coordinates
SMOOTH = "keep square roots, norms, logarithms and quotients in the module away from 0"
OUTSIDE = "; let it end with a function onto that range, such as nn.Sigmoid()"


class Use(NamedTuple):
    """What is made of a texture in a scene."""

    name: str  # of the texture, in the scene
    domains: tuple[Domain, ...]  # that its values must be in


@dataclass(frozen=True, eq=False)
class ModuleFunction:
    """The values of a module as a function of its parameters and of places."""

    module: nn.Module
    use: Use
    as_number: bool = False  # values are read as numbers: the luminance if there are three channels, as in Mitsuba
    as_slope: bool = False  # their derivatives by the place are read instead

    def __call__(self, parameters: Sequence[Tensor], place: Tensor) -> Tensor:
        """(N, 3) values, attached; of slopes the derivatives of the first channel by the place, and zeros.

        Args:
            parameters: instead of those of the module, in their order.
            place: (N, 2) or (N, 3).

        Raises:
            TypeError: if the module returns no tensor, or one of another dtype or device.
            ValueError: if it returns a wrong shape, or a value is not finite or not in its domain.
        """
        return self.slopes(parameters, place) if self.as_slope else self.values(parameters, place)

    def slopes(self, parameters: Sequence[Tensor], place: Tensor) -> Tensor:
        """(N, 3) derivatives of the first channel by the place. Args as for a call.

        Raises:
            ValueError: if one is not finite, or the values do not depend on the place.
        """
        recorded = torch.is_grad_enabled()
        with torch.enable_grad():
            step = torch.zeros_like(place).requires_grad_()  # not the place itself, which may be a dual tensor
            height = self.values(parameters, place + step)[:, 0]
            found = torch.autograd.grad(height.sum(), step, create_graph=recorded, allow_unused=True)[0] if (
                height.requires_grad) else None
        if found is None:
            raise ValueError(f"the heights that the module of the texture {self.use.name!r} returns do not depend on what "
                             f"it gets, as far as autograd can tell, so that they have no slope: compute them from the "
                             f"place, without .detach() and torch.no_grad(), or leave the bumpmap out")
        if not bool(torch.isfinite(found).all()):
            bad = int((~torch.isfinite(found)).sum())
            raise ValueError(f"the slopes of the texture {self.use.name!r}, derivatives of its module by the place, have "
                             f"{bad} of {found.numel()} values that are NaN or infinite; {SMOOTH}")
        return torch.cat([found, found.new_zeros(len(found), 3 - found.shape[1])], 1)

    def values(self, parameters: Sequence[Tensor], place: Tensor) -> Tensor:
        """(N, 3) values of the module. Args as for a call."""
        values = self.run(parameters, place)
        self.check(values, place)
        if self.as_number and values.shape[1] == 3:
            values = (values * values.new_tensor(LUMINANCE)).sum(1, keepdim=True)
        return values.expand(-1, 3)

    def run(self, parameters: Sequence[Tensor], place: Tensor):
        """What the module returns. Args as for a call.

        Raises:
            RuntimeError: naming the texture, if the module raises anything but lack of memory.
        """
        standing_in = dict(zip(map(id, self.module.parameters()), parameters))
        try:
            return with_parameters(self.module, standing_in, {})(place)
        except torch.OutOfMemoryError:
            raise
        except Exception as error:
            raise RuntimeError(f"the module of the texture {self.use.name!r} has failed on places of shape "
                               f"{tuple(place.shape)} in {place.dtype}, which are (N, 2) with of=\"uv\" and (N, 3) with "
                               f"of=\"position\": {type(error).__name__}: {error}") from error

    def check(self, values: Tensor, place: Tensor) -> None:
        """Raises as a call does."""
        lanes, name = len(place), f"the texture {self.use.name!r}"
        if not isinstance(values, Tensor):
            raise TypeError(f"the module of {name} must return a tensor, got {type(values).__name__}")
        if tuple(values.shape) not in ((lanes, 1), (lanes, 3)):
            raise ValueError(f"the module of {name} must return shape ({lanes}, 1) or ({lanes}, 3) for places of shape "
                             f"{tuple(place.shape)}, got {tuple(values.shape)}")
        if (values.dtype, values.device) != (place.dtype, place.device):
            raise TypeError(f"the module of {name} must return {place.dtype} on {place.device}, as the scene is, got "
                            f"{values.dtype} on {values.device}")
        least, greatest = torch.stack(values.detach().aminmax()).tolist()
        for domain in self.use.domains:
            finite = abs(greatest - least) < torch.inf
            domain.check_range(name, values, least, greatest, LEEWAY, OUTSIDE if finite else f"; {SMOOTH}")
            domain.warn(name, greatest)


class ModuleBank(NamedTuple):
    """Some modules, with the tensors that they are differentiated with respect to."""

    functions: tuple[ModuleFunction, ...]
    parameters: tuple[tuple[Tensor, ...], ...]  # of each; attached

    def values(self, row: Tensor, place: Tensor) -> Tensor:
        """(N, 3) values, attached. Each module runs on its own lanes.

        Args:
            row: (N,) int32, which of the modules gives each lane its value; -1: none, and the value is 0.
            place: (N, 2) or (N, 3).
        """
        order, (nothing, *counts) = partition(row + 1, len(self.functions) + 1)
        lanes = order.long().split([nothing, *counts])
        if len(place) and len(place) in counts:  # one gives all, in the order that they have
            return self.functions[counts.index(len(place))](self.parameters[counts.index(len(place))], place)
        parts = [function(parameters, place[own]) for function, parameters, own in
                 zip(self.functions, self.parameters, lanes[1:]) if len(own)]
        return torch.cat([place.new_zeros(nothing, 3), *parts])[torch.argsort(order)]


@dataclass(frozen=True)
class ModuleReader(OutsideReader):
    """Reads modules. Bank: `ModuleBank`.

    Args:
        of: see `NeuralTexture`.
    """

    of: str

    @property
    def needs_uv(self) -> bool:
        return self.of == "uv"

    def bank(self, textures: Sequence[Texture], dtype: torch.dtype, device: torch.device) -> ModuleBank:
        functions = tuple(texture.function() for texture in textures)
        # Copies, so that an optimiser's step between a rendering and its backward pass changes nothing.
        return ModuleBank(functions, tuple(tuple(parameter.clone() for parameter in function.module.parameters())
                                           for function in functions))

    def place(self, p: Vec3, uv: Vec2 | None) -> Vec2 | Vec3:
        return uv if self.of == "uv" else p


class NeuralTexture(Texture):
    """The values of a module at each surface point, in the place of any texture of a material or of a light on a surface.

    Parameters: those of the module, as `module.NAME`; they keep their `requires_grad`. Derivatives: with respect to them,
    and through the place to whatever moves it.

    The module is called on the lanes that meet the material or the light, or have picked a point on the light, bounce by
    bounce, and again in the backward pass, so that its memory is bounded by the chunk. A row of what it returns must depend
    on the same row of what it gets and on nothing else: no batch statistics, and no chance, such as dropout in training
    mode. All that is to be trained must be among its parameters, and be read as such. A rendering checks both on 64 random
    places, once for each renderer and whenever attributes of the module are replaced. Its buffers are not copied: leave them
    alone between a rendering and its backward pass. Values outside of the attribute's range are an error.

    Args:
        module: from (N, 2) or (N, 3) to (N, 1) or (N, 3), of the scene's dtype; the scene's `.to()` converts it, too.
        of: "uv", surface coordinates, or "position", world space.

    Raises:
        TypeError: unless `module` is an `nn.Module`, and a plain one: not the result of `torch.compile` or `torch.jit`.
        ValueError: for an unknown `of`, and for parameters without shape or without numbers.
    """

    tabulated = False

    def __init__(self, module: nn.Module, of: str = "uv"):
        super().__init__()
        if not isinstance(module, nn.Module) or isinstance(module, Plugin):
            raise TypeError(f"module must be an nn.Module from (N, 2) or (N, 3) to values, got {type(module).__name__}")
        for part in module.modules():
            if isinstance(part, torch.jit.ScriptModule) or hasattr(part, "_orig_mod"):
                raise TypeError(f"module must be plain torch, got {type(part).__name__}: give what torch.compile or "
                                f"torch.jit was given; the gradient of its parameters would be lost")
        if of not in PLACES:
            raise ValueError(f"of={of!r} is not known; {nearest(str(of), PLACES)}")
        check_parameters_of(module, of)
        self.module, self.of = module, of
        self.use = Use("", ())

    def sources(self) -> tuple[Tensor, ...]:
        """The parameters of the module."""
        return tuple(self.module.parameters())

    def reader(self) -> ModuleReader:
        """How lanes read it."""
        return ModuleReader(self.of)

    def function(self) -> ModuleFunction:
        """The values as a function of the place."""
        return ModuleFunction(self.module, self.use)


Texture.of_module = NeuralTexture


def check_parameters_of(module: nn.Module, of: str) -> None:
    """Raises ValueError naming a parameter or a buffer of a module that holds no numbers."""
    for name, value in (*module.named_parameters(), *module.named_buffers()):
        if is_lazy(value):
            raise ValueError(f"module: its {name} has no shape before the module has run: call it once, on "
                             f"torch.zeros(1, {PLACES[of]})")
        if value.is_meta:
            raise ValueError(f"module: its {name} is on the device meta, which holds no numbers: make the module on the "
                             f"CPU, or call module.to_empty(device=\"cpu\") and load its state")


def with_parameters(module: nn.Module, parameters: dict[int, Tensor], known: dict[int, nn.Module]) -> nn.Module:
    """A shallow copy of a module with other parameters, which other threads do not see.

    Args:
        module: left as it is.
        parameters: by the ids of those that they replace.
        known: copies so far, by the ids of their originals; filled in.
    """
    if id(module) not in known:
        copy = known[id(module)] = type(module).__new__(type(module))
        vars(copy).update(vars(module))
        vars(copy)["_parameters"] = {name: parameters.get(id(own), own) for name, own in module._parameters.items()}
        vars(copy)["_modules"] = {name: None if child is None else with_parameters(child, parameters, known)
                                  for name, child in module._modules.items()}
    return known[id(module)]
