"""The right to write into a run folder, which one process has at a time and which ends with the process, however it ends."""

import errno
import os
import socket
import warnings
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

try:
    import fcntl
except ModuleNotFoundError:  # Windows
    fcntl = None
    import msvcrt

FILE_NAME = "run.lock"
# The byte that Windows locks, beyond the text, which others are to read.
LOCKED_BYTE = 2**20
HELD = (errno.EAGAIN, errno.EACCES, errno.EDEADLK)


class FolderInUseError(RuntimeError):
    """Another process writes into the folder; the message names both."""


class FolderLock:
    """A lock on a folder, held from `acquire` to `release`, or to the end of the process."""

    def __init__(self, folder: Path):
        self.path = Path(folder) / FILE_NAME
        self._file: BinaryIO | None = None

    def acquire(self) -> None:
        """Takes the lock.

        Raises:
            FolderInUseError: another process has it.
        """
        while self._file is None:
            file = self.path.open("a+b")
            try:
                _lock(file)
            except OSError as error:
                if error.errno in HELD:
                    raise self._in_use(file) from None
                warnings.warn(f"{self.path.parent}: this file system has no locks ({error.strerror}); see to it that no "
                              "other process writes into the folder", stacklevel=2)
            if self._is_current(file):
                self._file = file
            else:  # whoever held it has removed it meanwhile
                file.close()
        self._file.truncate(0)
        self._file.write(f"process {os.getpid()} on {socket.gethostname()}".encode())
        self._file.flush()

    def release(self) -> None:
        """Gives the lock back, and removes its file; does nothing if it is not held."""
        if self._file is None:
            return
        if fcntl is not None:
            self.path.unlink(missing_ok=True)
        self._file.close()
        self._file = None
        if fcntl is None:  # Windows removes no file that is open
            with suppress(OSError):
                self.path.unlink()

    def _in_use(self, file: BinaryIO) -> FolderInUseError:
        with file:
            file.seek(0)
            holder = file.read(200).decode("utf-8", "replace") or "another process"
        return FolderInUseError(f"{self.path.parent} is in use by {holder}; wait for its end, stop it, or choose another "
                                "--out")

    def _is_current(self, file: BinaryIO) -> bool:
        """True if the file that is open is the one at the path."""
        try:
            return os.path.samestat(os.fstat(file.fileno()), self.path.stat())
        except FileNotFoundError:
            return False


def _lock(file: BinaryIO) -> None:
    """Raises OSError if another process has the lock."""
    if fcntl is not None:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return
    file.seek(LOCKED_BYTE)
    msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
