"""torch_radbp: a differentiable path tracer that is a torch module.

The pipeline, in the order of data:

1. `load` / `load_dict` (io/) read a Mitsuba 3 scene into a `Scene` (scene/), a tree of modules with named parameters.
2. `Renderer` (rendering/) packs it into flat tensors (scene/packing/pack.py), attached to the parameters by plain torch.
3. `path/` traces bounces: L_k = E_k + F_k L_{k+1}; rays are cast by raycast/, never differentiated.
4. `adjoint/` walks the bounces back: one local vector-Jacobian product each, with the incident radiance in a memo.
   `adjoint/function.py` is the `autograd.Function` of an image; `adjoint/schedule.py` says which path states are kept.
5. Images come out as (B, 3, H, W); autograd carries gradients on through `pack` to whatever made the parameters.

The public names are listed in public.py, which is imported, and torch with it, when the first of them is asked for: so
`radbp --help` and shell completion need not wait for torch.
"""

import sys as _sys
import typing as _typing
from importlib import import_module as _import_module
from types import ModuleType as _ModuleType

if _typing.TYPE_CHECKING:
    from torch_radbp import bake as bake
    from torch_radbp import losses as losses
    from torch_radbp import optim as optim
    from torch_radbp import priors as priors
    from torch_radbp.public import *  # noqa: F403


class _Package(_ModuleType):
    """The package as a module that imports its public names and subpackages on demand."""

    def __getattr__(self, name: str):
        if name.startswith("_") and name != "__all__":
            raise AttributeError(f"module {self.__name__!r} has no attribute {name!r}")
        public = _import_module("torch_radbp.public")
        if name == "__all__" or name in public.__all__:
            return getattr(public, name)
        try:
            return _import_module(f"torch_radbp.{name}")
        except ModuleNotFoundError as error:
            if error.name != f"torch_radbp.{name}":
                raise
            raise AttributeError(f"module {self.__name__!r} has no attribute {name!r}") from None

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *self.__all__})


_sys.modules[__name__].__class__ = _Package
