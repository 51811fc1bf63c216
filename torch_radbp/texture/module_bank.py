"""Modules as textures, evaluated in batches of the lanes that need their values.

Between its layers a module writes and reads some hundred numbers for each place. Of a hundred thousand places at once they
go to memory and come back: an MLP 2-64-64-3 then takes three times as long as on batches whose numbers stay in the cache of
a core (`python -m benchmarks.networks`). So a queue of lanes is computed batch by batch, and its batches side by side.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from threading import get_ident
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.tensors.partition import lengths, sorted_by_torch
from torch_radbp.tensors.vec import Vec2, Vec3, rows
from torch_radbp.texture.module_function import ModuleFunction
from torch_radbp.threads.team import each, threads

BATCH = 1 << 12  # places, on the CPU; fewer, and calls from Python take a part of the time
PARAMETERS = 64  # a place, of a batch that is differentiated at the most: each batch has a gradient of all of them


class ModuleBatch(NamedTuple):
    """A batch of lanes on which one module runs: a part of `Sorted.order`."""

    module: int
    first: int
    last: int  # end: one past its last lane


class Sorted(NamedTuple):
    """Lanes sorted by module, lanes without a module first."""

    order: Tensor | None  # (N,) int32; None: they are sorted already
    batches: list[ModuleBatch]

    def part(self, channels: Sequence[Tensor], batch: ModuleBatch) -> Tensor:
        """(M, C) the values of a batch of lanes in C channels, (N,) each."""
        here = slice(batch.first, batch.last)
        if self.order is None:
            return torch.stack([channel[here] for channel in channels], 1)
        return torch.stack(rows(tuple(channels), self.order[here]), 1)

    def back(self, columns: Tensor) -> Tensor:
        """Permutes columns, (..., N), from the sorted order back to the original order."""
        if self.order is None:
            return columns
        order = self.order.long()
        return columns.index_select(-1, torch.empty_like(order).scatter_(0, order, torch.arange(len(order)).to(order)))


class ModuleCopies:
    """Copies of modules with other parameters, one for each thread, made at first use.

    Args:
        functions: of modules.
        parameters: of each, in the module's order.
    """

    def __init__(self, functions: Sequence[ModuleFunction], parameters: Sequence[Sequence[Tensor]]):
        self.functions, self.parameters = functions, parameters
        self.made: dict[tuple[int, int], ModuleFunction] = {}

    def of(self, module: int) -> ModuleFunction:
        """This thread's copy of the module with a given index."""
        key = module, get_ident()
        if key not in self.made:
            self.made[key] = self.functions[module].with_parameters(self.parameters[module])
        return self.made[key]


class ModuleBank(NamedTuple):
    """Modules as textures, with the parameters by which they are differentiated."""

    functions: tuple[ModuleFunction, ...]
    parameters: tuple[tuple[Tensor, ...], ...]  # of each; attached

    def values(self, row: Tensor, at: Vec2 | Vec3, lanes: Sorted | None = None) -> Vec3:
        """(N,) values of the modules at the lanes' points, attached. Each module runs on its own lanes.

        Args:
            row: (N,) int32, which of the modules gives each lane its value; -1: none, and the value is 0.
            at: (N,) where.
            lanes: what `sorted` returns for them, if already known.
        """
        functions = ModuleCopies(self.functions, self.parameters)

        def of_batch(module: int, place: Tensor) -> Tensor:
            return functions.of(module)(place)

        return Vec3(*self.per_batch(lanes or self.sorted(row), at, of_batch, (3,)))

    def values_and_slopes(self, row: Tensor, at: Vec2 | Vec3, lanes: Sorted | None = None) -> tuple[Vec3, ...]:
        """(N,) values, and their derivatives by each coordinate of the points; detached. Args as for `values`.

        Each value must depend on its own place only.
        """
        functions = ModuleCopies(self.functions, [[parameter.detach() for parameter in each] for each in self.parameters])

        def of_batch(module: int, place: Tensor) -> Tensor:
            place = place.detach().requires_grad_()
            with torch.enable_grad():
                values = functions.of(module)(place)
            return torch.stack([values.detach(), *_slopes(values, place)], 1)

        return tuple(Vec3(*part) for part in self.per_batch(lanes or self.sorted(row), at, of_batch, (1 + len(at), 3)))

    def gradients(self, wanted: Sequence[Sequence[bool]], row: Tensor, at: Vec2 | Vec3,
                  adjoint: Vec3) -> Iterator[tuple[int, int, Tensor]]:
        """The gradients of parameters: module, number of the parameter, and its gradient, float64.

        Args:
            wanted: for each parameter of each module, whether its gradient is wanted.
            row, at: as for `values`.
            adjoint: (N,) the adjoints of the values; modules run where they are not 0.
        """
        row = torch.where((adjoint.x != 0) | (adjoint.y != 0) | (adjoint.z != 0), row, -1)
        leaves_of_modules = [[parameter.detach().requires_grad_(want) for parameter, want in zip(*pair)]
                             for pair in zip(self.parameters, wanted)]
        leaves = [[parameter for parameter in parameters if parameter.requires_grad] for parameters in leaves_of_modules]
        lanes, functions = self.sorted(row, PARAMETERS), ModuleCopies(self.functions, leaves_of_modules)

        def of_batch(batch: ModuleBatch) -> Sequence[Tensor | None]:
            with torch.enable_grad():
                values = functions.of(batch.module)(lanes.part(at, batch), checked=True)
            if not values.requires_grad:
                return [None for _ in leaves[batch.module]]
            return torch.autograd.grad(values, leaves[batch.module], lanes.part(adjoint, batch), allow_unused=True)

        batches = [batch for batch in lanes.batches if leaves[batch.module]]
        gradients_of_batches = each(of_batch, batches, threads_for(row))
        for module, wants in enumerate(wanted):
            numbers = [number for number, want in enumerate(wants) if want]
            of_batches = [gradients for batch, gradients in zip(batches, gradients_of_batches) if batch.module == module]
            for number, parts in zip(numbers, zip(*of_batches)):
                parts = [part for part in parts if part is not None]
                if parts:
                    yield module, number, torch.stack(parts).sum(0, dtype=torch.float64)

    def per_batch(self, lanes: Sorted, at: Vec2 | Vec3, of_batch: Callable[[int, Tensor], Tensor],
                  shape: tuple[int, ...]) -> Tensor:
        """(*shape, N) results of `of_batch` for each lane, batch by batch; 0 for lanes of no module.

        Args:
            lanes: of `sorted`.
            at: as for `values`.
            of_batch: from a module and M places, (M, 2) or (M, 3), to (M, *shape).
        """
        def columns(batch: ModuleBatch) -> Tensor:
            return of_batch(batch.module, lanes.part(at, batch)).movedim(0, -1).contiguous()

        nothing = lanes.batches[0].first if lanes.batches else len(at[0])
        none = [at[0].new_zeros(*shape, nothing)] if nothing or not lanes.batches else []
        parts = [*none, *each(columns, lanes.batches, threads_for(at[0]))]
        return lanes.back(parts[0] if len(parts) == 1 else torch.cat(parts, -1))

    def sorted(self, row: Tensor, parameters: float = torch.inf) -> Sorted:
        """Sorts lanes by module, and divides them into batches.

        Args:
            row: as for `values`.
            parameters: the most parameters of a module for each place of a batch, which limits the number of batches.
        """
        order, ends = sorted_by_torch(row + 1, len(self.functions) + 1)
        return self.divided(row, order, ends.tolist(), parameters)

    def divided(self, row: Tensor, order: Tensor, ends: Sequence[int], parameters: float = torch.inf) -> Sorted:
        """Divides lanes into batches; `order`, `ends`: as `sorted_by_torch` returns them, the other args as for `sorted`."""
        counts = lengths(ends)
        batches, first = [], counts[0]
        for module, count in enumerate(counts[1:]):
            size, last = length_of_batches(count, self.size(module, row.device, parameters)), first + count
            batches += [ModuleBatch(module, start, min(start + size, last)) for start in range(first, last, size)]
            first = last
        return Sorted(None if len(row) in counts else order, batches)

    def size(self, module: int, device: torch.device, parameters: float = PARAMETERS) -> float:
        """The greatest number of places in a batch of a module; args as for `sorted`."""
        if device.type != "cpu":
            return torch.inf
        return max(BATCH, sum(map(Tensor.numel, self.parameters[module])) / parameters)


def length_of_batches(count: int, most: float) -> int:
    """The size of the batches (but perhaps the last) into which so many lanes are divided.

    They are equally long, and an even number of them if there are several, or one alone that is long: two threads then have
    equally much to do. The number of threads itself must not matter, for sums of gradients would be other ones.

    Args:
        most: the number of places in a batch.
    """
    if 2 * count <= most:
        return max(1, count)
    return -(-count // (2 * -(-count // int(2 * most))))


def threads_for(lanes: Tensor) -> int:
    """The number of threads that evaluate batches: one for those on a GPU, which knows their streams."""
    return threads() if lanes.is_cpu else 1


def _slopes(values: Tensor, place: Tensor) -> list[Tensor]:
    """The derivatives, (N, 3) each and detached, of values by each coordinate of the points.

    Args:
        values: (N, 3).
        place: (N, D).
    """
    if not values.requires_grad:
        return [torch.zeros_like(values) for _ in range(place.shape[1])]
    slopes = [torch.autograd.grad(values, place, channel.expand_as(values), retain_graph=True, allow_unused=True)[0]
              for channel in torch.eye(values.shape[1]).to(values)]
    of_channel = [torch.zeros_like(place) if slope is None else slope for slope in slopes]
    return list(torch.stack(of_channel, 2).unbind(1))
