"""What one rendering leaves for the next, so that packing costs what has changed.

A scene is packed anew for every rendering, because its parameters may have changed by an optimiser's step,
`torch.func.functional_call`, `torch.nn.utils.parametrize`, `load_state_dict`, or a write through `.data` or numpy. The last
leaves no trace on a tensor: neither its identity nor its version counter changes. So tensors are compared with copies, bit
by bit, which takes a small part of the time in which tables are made of them. All else follows from identity: what is made
of the same copies, by the same function, is the same object as last time.

Nothing here is ever written into, so that graphs and other threads may hold it.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable, Collection, Hashable, Iterable
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn.utils import parametrize

from torch_radbp.plugin import Plugin
from torch_radbp.scene.module_attributes import (
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
    modules_in,
    replaced,
    stands_still,
)
from torch_radbp.scene.same_bits import bits_of, comparable, same_bits
from torch_radbp.tensors.differentiated import differentiated, primal


class Result(NamedTuple):
    """What a function gave."""

    key: tuple  # the function and what stands for the arguments
    arguments: tuple  # held, so that their ids are not given away
    value: Any


class Twin(NamedTuple):
    """A copy of a module, and what it is a copy of."""

    attributes: Attributes
    tensors: tuple[tuple[Hashable, Tensor, Tensor], ...]  # the place, the original and the copy of each
    children: tuple[tuple[Hashable, nn.Module, Any], ...]  # the same of the modules in it
    made: Result


class Structure(NamedTuple):
    """What a function makes of the attributes of some modules."""

    value: Any
    modules: list[tuple[nn.Module, Attributes]]


class PackCache:
    """Copies of tensors and what was made of them: found unchanged since the last rendering, or new.

    One rendering fills one of these, and takes from that of the last rendering what is still right. What it does not ask
    for is forgotten.

    A copied or unpickled one is empty.

    Args:
        last: of the last rendering.
    """

    def __init__(self, last: PackCache | None = None):
        self.last_copies, self.last_results = ({}, {}) if last is None else (last.copies, last.results)
        self.last_structures: dict[tuple, Structure] = {} if last is None else last.structures
        self.structures: dict[tuple, Structure] = {}
        self.last_twins: dict[Hashable, Twin] = {} if last is None else last.twins
        self.copies: dict[Hashable, Tensor] = {}
        self.results: dict[tuple, Result] = {}
        self.twins: dict[Hashable, Twin] = {}
        # By id, with what stands for them in keys.
        self.last_constants: dict[int, tuple[Any, tuple]] = {} if last is None else last.constants
        self.constants: dict[int, tuple[Any, tuple]] = {}
        self.seen: dict[int, tuple[Tensor, Tensor]] = {}  # tensors of this rendering and their copies
        self.places: dict[Hashable, weakref.ref[Tensor]] = {}  # of tensors that are not on the CPU
        self.last_places = {} if last is None else last.places
        self.unchanged: set[tuple[Hashable, int]] | None = None  # of `last_places`, found when first asked for
        self.fixed: set[int] = set()  # ids of the objects handed out

    def __reduce__(self):
        return PackCache, ()

    def close(self) -> PackCache:
        """Lets go of what only the last rendering needed."""
        self.last_copies, self.last_results, self.last_twins = {}, {}, {}
        self.last_structures, self.last_constants, self.seen, self.fixed = {}, {}, {}, set()
        self.last_places, self.unchanged = {}, None
        return self

    def __call__(self, make: Callable, *arguments):
        """`make(*arguments)`; or what that gave before, if all arguments are plain values or objects from here.

        Args:
            make: a function of a module, whose result depends on nothing but the arguments.
            arguments: plain values, tensors, modules, and tuples of these. Of others the result is made anew.
        """
        result = self.result(make, arguments)
        return make(*arguments) if result is None else result.value

    def result(self, make: Callable, arguments: tuple) -> Result | None:
        """What `make(*arguments)` gives now and gave before; None if arguments may change without notice."""
        tokens = self.tokens(arguments)
        if tokens is None:
            return None
        key = (make, *tokens)
        result = self.results.get(key) or self.last_results.get(key)
        if result is None:
            with torch.inference_mode(False), torch.no_grad():
                result = Result(key, arguments, make(*arguments))
        self.take_over(result)
        return result

    def take_over(self, result: Result) -> None:
        """Keeps a result for the next rendering."""
        self.results[result.key] = result
        self.fix(result.value)

    def structure(self, make: Callable, root: nn.Module, name: str = "", without: Collection[nn.Module] = ()):
        """`make(modules_in(root, name, without))`, or what that gave before if these modules have the very attributes they
        had then.

        Args:
            make: a function of modules and their names, whose result does not depend on what tensors contain.
            root: any module.
            name: of `root`.
            without: a set of modules that are left out with all that is in them.
        """
        known = self.last_structures.get((make, name))
        if known is None or known.modules[0][0] is not root or not all(
                has_attributes(module, attributes) for module, attributes in known.modules):
            named = modules_in(root, name, without)
            value, modules = make(named), [module for _, module in named]
            if not all(stands_still(module) for module in modules if isinstance(module, Plugin)):
                return value
            known = Structure(value, [(module, attributes_of(module)) for module in modules])
        self.structures[make, name] = known
        return known.value

    def frozen(self, place: Hashable, tensor: Tensor) -> Tensor:
        """A detached copy of a tensor; the same object as last time if not a bit has changed.

        Args:
            place: tells which tensor of the last rendering to compare with.
            tensor: any.
        """
        if id(tensor) in self.fixed:
            return tensor
        if id(tensor) not in self.seen:
            copy = self.last_copies.get(place)
            if not self.known_unchanged(place, tensor) and (copy is None or not same_bits(copy, tensor)):
                with torch.inference_mode(False), torch.no_grad():
                    copy = primal(tensor).clone(memory_format=torch.contiguous_format)
            self.seen[id(tensor)] = tensor, copy
            self.copies[place] = copy
            self.fixed.add(id(copy))
        return self.seen[id(tensor)][1]

    def known_unchanged(self, place: Hashable, tensor: Tensor) -> bool:
        """True if all tensors of the last rendering have been compared together, and this one has not changed.

        To ask a device for one answer takes as long as to ask it for many; on the CPU each is compared when its turn comes.
        """
        if tensor.is_cpu:
            return False
        self.places[place] = weakref.ref(tensor)
        if self.unchanged is None:
            self.unchanged = unchanged(self.last_places, self.last_copies)
        return (place, id(tensor)) in self.unchanged

    def twin(self, place: Hashable, thing):
        """A copy of a module, or of another object, as it is now; the same one as last time if nothing in it has changed.

        It has frozen tensors where those of the original are not differentiated, and the values of parametrisations instead
        of these. Modules in it are twins, too. That of a shape lacks material and emitter, which say nothing of its
        geometry.

        Args:
            place: tells which object of the last rendering to compare with.
            thing: its functions must depend on nothing but its attributes.
        """
        if not isinstance(thing, nn.Module):
            return self(assembled, type(thing), self.parts(place, vars(thing).items()), (), (), ())
        last = self.last_twins.get(place)
        if last is not None and self.still_holds(last, thing):
            self.twins[place] = last
            self.take_over(last.made)
            return last.made.value
        others = [(name, value) for name, value in vars(thing).items() if name not in OF_EVERY_MODULE and name != "shared"]
        parameters = [(name, getattr(thing, name)) for name in (*thing._parameters, *replaced(thing))]
        own = others, parameters, list(thing._buffers.items()), children_of(thing)
        parts = tuple(self.parts(place, part) for part in own)
        made = self.result(assembled, (parametrize.type_before_parametrizations(thing), *parts))
        if made is None:
            return assembled(parametrize.type_before_parametrizations(thing), *parts)
        parts = [((place, name), value, found) for of_thing, of_twin in zip(own, parts)
                 for (name, value), (_, found) in zip(of_thing, of_twin)]
        tensors, children = (tuple(part for part in parts if isinstance(part[1], kind)) for kind in (Tensor, nn.Module))
        followed = all(found is value or isinstance(value, (Tensor, nn.Module)) for _, value, found in parts)
        if followed and not replaced(thing):
            self.twins[place] = Twin(attributes_of(thing), tensors, children, made)
        return made.value

    def still_holds(self, twin: Twin, thing: nn.Module) -> bool:
        """True if a twin of the last rendering is a twin of a module as it is now."""
        return (type(thing) is twin.made.arguments[0] and has_attributes(thing, twin.attributes)
                and all(not differentiated(tensor) and self.frozen(place, tensor) is copy
                        for place, tensor, copy in twin.tensors)
                and all(self.twin(place, child) is copy for place, child, copy in twin.children))

    def parts(self, place: Hashable, named: Iterable[tuple[str, Any]]) -> tuple[tuple[str, Any], ...]:
        """What the attributes of a twin are, from those of the original."""
        return tuple((name, self.part((place, name), value)) for name, value in named)

    def part(self, place: Hashable, value):
        """What stands in a twin for an attribute."""
        if type(value) in OFTEN:
            return value
        if isinstance(value, Tensor):
            return value if differentiated(value) else self.frozen(place, value)
        if isinstance(value, nn.Module):
            return self.twin(place, value)
        if isinstance(value, tuple) and len(value) == 2 and isinstance(value[0], nn.Module) and isinstance(value[1], str):
            owner, name = value  # stands for this attribute of the owner, and nothing else of it
            return self(holder, name, self.part((place, name), getattr(owner, name))), name
        return value

    def tokens(self, values: Iterable | None) -> tuple | None:
        """What stands for some values in a key, or None if one may change without notice, or there are none."""
        found = []
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
            found.append((kind, token))
        return tuple(found)

    def constant(self, value) -> tuple | None:
        """What stands for a frozen dataclass in a key; None if it may change without notice."""
        known = self.constants.get(id(value)) or self.last_constants.get(id(value))
        if known is None:
            tokens = self.tokens(vars(value).values())
            if tokens is None:
                return None
            known = value, tokens
            if not is_constant(value):
                return known[1]
        self.constants[id(value)] = known
        return known[1]

    def fix(self, result) -> None:
        """Notes that a result and its parts will not change."""
        if isinstance(result, tuple):
            for part in result:
                self.fix(part)
        if not isinstance(result, (*PLAIN, float)):
            self.fixed.add(id(result))


def unchanged(places: dict[Hashable, weakref.ref[Tensor]], copies: dict[Hashable, Tensor]) -> set[tuple[Hashable, int]]:
    """The places, with the ids of tensors that are still there with the bits of their copies; all are compared at once."""
    there = [(place, tensor, copies[place]) for place, found in places.items() if (tensor := found()) is not None]
    there = [each for each in there if comparable(*each[1:])]
    if not there:
        return set()
    same = torch.stack([(bits_of(tensor) == bits_of(copy)).all() for _, tensor, copy in there]).tolist()
    return {(place, id(tensor)) for (place, tensor, _), equal in zip(there, same) if equal}
