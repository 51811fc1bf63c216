"""Takes the arguments of a call apart: tensors with their kinds, and the structure that code is compiled for.

Calls with few lanes come by the hundred. So arguments of a structure that has been met are taken apart by a function that is
written for it.
"""

from __future__ import annotations

import itertools
import operator
from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from torch_radbp.jit.lane.graph import LANES, NUMBER, TABLE
from torch_radbp.jit.recording.structure import flatten, unpacker

MOST_FORMS = 64  # that are looked through
MOST_COLUMNS = 64  # of a table in rows; what lies farther apart is copied

# Structures have the same number wherever they stand, so that an argument that is taken apart fits every function.
NUMBERS: dict[tuple, int] = {}
FORMS: dict[tuple, Form] = {}  # by structure, types of the tensors, whether these are tables, and which are columns
counter = itertools.count()


class Form:
    """The structure of one argument, with a generated function that extracts its tensors.

    Args:
        argument: one with this structure.
        leaves: its tensors.
        structure: its key by `flatten`.
        number: identifies the structure together with the layout of columns.
        table: whether tensors of shape (N,) are tables.
        columns: the layouts by `_columns_of`.
    """

    __slots__ = ("structure", "number", "table", "columns", "unpack", "types", "dtypes", "itemsizes", "dimensions", "kinds",
                 "lanes")

    def __init__(self, argument: Any, leaves: Sequence[Tensor], structure: tuple, number: int, table: bool,
                 columns: tuple[Column | None, ...]):
        self.structure, self.number, self.table, self.unpack = structure, number, table, unpacker(argument)
        self.columns = columns
        self.types, self.dtypes = list(map(type, leaves)), [leaf.dtype for leaf in leaves]
        self.itemsizes = [leaf.itemsize for leaf in leaves]
        self.dimensions = [leaf.dim() for leaf in leaves]
        self.kinds = [NUMBER if dimensions == 0 else TABLE if table else LANES for dimensions in self.dimensions]
        self.lanes = [place for place, kind in enumerate(self.kinds) if kind == LANES]

    def tensors(self, argument: Any) -> Sequence[Tensor] | None:
        """The tensors of an argument; None if it has another structure or memory layout."""
        leaves = self.unpack(argument)
        same = (leaves is not None and list(map(type, leaves)) == self.types
                and [leaf.dtype for leaf in leaves] == self.dtypes and [leaf.dim() for leaf in leaves] == self.dimensions
                and (not self.table or _columns_of(leaves) == self.columns))
        return leaves if same else None


class Parameter:
    """A parameter of a function, with the structures that its arguments have had so far.

    Args:
        function: its name, for errors.
        table: whether tensors of shape (N,) in it are tables.
    """

    def __init__(self, function: str, table: bool):
        self.function, self.table = function, table
        # Calls come in turns, one for each kind of what is met: after the last form, the next is the likeliest.
        self.ring: tuple[Form, ...] = ()
        self.place = 0  # of the last that was met

    def take_apart(self, argument: Any) -> tuple[Form, Sequence[Tensor]]:
        """The structure of an argument, and its tensors.

        Raises:
            ValueError: if a tensor has neither shape () nor (N,).
        """
        ring, first = self.ring, self.place
        for step, form in enumerate((*ring[first:], *ring[:first])):
            leaves = form.tensors(argument)
            if leaves is not None:
                if step:
                    self.place = (first + step) % len(ring)
                return form, leaves
        leaves, items = [], []
        flatten(argument, leaves, items)
        for leaf in leaves:
            if leaf.dim() > 1:
                raise ValueError(f"{self.function} takes tensors of shape () and (N,), got {tuple(leaf.shape)}")
        structure, types, columns = tuple(items), tuple(map(type, leaves)), _columns_of(leaves) if self.table else ()
        key = structure, types, self.table, columns
        form = FORMS.get(key)
        if form is None:
            number = NUMBERS.setdefault((structure, columns), next(counter))
            form = FORMS.setdefault(key, Form(argument, leaves, structure, number, self.table, columns))
        self.ring, self.place = (form, *ring[first:], *ring[:first])[:MOST_FORMS], 0
        return form, leaves


class Column(NamedTuple):
    """The layout of a table that is one column of interleaved rows (`tensors/interleaved.py`)."""

    block: int  # index of the rows, among those of an argument
    width: int  # entries per row
    place: int  # index of the column in a row


def _columns_of(leaves: Sequence[Tensor]) -> tuple[Column | None, ...]:
    """For each table its column layout, None if it is contiguous; () if all are."""
    if all([leaf.is_contiguous() for leaf in leaves]):
        return ()
    blocks: dict[tuple[int, int, int], int] = {}
    found = tuple([column_of(leaf, blocks) for leaf in leaves])
    return found if any(found) else ()


def column_of(leaf: Tensor, blocks: dict[tuple[int, int, int], int]) -> Column | None:
    """The column layout of a table; None if it is contiguous, or its rows are too long or incomplete.

    Args:
        leaf: any tensor.
        blocks: numbers of the blocks of rows met so far, by memory address, first row in it and width; added to.
    """
    if leaf.is_contiguous() or leaf.dim() != 1 or leaf.itemsize != 4 or leaf.data_ptr() % 4:
        return None
    width, offset, memory = leaf.stride(0), leaf.storage_offset(), leaf.untyped_storage()
    place = offset % max(1, width)
    end = offset - place + len(leaf) * width
    if not 1 < width <= MOST_COLUMNS or 4 * end > memory.nbytes() or end >= 1 << 31:
        return None
    return Column(blocks.setdefault((memory.data_ptr(), offset - place, width), len(blocks)), width, place)


class PreparedArgument:
    """An argument split into its tensors and structure, for one call or for several with the very same object.

    Args:
        parameter: to which it belongs. It then fits parameters of any function that hold tables, or lanes, as this does.
        argument: nested tuples and lists of tensors, and of anything hashable.

    Raises:
        ValueError: if tensors of lanes differ in length, or a tensor has another device or shape.
        RuntimeError: if tensors require grad while gradients are recorded.
    """

    __slots__ = ("argument", "form", "leaves", "read", "pointers", "sizes", "lanes", "device")

    def __init__(self, parameter: Parameter, argument: Any):
        self.argument = argument
        self.form, self.leaves = parameter.take_apart(argument)
        self.device = self.checked_device(parameter)
        self.read = self.leaves  # whose memory is read
        self.pointers, self.sizes = [leaf.data_ptr() for leaf in self.leaves], [leaf.numel() for leaf in self.leaves]
        if not all([leaf.is_contiguous() for leaf in self.leaves]) or any(
                map(operator.mod, self.pointers, self.form.itemsizes)):
            columns = self.form.columns or itertools.repeat(None)
            self.read = tuple([laid_out(leaf) if column is None else leaf for leaf, column in zip(self.leaves, columns)])
            self.pointers = [leaf.data_ptr() for leaf in self.read]
        self.lanes = self.sizes[self.form.lanes[0]] if self.form.lanes else None
        for place in self.form.lanes:
            if self.sizes[place] != self.lanes:
                raise unequal(parameter, self.lanes, self.sizes[place])

    def checked_device(self, parameter: Parameter) -> torch.device | None:
        """The device of the tensors, None if there are none; raises if they lie on several, or one would need a gradient."""
        if torch.is_grad_enabled() and any([leaf.requires_grad for leaf in self.leaves]):
            raise RuntimeError(f"{parameter.function} is compiled and records no derivative: call it under "
                               "torch.no_grad(), or with detached tensors")
        if not self.leaves:
            return None
        device = self.leaves[0].device
        same = all([leaf.is_cpu for leaf in self.leaves]) if device.type == "cpu" else (
            device.type == "cuda" and all([leaf.device == device for leaf in self.leaves]))
        if not same:
            raise elsewhere(parameter, device, next((leaf.device for leaf in self.leaves if leaf.device != device), device))
        return device


def laid_out(leaf: Tensor) -> Tensor:
    """The tensor if it is contiguous and aligned, else a copy that is."""
    whole = leaf.contiguous()
    return whole if whole.data_ptr() % whole.itemsize == 0 else whole.clone()


def unequal(parameter: Parameter, lanes: int, others: int) -> ValueError:
    """The error about tensors with different numbers of lanes."""
    return ValueError(f"{parameter.function} got tensors of {lanes} and of {others} lanes")


def elsewhere(parameter: Parameter, device: torch.device, other: torch.device) -> ValueError:
    """The error about tensors on two devices, or on one without a compiler."""
    return ValueError(f"{parameter.function} is compiled for tensors that lie all on the CPU or all on one GPU, "
                      f"got one on {device} and one on {other}")


class Arguments:
    """The arguments of one call (or its first ones), split into tensors and structures.

    Args:
        parameters: of the function, those that the arguments belong to.
        arguments: each as it is, or `PreparedArgument`.
        known: the arguments that come before these, already taken apart.

    Raises:
        ValueError, RuntimeError: as for `PreparedArgument`.
    """

    __slots__ = ("given", "forms", "leaves", "read", "pointers", "sizes", "lanes", "shared", "device", "addresses")

    def __init__(self, parameters: Sequence[Parameter], arguments: Sequence, known: Arguments | None = None):
        parts = [argument if type(argument) is PreparedArgument else PreparedArgument(parameter, argument)
                 for parameter, argument in zip(parameters, arguments)]
        assert all([part.form.table == parameter.table for part, parameter in zip(parts, parameters)])
        self.given, self.forms = [part.argument for part in parts], [part.form for part in parts]
        self.lanes, self.device = (None, None) if known is None else (known.lanes, known.device)
        self.leaves: list[Tensor] = []
        self.read: list[Tensor] = []
        self.pointers: list[int] = []
        self.sizes: list[int] = []
        for part in parts:
            if part.lanes is not None and part.lanes != self.lanes:
                if self.lanes is not None:
                    raise unequal(parameters[0], self.lanes, part.lanes)
                self.lanes = part.lanes
            if part.device is not self.device and part.device is not None and part.device != self.device:
                if self.device is not None:
                    raise elsewhere(parameters[0], self.device, part.device)
                self.device = part.device
            self.leaves += part.leaves
            self.read += part.read
            self.pointers += part.pointers
            self.sizes += part.sizes
        self.addresses = set(self.pointers)
        distinct = len(self.addresses) == len(self.pointers) and (
            known is None or self.addresses.isdisjoint(known.addresses))
        if known is not None:
            self.given, self.forms = known.given + self.given, known.forms + self.forms
            self.leaves, self.read = known.leaves + self.leaves, known.read + self.read
            self.pointers, self.sizes = known.pointers + self.pointers, known.sizes + self.sizes
        self.shared = self.sharing() if not distinct else () if known is None else known.shared

    @property
    def kinds(self) -> list[str]:
        """For each tensor its kind: of the lanes, a table, or a number."""
        return [kind for form in self.forms for kind in form.kinds]

    @property
    def columns(self) -> dict[int, Column]:
        """The column layouts of tables, by index of the tensor; rows are counted through all arguments."""
        found, place, blocks = {}, 0, 0
        for form in self.forms:
            for number, column in enumerate(form.columns):
                if column is not None:
                    found[place + number] = column._replace(block=blocks + column.block)
            place, blocks = place + len(form.kinds), blocks + len(form.columns)
        return found

    def sharing(self) -> tuple[tuple[int, int], ...]:
        """The indices of tensors that are the same as an earlier one, each with the index of the first.

        Tables that share their memory are the same; whether lanes do may differ from call to call.
        """
        firsts: dict[object, int] = {}
        found = []
        for place, (leaf, kind, pointer, size) in enumerate(zip(self.leaves, self.kinds, self.pointers, self.sizes)):
            alike = (pointer, size, leaf.dtype, leaf.stride()) if kind == TABLE and size else id(leaf)
            first = firsts.setdefault(alike, place)
            if first != place:
                found.append((place, first))
        return tuple(found)

    @property
    def firsts(self) -> list[int]:
        """For each tensor the index of the first tensor of the call that is the same one."""
        return [dict(self.shared).get(place, place) for place in range(len(self.leaves))]

    @property
    def key(self) -> tuple:
        """A hashable key of the arguments' structure and device: where it is equal, the same compiled code serves."""
        return (*[form.number for form in self.forms], *self.shared, self.device)
