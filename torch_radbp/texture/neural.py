"""Any module as a texture: a network from surface coordinates, or from positions, to values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn.parameter import is_lazy

from torch_radbp.interface.texture import OutsideReader
from torch_radbp.plugin import Plugin, Texture, nearest
from torch_radbp.tensors.vec import Vec2, Vec3
from torch_radbp.texture.module_bank import ModuleBank
from torch_radbp.texture.module_function import ModuleFunction, Use

PLACES = {"uv": 2, "position": 3}  # with the number of coordinates


@dataclass(frozen=True)
class ModuleReader(OutsideReader):
    """Evaluates modules that are used as textures. Bank: `ModuleBank`.

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
    bounce, and again in the backward pass on those whose values the loss depends on. On the CPU it gets some thousand places
    at a time, on several threads, and on a device at most those of a chunk, which bounds its memory. A row of what it
    returns must depend on the same row of what it gets and on nothing else: no batch statistics, and no chance, such as
    dropout in training mode. All that is to be trained must be among its parameters, and be read as such. A rendering checks
    both on 64 random places, once for each renderer and whenever attributes of the module are replaced. Its buffers are not
    copied: leave them alone between a rendering and its backward pass. Values outside of the attribute's range are an error.

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
        """All parameters of the module, from which the values are computed."""
        return tuple(self.module.parameters())

    def reader(self) -> ModuleReader:
        """The object that evaluates the module for lanes."""
        return ModuleReader(self.of)

    def function(self) -> ModuleFunction:
        """The module as a checked function of surface points."""
        return ModuleFunction(self.module, self.use)


Texture.of_module = NeuralTexture


def check_parameters_of(module: nn.Module, of: str) -> None:
    """Raises ValueError naming a parameter or buffer of a module that has no values (lazy, or on the device meta)."""
    for name, value in (*module.named_parameters(), *module.named_buffers()):
        if is_lazy(value):
            raise ValueError(f"module: its {name} has no shape before the module has run: call it once, on "
                             f"torch.zeros(1, {PLACES[of]})")
        if value.is_meta:
            raise ValueError(f"module: its {name} is on the device meta, which holds no numbers: make the module on the "
                             f"CPU, or call module.to_empty(device=\"cpu\") and load its state")
