"""Makes the C library's allocator keep freed memory, so that tensors reuse it.

By default large blocks go back to the system when they are freed, and come again as pages of zeros that are made when they
are first touched. Loops over lanes free and ask for the same blocks again and again, so that up to a tenth of their time
went there. What stays is bounded. Threads but the first have heaps of their own, of at most 64 MiB each, and an empty one
goes back whole unless all of it is less than what each heap is to have in reserve. Whoever has settings of their own for the
C library's memory keeps these.

Reference: GNU C Library manual, section 3.2.3.8, "Malloc Tunable Parameters".
"""

from __future__ import annotations

import ctypes
import os
import sys

from torch_radbp.threads.made_once import made_once

TRIM_THRESHOLD, TOP_PAD, MMAP_THRESHOLD = -1, -2, -3  # numbers of the parameters, malloc.h
KEPT = 256 << 20  # bytes that are free and not given back; larger blocks always are
HEAP = 64 << 20  # bytes of addresses that a heap has in reserve, which take no memory before they are written to


@made_once
def keep_freed_memory() -> bool:
    """Makes the C library keep freed memory from now on; False if it is not GNU's, or the environment says otherwise."""
    chosen = any(name.startswith("MALLOC_") for name in os.environ) or "malloc" in os.environ.get("GLIBC_TUNABLES", "")
    set_parameter = None if chosen or sys.platform != "linux" else getattr(ctypes.CDLL(None), "mallopt", None)
    parameters = (TRIM_THRESHOLD, KEPT), (MMAP_THRESHOLD, KEPT), (TOP_PAD, HEAP)
    return set_parameter is not None and all([set_parameter(*parameter) for parameter in parameters])
