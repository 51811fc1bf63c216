"""Writes results of some lanes into records of all."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.jit.dual import dual, tangents_and_tensors
from torch_radbp.jit.order import put
from torch_radbp.tensors.differentiated import tangent_of
from torch_radbp.tensors.record import leaves_of
from torch_radbp.tensors.vec import Vec3


def put_rows(record, place: Tensor, entries) -> None:
    """Writes entries into the rows `place`, (N,) int32 without repetition, of every tensor of a record."""
    targets, found = ([leaf for leaf in leaves_of(part) if leaf is not None] for part in (record, entries))
    if torch.is_grad_enabled() and any([leaf.requires_grad for leaf in found]):
        for target, new in zip(targets, found):
            target.index_copy_(0, place.long(), new)
    else:
        found = [new if tangent_of(target) is None or tangent_of(new) is not None else dual(new, torch.zeros_like(new))
                 for target, new in zip(targets, found)]
        put(tangents_and_tensors(targets), place, tangents_and_tensors(found))


def add_at(L: Vec3, lane: Tensor, value: Vec3) -> None:
    """Adds `value` to `L` at indices `lane`, in place."""
    for total, part in zip(L, value):
        total.index_add_(0, lane, part)
