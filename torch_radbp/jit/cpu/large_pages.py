"""Large memory pages for recordings, on Linux.

A loop over lanes reads and writes dozens of arrays at the same time, each in a page of its own: more than a processor has
addresses of at hand if a page has 4 KiB. So the system is asked for pages of 2 MiB where blocks are large: for what is
touched first from now on, and, once for each place, in exchange for what small pages hold there.

Reference: Linux man-pages, madvise(2), MADV_HUGEPAGE and MADV_COLLAPSE.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable

import torch
from torch import Tensor

from torch_radbp.threads.made_once import made_once

PAGE, LEAST = 2 << 20, 8 << 20  # bytes: of a large page, and of a block that is worth asking for
HUGEPAGE, COLLAPSE = 14, 25  # numbers of the advice, mman-common.h
MOST = 4096  # places that are remembered
EXCHANGED: dict[tuple[int, int], None] = {}  # places that small pages were exchanged at: the first byte, and how many


@made_once
def advising() -> Callable[[int, int, int], int] | None:
    """The system call that advises on memory use (madvise): address, bytes, advice; None if the system is not Linux."""
    if sys.platform != "linux":
        return None
    return ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int)(("madvise", ctypes.CDLL(None)))


def block_of(shape: tuple[int, ...], dtype: torch.dtype) -> Tensor:
    """An uninitialised tensor of some shape, on the CPU; in large pages where possible."""
    block = torch.empty(shape, dtype=dtype, device="cpu")
    size = block.nbytes
    if size >= LEAST and (advise := advising()) is not None:
        start = block.data_ptr()
        first, last = -(-start // PAGE) * PAGE, (start + size) // PAGE * PAGE
        place = first, last - first
        advise(*place, HUGEPAGE)
        if place not in EXCHANGED:
            if len(EXCHANGED) >= MOST:
                EXCHANGED.clear()
            EXCHANGED[place] = None
            advise(*place, COLLAPSE)
    return block
