"""Errors of a command line: one clear message and an exit code, no traceback unless asked for."""

import contextlib
import sys
from collections.abc import Iterator
from typing import Annotated

import typer

USAGE_ERROR = 2
INTERRUPTED = 130  # 128 + SIGINT, as shells say it

Debug = Annotated[bool, typer.Option("--debug", help="Show the whole traceback of an error.")]


@contextlib.contextmanager
def clear_errors(debug: bool) -> Iterator[None]:
    """Turns the errors that torch_radbp raises on bad input into a message on stderr and exit code 2.

    Args:
        debug: let errors through as they are.
    """
    try:
        yield
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        raise typer.Exit(INTERRUPTED) from None
    except (ValueError, TypeError, RuntimeError, OSError, AttributeError) as error:
        # click's own exceptions are RuntimeErrors that carry exit codes; they are no errors of the input.
        if debug or isinstance(error, typer.Exit | typer.Abort):
            raise
        print(f"error: {message_of(error)}", file=sys.stderr)
        raise typer.Exit(USAGE_ERROR) from None


def message_of(error: BaseException) -> str:
    """Returns the text of an error; that of an OSError without its number."""
    if isinstance(error, OSError) and error.strerror and error.filename:
        return f"{error.filename}: {error.strerror}"
    return str(error) or type(error).__name__
