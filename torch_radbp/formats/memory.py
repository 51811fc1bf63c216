"""What is said when the system refuses memory for a file."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

REFUSED = ("can't allocate memory", "not enough memory", "out of memory")  # in the errors of torch's allocators


@contextmanager
def memory_for(path: str | os.PathLike) -> Iterator[None]:
    """Has what the block raises for lack of memory, numpy's error or torch's, name the file that it reads, or what else.

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
