"""The tensors and modules of a scene, in flat lists that are quickly compared with those of the next rendering.

A scene has hundreds of attributes, of which a step of an optimisation changes the numbers in a few tensors. What follows
from the others (which materials there are, how textures are laid out) is found again only if one of them is another object,
or a tensor has another shape, dtype or device, or requires a gradient where it did not.
"""

from __future__ import annotations

import operator
from collections.abc import Collection, Hashable, Iterable, Iterator
from itertools import chain
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn.utils import parametrize

from torch_radbp.plugin import BSDF, Emitter, Medium, Plugin, Shape
from torch_radbp.scene.cache.module_attributes import ModuleTree, dicts_of, separate_roots, shared_with_roots, stands_still
from torch_radbp.tensors.differentiated import differentiated
from torch_radbp.tensors.torch_internals import inside_dual_level

KIND = operator.attrgetter("shape", "dtype", "device", "layout", "requires_grad")  # of a tensor, all but its numbers


class Inventory:
    """The attributes of a module and of all modules in it, as they are at one rendering.

    Of a scene, sensors are left out, but for the medium in which they stand; see `ModuleTree`.

    Args:
        root: the module.
    """

    def __init__(self, root: nn.Module):
        self.shared = shared_with_roots(root)
        self.root, self.modules = root, list(_held_by([*self.shared, root], separate_roots(root)))
        self.inner = [each for module in self.modules for each in dicts_of(module)[1:]]  # found in `vars` of the modules
        dicts = self.dicts()
        self.sizes, self.names = list(map(len, dicts)), list(chain.from_iterable(dicts))
        self.values = list(chain.from_iterable(map(dict.values, dicts)))
        tensors = {id(tensor): (place, tensor) for module in self.modules for place, tensor in tensors_of(module)}
        self.tensors = [tensor for _, tensor in tensors.values()]
        self.kinds = list(map(KIND, self.tensors))
        self.live = frozenset(id(tensor) for tensor in self.tensors if differentiated(tensor))
        self.settled = [(place, tensor) for place, tensor in tensors.values()
                        if id(tensor) not in self.live and tensor.layout == torch.strided]
        # Of a device, whose numbers a rendering asks for, to check them.
        self.away = [tensor for tensor in self.tensors if id(tensor) in self.live and not tensor.is_cpu
                     and tensor.layout == torch.strided and tensor.is_floating_point() and tensor.numel()]
        self.restless = frozenset(id(module) for module in self.modules if is_restless(module))
        self.settled_reach = self.restless.union(id(tensor) for _, tensor in self.settled)  # of all, as of `reach`
        self.lasts = not inside_dual_level() and all(stands_still(each) for each in self.modules if isinstance(each, Plugin))
        self.reaches: dict[tuple[nn.Module, ...], frozenset[int]] = {}
        self.results: dict[tuple, Any] = {}  # of functions of the root, by these and their other arguments

    def dicts(self) -> list[dict[str, Any]]:
        """The attribute dicts of all modules in the inventory, as they are now."""
        return [*map(vars, self.modules), *self.inner]

    def holds(self, root: nn.Module) -> bool:
        """True if a module and all modules in it still have the same attributes, whatever the values of tensors are."""
        dicts = self.dicts()
        return (root is self.root and not inside_dual_level() and shared_with_roots(root) == self.shared
                and list(map(len, dicts)) == self.sizes and list(chain.from_iterable(dicts)) == self.names
                and all(map(operator.is_, chain.from_iterable(map(dict.values, dicts)), self.values))
                and list(map(KIND, self.tensors)) == self.kinds)

    def reach(self, modules: tuple[nn.Module, ...]) -> frozenset[int]:
        """The ids of what may change within modules unseen by the inventory: of tensors, and of modules if `is_restless`."""
        if modules not in self.reaches:
            self.reaches[modules] = reach_of(modules)
        return self.reaches[modules]


def reach_of(modules: Iterable[nn.Module]) -> frozenset[int]:
    """The ids of tensors and restless modules within modules, for `Inventory.reach`."""
    within = list(_held_by(modules, of_shapes=False))
    tensors = {id(tensor) for module in within for _, tensor in tensors_of(module)}
    return frozenset(tensors).union(id(module) for module in within if is_restless(module))


def is_restless(module: nn.Module) -> bool:
    """True if a module may compute something else while its attributes stay the same objects with the same numbers: it has
    parametrisations, or is a foreign module with lists or the like."""
    return parametrize.is_parametrized(module) or not (isinstance(module, (Plugin, ModuleTree)) or stands_still(module))


def _held_by(modules: Iterable[nn.Module], left_out: Collection[nn.Module] = (), of_shapes: bool = True
             ) -> Iterator[nn.Module]:
    """Iterates over modules and all modules in them: registered, shared with others, or in tuples.

    Args:
        modules: where to begin.
        left_out: a set of modules that are left out.
        of_shapes: include the materials, emitters and media of shapes, which are not part of their geometry.
    """
    ahead, met = list(modules), set()
    while ahead:
        module = ahead.pop()
        if module in met or module in left_out:
            continue
        met.add(module)
        yield module
        children = [child for child in module._modules.values() if child is not None]
        if isinstance(module, Plugin):
            children += module.shared.values()
            children += modules_among(tuple(vars(module).values()))
        ahead += [child for child in children
                  if of_shapes or not (isinstance(module, Shape) and isinstance(child, (BSDF, Emitter, Medium)))]


def modules_among(values: tuple) -> Iterator[nn.Module]:
    """The modules within nested tuples."""
    for value in values:
        if isinstance(value, tuple):
            yield from modules_among(value)
        elif isinstance(value, nn.Module):
            yield value


def tensors_of(module: nn.Module) -> Iterator[tuple[Hashable, Tensor]]:
    """The tensors that belong to a module itself, each with a key."""
    for attributes in dicts_of(module):
        for name, value in attributes.items():
            if isinstance(value, Tensor):
                yield (id(module), name), value
