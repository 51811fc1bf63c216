"""The attributes of modules: comparing them with those of the last rendering, and copying modules from them.

See `scene.cache.pack_cache`, which keeps such copies.
"""

from __future__ import annotations

import dataclasses
import operator
from collections.abc import Collection
from functools import cache
from types import SimpleNamespace
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn.utils import parametrize

from torch_radbp.plugin import BSDF, Emitter, Plugin, Shape
from torch_radbp.plugin.domain import Domain

# Values that are equal if and only if they compare so.
PLAIN = (int, str, bool, type(None), type, torch.dtype, torch.device, Domain)
OFTEN = set(PLAIN)  # the same, quickly found
OF_EVERY_MODULE = set(vars(nn.Module()))  # attributes

Attributes = tuple[tuple[list[str], list[Any]], ...]  # names and values of each dict of `dicts_of`


@cache
def frozen_dataclass(kind: type) -> bool:
    """True if a class is a frozen dataclass, so that its instances do not change."""
    return dataclasses.is_dataclass(kind) and kind.__dataclass_params__.frozen


def is_constant(value, beside: tuple[type, ...] = ()) -> bool:
    """True if a value is immutable: a plain value or number, or an instance of the classes `beside`."""
    if isinstance(value, tuple) or frozen_dataclass(type(value)):
        return all(is_constant(part, beside) for part in (value if isinstance(value, tuple) else vars(value).values()))
    return isinstance(value, (*PLAIN, float, *beside))


def modules_in(root: nn.Module, prefix: str = "", without: Collection[nn.Module] = ()) -> list[tuple[str, nn.Module]]:
    """A module and all modules in it with their names, each once and in the order of `named_modules`.

    Args:
        root: any module.
        prefix: its name.
        without: modules that are left out with all that is in them.
    """
    named, met, left = [], set(), [(prefix, root)]
    while left:
        prefix, module = left.pop()
        if module in met:
            continue
        met.add(module)
        named.append((prefix, module))
        dot = prefix and prefix + "."
        left += [(dot + name, child) for name, child in reversed(module._modules.items())
                 if child is not None and child not in without]
    return named


class ModuleTree(nn.Module):
    """A tree of modules some of whose submodules are roots of their own and do not count as parts, as a scene's sensors."""

    def separate_roots(self) -> Collection[nn.Module]:
        """The submodules whose attributes are compared separately from the rest, such as sensors."""
        raise NotImplementedError

    def shared_with_roots(self) -> list[nn.Module]:
        """The modules within separate roots that also belong to this tree."""
        raise NotImplementedError


def separate_roots(root: nn.Module) -> set[nn.Module]:
    """The submodules of a root that are roots of their own, such as a scene's sensors."""
    return set(root.separate_roots()) if isinstance(root, ModuleTree) else set()


def shared_with_roots(root: nn.Module) -> list[nn.Module]:
    """The modules within a root's separate roots that also belong to the root."""
    return root.shared_with_roots() if isinstance(root, ModuleTree) else []


def dicts_of(module: nn.Module) -> tuple[dict[str, Any], ...]:
    """The dicts that hold a module's attributes, parameters, buffers and submodules."""
    shared = module.shared if isinstance(module, Plugin) else {}
    return vars(module), module._parameters, module._buffers, module._modules, shared


def attributes_of(module: nn.Module) -> Attributes:
    """The attributes of a module, in the form that `has_attributes` compares."""
    return tuple((list(each), list(each.values())) for each in dicts_of(module))


def has_attributes(module: nn.Module, attributes: Attributes) -> bool:
    """True if the attributes of a module are the very same objects."""
    return all(list(now) == names and all(map(operator.is_, now.values(), values))
               for now, (names, values) in zip(dicts_of(module), attributes))


def stands_still(module: nn.Module) -> bool:
    """True if a module whose attributes stay the same objects can change only through its tensors and submodules."""
    return all(is_constant(value, beside=(Tensor, nn.Module)) for name, value in vars(module).items()
               if name not in OF_EVERY_MODULE and name != "shared")


def parametrized_names(module: nn.Module) -> tuple[str, ...]:
    """The names of a module's tensors that are parametrised (`torch.nn.utils.parametrize`)."""
    return tuple(module.parametrizations) if parametrize.is_parametrized(module) else ()


def children_of(module: nn.Module) -> list[tuple[str, nn.Module | None]]:
    """The submodules of a module on which its tables may depend."""
    children = {**module._modules, **(module.shared if isinstance(module, Plugin) else {})}
    if parametrize.is_parametrized(module):
        del children["parametrizations"]
    of_no_matter = (BSDF, Emitter) if isinstance(module, Shape) else ()
    return [(name, child) for name, child in children.items() if not isinstance(child, of_no_matter)]


def assembled(cls: type, others: tuple, parameters: tuple, buffers: tuple, children: tuple):
    """Makes an object of a class from (name, value) pairs, without calling its constructor."""
    made = cls.__new__(cls)
    if issubclass(cls, nn.Module):
        nn.Module.__init__(made)
        made._parameters.update(parameters)
        made._buffers.update(buffers)
        made._modules.update(children)
    vars(made).update(others)
    return made


def holder(name: str, value) -> SimpleNamespace:
    """A plain object with one attribute, which takes a module's place where only that attribute is read."""
    return SimpleNamespace(**{name: value})
