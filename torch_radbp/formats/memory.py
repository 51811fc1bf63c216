"""The error about a file that is too large for memory."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

REFUSED = ("can't allocate memory", "not enough memory", "out of memory")  # in the errors of torch's allocators


@contextmanager
def memory_for(path: str | os.PathLike) -> Iterator[None]:
    """Turns a lack of memory in the block into a MemoryError that names the file.

    Raises:
        MemoryError: names it, and what to do.
    """
    try:
        yield
    except (MemoryError, RuntimeError) as error:
        ours = str(error).startswith(f"{path}: ")
        if ours or not (isinstance(error, MemoryError) or any(words in str(error).lower() for words in REFUSED)):
            raise
        raise MemoryError(f"{path}: the system refused the memory for its content; make it smaller, or end other "
                          f"programs") from error
