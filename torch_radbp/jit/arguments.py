"""The arguments of a call, taken apart: tensors with their kinds, and the structure that a function is compiled for."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from torch_radbp.jit.graph import LANES, NUMBER, TABLE
from torch_radbp.jit.structure import flatten


class Arguments:
    """The arguments of one call, or the first of them.

    Args:
        name: of the function, for errors.
        arguments: nested tuples and lists of tensors, and of anything hashable.
        in_tables: of each argument, whether tensors of shape (N,) in it are tables.
        known: the arguments that stand before these, taken apart before.

    Raises:
        ValueError: if tensors of lanes differ in length, or a tensor has another device or shape.
        RuntimeError: if tensors require grad while gradients are recorded.
    """

    __slots__ = ("given", "structures", "leaves", "kinds", "firsts", "places", "lanes")

    def __init__(self, name: str, arguments: Sequence, in_tables: Sequence[bool], known: Arguments | None = None):
        self.given = tuple(arguments) if known is None else (*known.given, *arguments)
        self.structures: list[tuple] = [] if known is None else known.structures.copy()
        self.leaves: list[Tensor] = [] if known is None else known.leaves.copy()
        self.kinds: list[str] = [] if known is None else known.kinds.copy()
        self.firsts: list[int] = [] if known is None else known.firsts.copy()  # where the same tensor is given first
        self.places: dict[object, int] = {} if known is None else known.places.copy()  # of what is given first
        self.lanes: int | None = None if known is None else known.lanes
        for argument, table in zip(arguments, in_tables):
            leaves: list[Tensor] = []
            key: list = []
            flatten(argument, leaves, key)
            self.structures.append(tuple(key))
            self.add(name, leaves, table)

    def add(self, name: str, leaves: list[Tensor], table: bool) -> None:
        """Notes the tensors of one argument."""
        recording = torch.is_grad_enabled()
        for place, leaf in enumerate(leaves, len(self.leaves)):
            dimensions = leaf.dim()
            if recording and leaf.requires_grad:
                raise RuntimeError(f"{name} is compiled and records no derivative: call it under torch.no_grad(), or "
                                   "with detached tensors")
            if dimensions > 1:
                raise ValueError(f"{name} takes tensors of shape () and (N,), got {tuple(leaf.shape)}")
            if not leaf.is_cpu:
                raise ValueError(f"{name} is compiled for the CPU, got a tensor on {leaf.device}")
            identity: object = id(leaf)
            if dimensions == 0:
                kind = NUMBER
            elif table:
                kind = TABLE
                if leaf.is_contiguous() and (length := leaf.numel()):
                    identity = (leaf.data_ptr(), length, leaf.dtype)  # tables that share their memory are one
            else:
                kind, length = LANES, leaf.numel()
                self.lanes = length if self.lanes is None else self.lanes
                if self.lanes != length:
                    raise ValueError(f"{name} got tensors of {self.lanes} and of {length} lanes")
            self.kinds.append(kind)
            self.firsts.append(self.places.setdefault(identity, place))
        self.leaves += leaves

    @property
    def key(self) -> tuple:
        """Equal of arguments that one compiled function serves."""
        return (*self.structures, *self.firsts)
