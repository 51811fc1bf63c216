"""Ctrl-C (SIGINT) and SIGTERM: a command ends at a moment when its state is whole."""

import contextlib
import signal
import threading
from collections.abc import Iterator

SIGNALS = (signal.SIGINT, signal.SIGTERM)
WORDS = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated"}


class Interrupts:
    """Receives the two signals while it is entered, and raises KeyboardInterrupt for each unless they are held back.

    The exception alone would not do: raised inside an import, or a callback from C code, it can be turned into another
    one or lost. So the signal is remembered, and `check` raises it again.

    Both are received even where the shell has told a background process to ignore Ctrl-C: state is saved, not lost.

    Attributes:
        pending: a signal has come that nobody has dealt with.
        received: the last signal, None before the first.
    """

    def __init__(self) -> None:
        self.pending = False
        self.received: signal.Signals | None = None
        self._held = 0
        self._previous: list[list] = []

    def __enter__(self) -> "Interrupts":
        if threading.current_thread() is threading.main_thread():  # signals only ever reach this one
            self._previous.append([signal.signal(number, self._receive) for number in SIGNALS])
        else:
            self._previous.append([])
        return self

    def __exit__(self, *_) -> None:
        for number, handler in zip(SIGNALS, self._previous.pop()):
            signal.signal(number, handler)

    def _receive(self, number: int, frame) -> None:
        self.received, self.pending = signal.Signals(number), True
        if not self._held:
            raise KeyboardInterrupt

    def check(self) -> None:
        """Raises KeyboardInterrupt if a signal is pending and not held back."""
        if self.pending and not self._held:
            raise KeyboardInterrupt

    @contextlib.contextmanager
    def held(self) -> Iterator[None]:
        """Holds signals back until the block is done; a signal that is still pending then raises KeyboardInterrupt.

        Around the update of parameters and optimiser: an interrupt in the middle would leave a state that no sequence of
        steps leads to. Rendering can be interrupted at any time, it changes nothing.
        """
        self._held += 1
        try:
            yield
        finally:
            self._held -= 1
        self.check()

    @contextlib.contextmanager
    def left_to(self, decision: bool) -> Iterator[None]:
        """Holds signals back to the end of the block if `decision` about them is made by others; none is raised after it."""
        self._held += decision
        try:
            yield
        finally:
            self._held -= decision

    def settle(self) -> None:
        """Declares the pending signal dealt with."""
        self.pending = False

    @property
    def exit_code(self) -> int:
        """128 and the number of the signal, as shells say it; that of Ctrl-C if KeyboardInterrupt came without one."""
        return 128 + (self.received or signal.SIGINT)

    @property
    def word(self) -> str:
        """The word that is printed: interrupted or terminated."""
        return WORDS.get(self.received, WORDS[signal.SIGINT])
