"""Copies of all tensors of a rendering, with which the next one compares its own to see what has changed."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Hashable, Sequence
from typing import Any

import torch
from torch import Tensor, nn

from torch_radbp.scene.cache.inventory import Inventory
from torch_radbp.scene.cache.module_attributes import parametrized_names
from torch_radbp.scene.cache.same_bits import comparable, differing_bytes, equal_on_device, same_bits, same_bits_each
from torch_radbp.tensors.asked_later import mistaken_if_any, presuming
from torch_radbp.tensors.differentiated import asks_for_derivatives, differentiated, primal


class Copies:
    """Detached copies of tensors and inventories of modules, taken from the last rendering where nothing has changed.

    Args:
        last: the copies of the last rendering.
        around: the copies of the whole rendering, if these are for a part of it; inventories are shared.
    """

    def __init__(self, last: Copies | None = None, around: Copies | None = None):
        self.last_copies: dict[Hashable, Tensor] = {} if last is None else last.copies
        self.copies: dict[Hashable, Tensor] = {}
        # Tensors of this rendering and their copies.
        self.seen: dict[int, tuple[Tensor, Tensor]] = {} if around is None else around.seen
        self.fixed: set[int] = set() if around is None else set(around.fixed)  # ids of objects that will not change
        self.places: dict[Hashable, weakref.ref[Tensor]] = {}  # of tensors that are not on the CPU
        self.last_places = {} if last is None else last.places
        # Of tensors that are not on the CPU, by their ids, how often torch knows that somebody has written into them.
        self.versions: dict[int, tuple[weakref.ref[Tensor], int]] = {} if around is None else around.versions
        self.last_versions = around.last_versions if around is not None else {} if last is None else last.versions
        # Whether tensors of a device are as they were in the last rendering, by places and ids; found when first asked for.
        self.compared: dict[tuple[Hashable, int], bool] | None = None
        self.numbers: dict[int, list[float]] = {}  # that were fetched meanwhile, by ids of tensors
        self.last_inventories: dict[int, Inventory] = {} if last is None or around is not None else last.inventories
        self.inventories: dict[int, Inventory] = {} if around is None else around.inventories  # by the ids of their roots
        # Results of parametrisations, by owner, name, and whether autograd records; and whether they are differentiated.
        self.computed: dict[tuple[int, str, bool], Tensor] = {} if around is None else around.computed
        self.live: dict[tuple[int, str, bool], bool] = {} if around is None else around.live
        self.moved: set[int] = set() if around is None else around.moved  # as of `Inventory.reach`, what is not as it was

    def close(self) -> Copies:
        """Ends the rendering: drops what only the comparison with the last one needed; returns the object itself."""
        self.last_copies, self.last_places, self.last_inventories, self.compared = {}, {}, {}, None
        self.last_versions = {}
        self.numbers = {}
        self.seen, self.fixed, self.moved, self.computed = {}, set(), set(), {}
        self.inventories = {root: inventory for root, inventory in self.inventories.items() if inventory.lasts}
        return self

    def read(self, owner: nn.Module, name: str) -> Any:
        """The value of a module's attribute, None if it has none; a parametrisation is evaluated once."""
        if name not in parametrized_names(owner):
            return getattr(owner, name, None)
        key = id(owner), name, torch.is_grad_enabled()
        if key not in self.computed:
            self.computed[key] = getattr(owner, name)
            self.live[key] = differentiated(self.computed[key])
        return self.computed[key]

    def is_live(self, owner: nn.Module, name: str) -> bool:
        """True if an attribute of a module is a differentiated tensor; also when the cache is closed."""
        known = self.live.get((id(owner), name, torch.is_grad_enabled()))
        return asks_for_derivatives(getattr(owner, name, None)) if known is None else known

    def inventory(self, root: nn.Module) -> Inventory:
        """The lists of all tensors and modules within a module; the object of the last rendering if they still hold."""
        inventory = self.inventories.get(id(root))
        if inventory is None:
            last = self.last_inventories.get(id(root))
            inventory = last if last is not None and last.holds(root) else Inventory(root)
            self.inventories[id(root)] = inventory
            self.moved |= inventory.live | inventory.restless
            for tensor in inventory.away:
                self.note_version(tensor)
            if inventory.away and self.compared is None:  # the first, of all that is rendered
                self.compare([], inventory.away)
            self.freeze(inventory)
        return inventory

    def freeze(self, inventory: Inventory) -> None:
        """Copies the tensors of an inventory that are not differentiated, or keeps the copies where values are unchanged."""
        left = [(place, tensor) for place, tensor in inventory.settled if id(tensor) not in self.seen]
        if self.is_as_it_was(inventory.root) and all(tensor.is_cpu and place in self.last_copies for place, tensor in left):
            copies = [self.last_copies[place] for place, _ in left]
            equal = same_bits_each([tensor for _, tensor in left], copies)
            for (place, tensor), copy, unchanged in zip(left, copies, equal):
                if unchanged:
                    self.copies[place], self.seen[id(tensor)] = copy, (tensor, copy)
                    self.fixed.add(id(copy))
            left = [each for each, unchanged in zip(left, equal) if not unchanged]
        for place, tensor in left:
            if self.frozen(place, tensor) is not self.last_copies.get(place):
                self.moved.add(id(tensor))

    def is_as_it_was(self, root: nn.Module) -> bool:
        """True if a module holds the same objects as in the last rendering, whatever the values of tensors are."""
        return self.last_inventories.get(id(root)) is self.inventory(root)

    def structure(self, make: Callable, root: nn.Module, *arguments: Hashable):
        """`make(root, *arguments)`, cached for as long as the module holds the very same objects.

        Args:
            make: a function whose result depends on neither the numbers in tensors nor anything else that changes.
            root: any module.
            arguments: any others.
        """
        results, key = self.inventory(root).results, (make, *arguments)
        if key not in results:
            results[key] = make(root, *arguments)
        return results[key]

    def facts(self, root: nn.Module) -> dict[Hashable, Any]:
        """A dict for what is derived from a module's attributes; it is emptied when an attribute changes."""
        inventory = self.inventories.get(id(root))
        return {} if inventory is None else inventory.results

    def frozen(self, place: Hashable, tensor: Tensor) -> Tensor:
        """A detached copy of a tensor; the same object as in the last rendering if not a bit has changed.

        Args:
            place: tells which tensor of the last rendering to compare with.
            tensor: any.
        """
        if id(tensor) in self.fixed:
            return tensor
        if id(tensor) not in self.seen:
            copy, known = self.last_copies.get(place), self.known(place, tensor)
            if copy is None or not (same_bits(copy, tensor) if known is None else known):
                with torch.inference_mode(False), torch.no_grad():
                    copy = primal(tensor).clone(memory_format=torch.contiguous_format)
            self.seen[id(tensor)] = tensor, copy
            self.copies[place] = copy
            self.fixed.add(id(copy))
        return self.seen[id(tensor)][1]

    def known(self, place: Hashable, tensor: Tensor) -> bool | None:
        """Whether a tensor equals its copy from the last rendering, as `compare` has found; None: not compared."""
        if tensor.is_cpu:
            return None
        if self.compared is None:
            self.compare([(place, tensor)])
        self.places[place] = weakref.ref(tensor)
        self.note_version(tensor)
        assert self.compared is not None
        return self.compared.get((place, id(tensor)))

    def note_version(self, tensor: Tensor) -> None:
        """Notes torch's version counter of a tensor, which counts in-place writes."""
        if not tensor.is_inference():
            self.versions[id(tensor)] = weakref.ref(tensor), tensor._version

    def untouched(self, tensor: int | Tensor) -> bool | None:
        """True if torch's version counter of a tensor, given itself or by its id, is unchanged since the last rendering,
        False if it has changed; None: the tensor is new."""
        number = tensor if isinstance(tensor, int) else id(tensor)
        now, last = self.versions.get(number), self.last_versions.get(number)
        if isinstance(tensor, Tensor) and now is None and not tensor.is_inference():
            now = weakref.ref(tensor), tensor._version
        if now is None or last is None or now[0]() is None or now[0]() is not last[0]():
            return None
        return now[1] == last[1]

    def presume(self, place: Hashable, tensor: Tensor, reach: frozenset[int]) -> None:
        """Presumes that a device tensor equals its last copy, which is verified later, or knows that it has changed.

        Args:
            place, tensor: as of `frozen`.
            reach: the ids of what it is computed from, as `Inventory.reach`.
        """
        copy, moved = self.last_copies.get(place), [self.untouched(number) for number in reach & self.moved]
        if tensor.is_cpu or not presuming() or None in moved or copy is None or not comparable(tensor, copy):
            return
        if self.compared is None:
            self.compare([])
        assert self.compared is not None
        self.compared[place, id(tensor)] = all(moved)
        if all(moved):
            mistaken_if_any(differing_bytes([tensor], [copy]))

    def compare(self, tensors: Sequence[tuple[Hashable, Tensor]], asked: Sequence[Tensor] = ()) -> None:
        """Compares tensors of a device with their copies from the last rendering, with a single wait for the device.

        One wait for a device takes as long as many answers; CPU tensors are compared one by one, when they are needed.
        Tensors whose version counter is unchanged are presumed equal, if that may be verified later.

        Args:
            tensors: pairs of a key, as for `frozen`, and a tensor.
            asked: tensors whose numbers are fetched into `numbers` as well, unless all is verified later.
        """
        found = [each for each in tensors if not each[1].is_cpu and (each[0], id(each[1])) not in (self.compared or {})]
        if self.compared is None:
            self.compared = {}
            found += [(place, tensor) for place, reference in self.last_places.items()
                      if (tensor := reference()) is not None]
        pairs = {(place, id(tensor)): (tensor, self.last_copies[place]) for place, tensor in found
                 if place in self.last_copies and comparable(tensor, self.last_copies[place])}
        self.compared |= {key: True for key, (tensor, _) in pairs.items() if not tensor.numel()}
        if presuming():
            steady = {key: pair for key, pair in pairs.items() if key not in self.compared and self.untouched(pair[0])}
            if steady:
                mistaken_if_any(differing_bytes(*zip(*steady.values())))
            asked, self.compared = (), self.compared | dict.fromkeys(steady, True)
        pairs = {key: pair for key, pair in pairs.items() if key not in self.compared}
        there, copies = zip(*pairs.values()) if pairs else ((), ())
        equal, numbers = equal_on_device(there, copies, asked)
        self.compared |= zip(pairs, equal)
        self.numbers |= zip(map(id, asked), numbers)
