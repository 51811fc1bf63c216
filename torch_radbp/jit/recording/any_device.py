"""The target for devices without a compiler here: torch's own operations move lanes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor

from torch_radbp.jit.recording.addition import PAGE_BITS, VALUES, Addition, Patches, Sums
from torch_radbp.jit.recording.recording import NotRecordable
from torch_radbp.tensors.partition import partition_by_torch


class AnyDevice:
    """A device as a target for which nothing is compiled: torch's own operations move lanes about.

    Args:
        reason: why nothing is compiled for it, and what to do about it.
    """

    counts_stay = loads_ahead = repeats = False

    def __init__(self, reason: str = "lanes are compiled for the CPU and for GPUs of NVIDIA's; run the function as it is"):
        self.reason = reason

    def text(self, program: Any) -> str:
        raise RuntimeError(self.reason)

    @property
    def platform(self) -> str:
        raise RuntimeError(self.reason)

    def code(self, program: Any) -> bytes:
        raise RuntimeError(self.reason)

    def loop(self, code: bytes, searched: Sequence[int], keep: Callable[[bytes], None] | None = None):
        raise RuntimeError(self.reason)

    def compile(self, program: Any):
        raise RuntimeError(self.reason)

    def recorded(self, recording, given: Sequence[Tensor | int], results: Any):
        raise NotRecordable(self.reason)

    def chosen(self, flags: Tensor) -> Tensor:
        """The lanes whose flag is set; waits for the device to know their number."""
        return flags.nonzero().squeeze(1).to(torch.int32)

    def inverted(self, flags: Tensor) -> Tensor:
        return ~flags

    def nothing(self, flags: Tensor) -> Tensor:
        return torch.zeros_like(flags)

    def partition(self, number: Tensor, queues: int) -> tuple[Tensor, Sequence[int]]:
        return partition_by_torch(number, queues)

    def in_order(self, major: Tensor, minor: Tensor, queues: int) -> tuple[Tensor, Tensor, Tensor]:
        """Sorts lanes by two numbers, as `order.in_order` does; waits for the device once."""
        order, _ = self.partition(minor, queues)
        order = order.index_select(0, self.partition(major.index_select(0, order), queues)[0])
        return order, major.index_select(0, order), minor.index_select(0, order)

    def put(self, targets: Sequence[Tensor], place: Tensor, entries: Sequence[Tensor]) -> None:
        for target, entry in zip(targets, entries):
            target.index_copy_(0, place.long(), entry)

    def copies(self, entries: int) -> int:
        return 1

    def scatter_add(self, additions: Sequence[Addition], lanes: int) -> None:
        """Scatter-adds numbers: neighbouring lanes to different copies of sums; in order if torch is to be deterministic."""
        for index, numbers, sums in additions:
            copy = torch.arange(lanes, device=index.device) % sums.copies
            for number, total in zip(numbers, sums.totals):
                if sums.copies == 1:
                    total.squeeze(1).index_add_(0, index, number.to(total.dtype))
                else:
                    total.index_put_((index.long(), copy), number.to(total.dtype), accumulate=True)
            sums.touched.fill_(True)

    def add_patches(self, patches: Patches, totals: Tensor) -> None:
        """Adds patches to images, as `patches.add_patches` does, by one scatter-addition of all pixels."""
        first, values, down, across = patches
        apart = torch.arange(len(down), dtype=torch.int32, device=totals.device)[:, None] * totals.shape[1]
        pixel = (apart + torch.arange(len(across), dtype=torch.int32, device=totals.device))[:, :, None] + first
        weights = torch.stack(list(down))[:, None] * torch.stack(list(across))
        entries = totals.view(-1, totals.shape[2])
        touched = torch.zeros(-(-len(entries) >> PAGE_BITS), dtype=torch.bool, device=totals.device)
        sums = Sums([entries[:, k:k + 1] for k in range(VALUES)], touched)
        numbers = [(value * weights).flatten() for value in values]
        self.scatter_add([Addition(pixel.flatten(), numbers, sums)], pixel.numel())
