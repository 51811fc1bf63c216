"""Freed memory of the C library, which tensors take theirs from, stays in the process to be used again.

By default large blocks go back to the system when they are freed, and come again as pages of zeros that are made when they
are first touched. Loops over lanes free and ask for the same blocks again and again, so that up to a tenth of their time
went there. What stays is bounded. Whoever has settings of their own for the C library's memory keeps these.

Reference: GNU C Library manual, section 3.2.3.8, "Malloc Tunable Parameters".
"""

from __future__ import annotations

import ctypes
import os
import sys

from torch_radbp.jit.machine import made_once

TRIM_THRESHOLD, MMAP_THRESHOLD = -1, -3  # numbers of the parameters, malloc.h
KEPT = 256 << 20  # bytes that are free and not given back; larger blocks always are


@made_once
def keep_freed_memory() -> bool:
    """Has the C library keep freed memory from now on; False if it is not GNU's, or the environment says otherwise."""
    chosen = any(name.startswith("MALLOC_") for name in os.environ) or "malloc" in os.environ.get("GLIBC_TUNABLES", "")
    set_parameter = None if chosen or sys.platform != "linux" else getattr(ctypes.CDLL(None), "mallopt", None)
    return set_parameter is not None and all([set_parameter(TRIM_THRESHOLD, KEPT), set_parameter(MMAP_THRESHOLD, KEPT)])
