"""Memory that is zero: fresh from the operating system, or used again.

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
    """Zeros whose memory, on the CPU, is not taken before it is touched if it is large."""
    if device.type != "cpu" or rows * columns * dtype.itemsize < LEAST:
        return torch.zeros(rows, columns, dtype=dtype, device=device)
    return torch.from_numpy(np.zeros((rows, columns), dtype=torch.empty(0, dtype=dtype, device=device).numpy().dtype))


class ZeroedMemory:
    """Tables of zeros, float64, of which those of the last step are kept.

    A copied or unpickled one is empty.
    """

    def __init__(self) -> None:
        self.unused: list[Tensor] = []
        self.lock = Lock()

    def __reduce__(self):
        return ZeroedMemory, ()

    def take(self, rows: int, columns: int, device: torch.device) -> Tensor:
        """Zeros, (rows, columns), nobody else's."""
        with self.lock:
            for number, table in enumerate(self.unused):
                if table.shape == (rows, columns) and table.device == device:
                    return self.unused.pop(number)
        return zeros(rows, columns, torch.float64, device)

    def give_back(self, tables: Iterable[Tensor]) -> None:
        """Keeps tables that are zero again, in the place of what was left of those before."""
        with self.lock:
            self.unused = [table for table in tables if table.is_cpu and table.nbytes >= LEAST]
