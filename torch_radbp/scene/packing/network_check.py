"""Checks that modules used as textures will get right gradients, by running them at a few points.

A module is run with copies of its parameters, bounce by bounce, and again in the backward pass. That is right if all that it
computes with is among its registered parameters, if it gives the same values each time, and if each row of what it gives
depends on the same row of what it takes.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from torch_radbp.interface.texture import Reader
from torch_radbp.scene.cache.pack_cache import PackCache
from torch_radbp.tensors.differentiated import differentiated, primal
from torch_radbp.tensors.torch_internals import inside_dual_level
from torch_radbp.texture.module_bank import ModuleBank
from torch_radbp.texture.module_function import ModuleFunction, Use
from torch_radbp.texture.neural import PLACES

ROWS = 64  # places; dropout of a small part of a few values shows in one of them
FEW = 4  # of them; a maximum over all is hardly among these
TOLERANCE = 1e-3  # of the largest value; far above rounding in float32, far below what chance or other rows change
DROPOUT = (nn.Dropout, nn.Dropout1d, nn.Dropout2d, nn.Dropout3d, nn.AlphaDropout, nn.FeatureAlphaDropout)
BATCH_NORM = (nn.BatchNorm1d, nn.BatchNorm2d, nn.BatchNorm3d, nn.SyncBatchNorm)
EVAL = "call .eval() on the module, and again after Renderer.train() or Scene.train(), which put it into training mode"
REENTRANT = "CheckpointFunctionBackward"  # the node of torch.utils.checkpoint(use_reentrant=True)


def check_networks(cache: PackCache, readers: Sequence[Reader], banks: Sequence[Any], dtype: torch.dtype,
                   device: torch.device) -> None:
    """Checks the modules that network textures run, whenever their attributes have changed.

    Args:
        cache: what is known from the last rendering.
        readers: of textures.
        banks: of the readers; attached.
        dtype, device: of the scene.

    Raises:
        TypeError: if a module has been compiled.
        ValueError: naming the texture, if its module is in a mode in which its values depend on chance or on the chunk; and
            where derivatives are recorded, if they would be lost or wrong.
    """
    records = torch.is_grad_enabled() or inside_dual_level()
    for reader, bank in zip(readers, banks):
        for function, parameters in zip(bank.functions, bank.parameters) if isinstance(bank, ModuleBank) else ():
            trained = tuple(map(differentiated, parameters)) if records else None
            check = NetworkCheck(function.module, function.use.name, PLACES[reader.of], dtype, device, trained)
            cache.structure(check, function.module)


@dataclass(frozen=True)
class NetworkCheck:
    """The check of one module; valid until an attribute of the module is replaced.

    Args:
        module: computes values from coordinates.
        texture: the name in the scene of the texture that it stands for.
        coordinates: the number of coordinates that it takes.
        dtype, device: of the coordinates.
        trained: for each parameter, whether derivatives are wanted; None: nothing is differentiated.
    """

    module: nn.Module
    texture: str  # the name in the scene of the texture that runs it
    coordinates: int  # number of coordinates of a point
    dtype: torch.dtype
    device: torch.device
    trained: tuple[bool, ...] | None

    def __call__(self, module: nn.Module) -> None:
        """Runs all checks, which raise and warn as `check_networks` says; `module`: the module of this check."""
        self.check_mode()
        if self.trained is not None:
            self.check_results()

    @property
    def name(self) -> str:
        """The name of the texture, as error messages show it."""
        return f"the texture {self.texture!r}"

    def check_mode(self) -> None:
        """Checks that no part of the module is in a mode whose results depend on chance or on the batch."""
        for path, part in self.module.named_modules(prefix="module"):
            about = f"{self.name}: its {path}, {type(part).__name__},"
            if part._compiled_call_impl is not None:
                raise TypeError(f"{about} has been compiled by .compile(), and would run with other parameters than those "
                                f"that are differentiated, whose gradient would be lost: give a module that has not been")
            if part.training and isinstance(part, (*DROPOUT, nn.RReLU)) and getattr(part, "p", 1.0) > 0.0:
                raise ValueError(f"{about} is in training mode, where values depend on chance: the backward pass computes "
                                 f"them again, and would differentiate others than the image shows; {EVAL}")
            if isinstance(part, BATCH_NORM) and (part.training or part.running_mean is None):
                raise ValueError(f"{about} takes means over the places that are computed together, which change with the "
                                 f"chunk and the bounce; {EVAL if part.training else 'let it keep running statistics'}")

    def check_results(self) -> None:
        """Checks the values that the module returns for some points, and their autograd graph."""
        places = torch.rand(ROWS, self.coordinates, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
        places = places.to(self.device, self.dtype)
        parameters = [copy_of(parameter) for parameter in self.module.parameters()]
        with torch.random.fork_rng([self.device] if torch.cuda.is_initialized() else []), torch.enable_grad():
            first, again, fewer = (self.run(parameters, places[:rows]) for rows in (ROWS, ROWS, FEW))
        if not isinstance(first, Tensor) or tuple(first.shape) not in ((ROWS, 1), (ROWS, 3)) or (
                (first.dtype, first.device) != (places.dtype, places.device)):
            return  # the check of what it returns says more
        if not close(first, again):
            raise ValueError(f"{self.name}: its module gives other values each time that it is run, so that the backward "
                             f"pass would differentiate others than the image shows: let them depend on the place and on "
                             f"parameters alone; if it is dropout, {EVAL}")
        if not close(first[:FEW], fewer):
            raise ValueError(f"{self.name}: a row of what its module returns depends on other rows of what it gets, on all "
                             f"places that are computed together, which change with the chunk and the bounce: take no mean, "
                             f"norm or softmax over dimension 0")
        self.check_graph(first, again, parameters)

    def run(self, parameters: list[Tensor], places: Tensor):
        """The module's values at some points with given parameters, recorded by autograd."""
        return ModuleFunction(self.module, Use(self.texture, ())).with_parameters(parameters).run(
            places.clone().requires_grad_())

    def check_graph(self, first: Tensor, again: Tensor, copies: list[Tensor]) -> None:
        """Checks that the results depend on the copied parameters, and on no other differentiable tensor.

        Args:
            first, again: two results at the same points. Nodes in the graphs of both existed before.
            copies: the copied parameters.
        """
        nodes = list(graph(first))
        if any(node.name() == REENTRANT for node in nodes):
            raise ValueError(f"{self.name}: its module uses torch.utils.checkpoint with use_reentrant=True, which gives no "
                             f"gradients of its parameters here: pass use_reentrant=False")
        lasting = set(map(id, _leaves(graph(again))))
        reached = [leaf for leaf in _leaves(nodes) if id(leaf) in lasting]
        strays = [leaf for leaf in reached if id(leaf) not in set(map(id, copies))]
        names = {id(parameter): name for name, parameter in self.module.named_parameters(prefix="module")}
        named_strays = [names[id(leaf)] for leaf in strays if id(leaf) in names]
        if named_strays:
            raise ValueError(f"{self.name}: its module reaches {' and '.join(named_strays)} past its own attributes, by a "
                             f"list, a closure, a bound method or a compiled function, so that the gradient would be lost: "
                             f"let forward() read it as self.NAME")
        if strays:
            shape = tuple(strays[0].shape)
            raise ValueError(f"{self.name}: its module computes with a tensor of shape {shape} that requires a gradient "
                             f"and is none of its parameters, so that the gradient would be lost: make it an nn.Parameter "
                             f"of the module, with nn.ModuleList or nn.ParameterList in the place of a list; or detach it")
        if not reached and any(self.trained):
            warnings.warn(f"{self.name}: the values of its module do not depend on its parameters as far as autograd can "
                          f"tell, so that all their gradients are zero: leave out torch.no_grad(), .detach() and numpy in "
                          f"forward(), or freeze them by requires_grad_(False)", UserWarning, stacklevel=2)


def copy_of(parameter: Tensor) -> Tensor:
    """A leaf tensor with the values of a parameter."""
    return primal(parameter).clone().requires_grad_(parameter.is_floating_point())


def close(a: Tensor, b: Tensor) -> bool:
    """True if two results of a module agree up to rounding."""
    a, b = a.detach(), b.detach()
    return a.shape == b.shape and torch.allclose(a, b, 0.0, TOLERANCE * float(a.abs().nan_to_num().max()), equal_nan=True)


def graph(values: Tensor) -> Iterator[torch.autograd.graph.Node]:
    """The autograd nodes behind a tensor, each once."""
    ahead = [values.grad_fn]
    seen = set()
    while ahead:
        node = ahead.pop()
        if node is not None and node not in seen:
            seen.add(node)
            yield node
            ahead.extend(other for other, _ in node.next_functions)


def _leaves(nodes: Iterable[torch.autograd.graph.Node]) -> Iterator[Tensor]:
    """The leaf tensors whose gradients autograd nodes accumulate."""
    return (node.variable for node in nodes if hasattr(node, "variable"))
