"""Ctrl-C at a moment when the run's state is whole."""

import contextlib
import signal
import threading
from collections.abc import Iterator


@contextlib.contextmanager
def deferred_interrupt() -> Iterator[None]:
    """Holds back a KeyboardInterrupt until the block is done.

    Around the update of parameters and optimiser: an interrupt in the middle would leave a state that no sequence of
    steps leads to. Rendering can be interrupted at any time, it changes nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        yield  # signals only ever reach the main thread
        return
    received = []
    previous = signal.signal(signal.SIGINT, lambda *_: received.append(True))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, previous)
    if received:
        raise KeyboardInterrupt
