"""Reuses zeroed memory: fresh pages of the operating system are slow at their first touch.

Fresh pages are zeroed by the system when they are first touched, which takes several times as long as what is added to them
there. So large tables of sums are zeroed where they were touched, and handed out again in the next step.
"""

from __future__ import annotations

from collections.abc import Iterable
from threading import Lock

import numpy as np
import torch
from torch import Tensor

LEAST = 1 << 20  # bytes; the allocator is quick with what is less


def zeros(rows: int, columns: int, dtype: torch.dtype, device: torch.device) -> Tensor:
    """Zeros; large ones on the CPU take no memory before they are touched."""
    if device.type != "cpu" or rows * columns * dtype.itemsize < LEAST:
        return torch.zeros(rows, columns, dtype=dtype, device=device)
    return torch.from_numpy(np.zeros((rows, columns), dtype=torch.empty(0, dtype=dtype, device=device).numpy().dtype))


class ZeroedMemory:
    """Tables of zeros, float64, kept from the last step for reuse.

    A copied or unpickled one is empty.
    """

    def __init__(self) -> None:
        self.unused: list[Tensor] = []
        self.lock = Lock()

    def __reduce__(self):
        return ZeroedMemory, ()

    def take(self, rows: int, columns: int, device: torch.device) -> Tensor:
        """Takes zeros, (rows, columns), for exclusive use."""
        with self.lock:
            for number, table in enumerate(self.unused):
                if table.shape == (rows, columns) and table.device == device:
                    return self.unused.pop(number)
        return zeros(rows, columns, torch.float64, device)

    def give_back(self, tables: Iterable[Tensor]) -> None:
        """Gives tables back that are zero again; they replace what was left of earlier ones."""
        with self.lock:
            self.unused = [table for table in tables if table.is_cpu and table.nbytes >= LEAST]
