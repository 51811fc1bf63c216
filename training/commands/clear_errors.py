"""Errors and warnings of a command line: one clear message each; of an error an exit code, no traceback unless asked for."""

import contextlib
import errno
import sys
import warnings
from collections.abc import Iterator
from typing import Annotated

import typer

from torch_radbp.training.interrupt import Interrupts

USAGE_ERROR = 2

Debug = Annotated[bool, typer.Option("--debug", help="Show the whole traceback of an error.")]

# What torch_radbp raises on bad input, and what the machine lacks: memory, disk, a library. The rest are our mistakes.
EXPECTED = (ValueError, TypeError, RuntimeError, OSError, AttributeError, FloatingPointError, MemoryError, ImportError)


@contextlib.contextmanager
def clear_errors(debug: bool) -> Iterator[Interrupts]:
    """Turns errors of the input into a message on stderr and exit code 2; Ctrl-C and SIGTERM into 130 and 143.

    Warnings are messages on stderr, too.

    Args:
        debug: let errors through as they are.

    Yields:
        the signals received while the command runs.
    """
    interrupts = Interrupts()
    try:
        with interrupts, warnings.catch_warnings():
            warnings.showwarning = lambda message, *_, **__: print(f"warning: {message}", file=sys.stderr)
            yield interrupts
    except KeyboardInterrupt:
        _leave(interrupts)
    except EXPECTED as error:
        # The exceptions of typer are RuntimeErrors that carry exit codes; they are no errors of the input.
        if isinstance(error, typer.Exit | typer.Abort):
            raise
        if interrupts.pending and not debug:  # an import that was broken off fails in ways of its own
            _leave(interrupts)
        if debug:
            raise
        print(f"error: {message_of(error)}", file=sys.stderr)
        raise typer.Exit(USAGE_ERROR) from None


def _leave(interrupts: Interrupts) -> None:
    print(interrupts.word, file=sys.stderr)
    raise typer.Exit(interrupts.exit_code) from None


def message_of(error: BaseException) -> str:
    """Returns the text of an error; that of an OSError without its number."""
    if isinstance(error, OSError) and error.strerror and error.filename:
        return f"{error.filename}: {error.strerror}"
    if isinstance(error, OSError) and error.errno == errno.ENOSPC and error.args == (errno.ENOSPC, error.strerror):
        return f"standard output cannot be written: {error.strerror}"  # files that cannot be are named
    return str(error) or type(error).__name__
