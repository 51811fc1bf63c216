"""The cache that one rendering leaves for the next, so that packing a scene costs only what has changed.

A scene is packed anew for every rendering, because its parameters may have changed by an optimiser's step,
`torch.func.functional_call`, `torch.nn.utils.parametrize`, `load_state_dict`, or a write through `.data` or numpy. The last
leaves no trace on a tensor: neither its identity nor its version counter changes. So tensors are compared with copies, bit
by bit, which takes a small part of the time in which tables are made of them. All else follows from identity: what is made
of the same copies, by the same function, is the same object as last time.

Nothing here is ever written into, so that graphs and other threads may hold it.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Hashable, Iterable
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn.utils import parametrize

from torch_radbp.scene.cache.copies import Copies
from torch_radbp.scene.cache.inventory import Inventory
from torch_radbp.scene.cache.module_attributes import (
    OF_EVERY_MODULE,
    OFTEN,
    PLAIN,
    Attributes,
    assembled,
    attributes_of,
    children_of,
    frozen_dataclass,
    has_attributes,
    holder,
    is_constant,
    parametrized_names,
)
from torch_radbp.tensors.differentiated import differentiated


class Result(NamedTuple):
    """A cached function result with the function and arguments that it comes from."""

    key: tuple  # the function and tokens of the arguments
    arguments: tuple  # held, so that their ids are not given away
    value: Any


class Twin(NamedTuple):
    """A copy of a module, with the original attributes and tensors that it was made from."""

    attributes: Attributes
    tensors: tuple[tuple[Hashable, Tensor, Tensor], ...]  # the place, the original and the copy of each
    children: tuple[tuple[Hashable, nn.Module, Any], ...]  # the same of the modules in it
    made: Result


class CachedPart(NamedTuple):
    """A cached part of the packed scene, with the modules and parts that it was made from."""

    inventory: Inventory  # of the modules
    arguments: tuple
    value: Any
    cache: PackCache  # for the next time that it is computed
    fixed: frozenset[int]  # ids of the objects in it


class PackCache(Copies):
    """A cache of tensors and of results computed from them; an entry is valid while the scene's values are unchanged.

    Each rendering fills a new cache, and takes from that of the last rendering what still holds; the rest is forgotten.

    A copied or unpickled cache is empty.

    Args:
        last: the cache of the last rendering.
        around: the cache of the whole rendering, if this one is for a part of it.
    """

    def __init__(self, last: PackCache | None = None, around: PackCache | None = None):
        super().__init__(last, around)
        self.last_results = {} if last is None else last.results
        self.results: dict[tuple, Result] = {}
        self.last_parts: dict[Hashable, CachedPart] = {} if last is None else last.parts
        self.parts: dict[Hashable, CachedPart] = {}
        self.last_twins: dict[Hashable, Twin] = {} if last is None else last.twins
        self.twins: dict[Hashable, Twin] = {}
        # By id, with what stands for them in keys.
        self.last_constants: dict[int, tuple[Any, tuple]] = {} if last is None else last.constants
        self.constants: dict[int, tuple[Any, tuple]] = {}

    def __reduce__(self):
        return PackCache, ()

    def close(self) -> PackCache:
        """Ends the rendering: drops what only the comparison with the last one needed; returns the cache itself."""
        super().close()
        self.last_results, self.last_parts, self.last_twins, self.last_constants = {}, {}, {}, {}
        return self

    def __call__(self, make: Callable, *arguments, instead: Callable | None = None):
        """The result of `make(*arguments)`, cached if all arguments are plain values or objects from this cache.

        Args:
            make: a function of a module, whose result depends on nothing but the arguments.
            arguments: plain values, tensors, modules, and tuples of these; with others the result is computed anew.
            instead: computes the same in another way; None: `make` does.
        """
        result = self.result(make, arguments, instead)
        return (make(*arguments) if instead is None else instead()) if result is None else result.value

    def result(self, make: Callable, arguments: tuple, instead: Callable | None = None) -> Result | None:
        """The result of `make(*arguments)`, cached or computed; None if arguments may change without notice."""
        tokens = self.tokens(arguments)
        if tokens is None:
            return None
        key = (make, *tokens)
        result = self.results.get(key) or self.last_results.get(key)
        if result is None:
            with torch.inference_mode(False), torch.no_grad():
                result = Result(key, arguments, make(*arguments) if instead is None else instead())
        self.take_over(result)
        return result

    def knows(self, make: Callable, *arguments) -> bool:
        """True if `make(*arguments)` has been computed, and still holds."""
        tokens = self.tokens(arguments)
        return tokens is not None and ((make, *tokens) in self.results or (make, *tokens) in self.last_results)

    def take_over(self, result: Result) -> None:
        """Adds a result of the last rendering to this cache."""
        self.results[result.key] = result
        self.fix(result.value)

    def part(self, place: Hashable, make: Callable, root: nn.Module, reach: frozenset[int], *arguments):
        """The result of `make(cache, *arguments)`, or that of the last rendering if the arguments and every bit of their
        tensors are unchanged, and no tensor is differentiated.

        Args:
            place: the key of the part in the last rendering.
            make: a function whose result depends on nothing but the arguments. The cache that it gets is its own.
            root: holds the modules among the arguments.
            reach: the ids of what these modules depend on, as `Inventory.reach`; without differentiated tensors, if the
                result does not depend on their numbers.
            arguments: modules, results of `structure`, other parts, plain values.
        """
        inventory, cached = self.inventory(root), self.parts.get(place) or self.last_parts.get(place)
        if cached is None or cached.inventory is not inventory or not reach.isdisjoint(self.moved) or not all(
                map(operator.is_, cached.arguments, arguments)):
            own_cache = PackCache(None if cached is None else cached.cache, around=self)
            value = make(own_cache, *arguments)
            fixed = frozenset(own_cache.fixed - self.fixed)
            cached = CachedPart(inventory, arguments, value, own_cache.close(), fixed)
        self.parts[place] = cached
        self.fixed |= cached.fixed
        return cached.value

    def made(self, place: Hashable) -> Any:
        """A part of the packed scene as this rendering has computed it; `place`: its key."""
        return self.parts[place].value

    def made_last(self, place: Hashable) -> Any:
        """A part of the packed scene as the last rendering computed it; None: it had none. `place`: its key."""
        return self.last_parts[place].value if place in self.last_parts else None

    def twin(self, place: Hashable, thing):
        """A copy of a module or another object as it is now; the copy of the last rendering if nothing in it has changed.

        Tensors that are not differentiated are detached copies, and parametrisations are replaced by their values. Modules
        in it are copies, too. The copy of a shape lacks material and emitter, which are not part of its geometry.

        Args:
            place: the key of the object in the last rendering.
            thing: the original; its functions must depend on nothing but its attributes.
        """
        if not isinstance(thing, nn.Module):
            return self(assembled, type(thing), self.attributes_in_twin(place, vars(thing).items()), (), (), ())
        last = self.last_twins.get(place)
        if last is not None and self.still_holds(last, thing):
            self.twins[place] = last
            self.take_over(last.made)
            return last.made.value
        others = [(name, value) for name, value in vars(thing).items() if name not in OF_EVERY_MODULE and name != "shared"]
        parameters = [(name, self.read(thing, name)) for name in (*thing._parameters, *parametrized_names(thing))]
        attributes = others, parameters, list(thing._buffers.items()), children_of(thing)
        parts = tuple(self.attributes_in_twin(place, part) for part in attributes)
        made = self.result(assembled, (parametrize.type_before_parametrizations(thing), *parts))
        if made is None:
            return assembled(parametrize.type_before_parametrizations(thing), *parts)
        parts = [((place, name), value, in_copy) for of_thing, of_twin in zip(attributes, parts)
                 for (name, value), (_, in_copy) in zip(of_thing, of_twin)]
        tensors, children = (tuple(part for part in parts if isinstance(part[1], kind)) for kind in (Tensor, nn.Module))
        followed = all(in_copy is value or isinstance(value, (Tensor, nn.Module)) for _, value, in_copy in parts)
        if followed and not parametrized_names(thing):
            self.twins[place] = Twin(attributes_of(thing), tensors, children, made)
        return made.value

    def still_holds(self, twin: Twin, thing: nn.Module) -> bool:
        """True if a copy from the last rendering still equals its module."""
        return (type(thing) is twin.made.arguments[0] and has_attributes(thing, twin.attributes)
                and all(not differentiated(tensor) and self.frozen(place, tensor) is copy
                        for place, tensor, copy in twin.tensors)
                and all(self.twin(place, child) is copy for place, child, copy in twin.children))

    def attributes_in_twin(self, place: Hashable, named: Iterable[tuple[str, Any]]) -> tuple[tuple[str, Any], ...]:
        """The (name, value) pairs of a module's copy, from those of the original."""
        return tuple((name, self.in_twin((place, name), value)) for name, value in named)

    def in_twin(self, place: Hashable, value):
        """What a copied module holds for an attribute's value: a detached tensor, a copied module, or the same value."""
        if type(value) in OFTEN:
            return value
        if isinstance(value, Tensor):
            return value if differentiated(value) else self.frozen(place, value)
        if isinstance(value, nn.Module):
            return self.twin(place, value)
        if isinstance(value, tuple) and len(value) == 2 and isinstance(value[0], nn.Module) and isinstance(value[1], str):
            owner, name = value  # stands for this attribute of the owner, and nothing else of it
            return self(holder, name, self.in_twin((place, name), getattr(owner, name))), name
        return value

    def tokens(self, values: Iterable | None) -> tuple | None:
        """Hashable tokens for values in a cache key; None if one may change without notice, or there are no values."""
        tokens = []
        if values is None:
            return None
        for value in values:
            kind = type(value)
            if kind in OFTEN or isinstance(value, PLAIN):
                token = (value,)
            elif id(value) in self.fixed:
                token = id(value)
            elif isinstance(value, float):
                token = value.hex()  # 0.0 == -0.0
            elif frozen_dataclass(kind):
                token = self.constant(value)
            else:
                token = self.tokens(value if isinstance(value, tuple) else None)
            if token is None:
                return None
            tokens.append((kind, token))
        return tuple(tokens)

    def constant(self, value) -> tuple | None:
        """A hashable token for a frozen dataclass; None if it may change without notice."""
        cached = self.constants.get(id(value)) or self.last_constants.get(id(value))
        if cached is None:
            tokens = self.tokens(vars(value).values())
            if tokens is None:
                return None
            cached = value, tokens
            if not is_constant(value):
                return cached[1]
        self.constants[id(value)] = cached
        return cached[1]

    def fix(self, result) -> None:
        """Marks a result and its parts as unchanging, so that they may be cached arguments."""
        if isinstance(result, tuple):
            for part in result:
                self.fix(part)
        if not isinstance(result, (*PLAIN, float)):
            self.fixed.add(id(result))
