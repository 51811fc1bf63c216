"""`radbp cache`: compiled code that is kept on disk, so that later processes need not compile it."""

from typing import Annotated

import typer
from rich.console import Console

from torch_radbp.training.commands.clear_errors import Debug, clear_errors

EPILOG = (
    "Examples:\n\n"
    "radbp cache  (where compiled code is kept, and how much)\n\n"
    "radbp cache --clear  (delete it; it is compiled anew when it is needed)\n\n"
    "The environment variable RADBP_KERNEL_CACHE names another folder; RADBP_KERNEL_CACHE=off keeps nothing."
)


def cache(
    clear: Annotated[bool, typer.Option("--clear", help="Delete all of it")] = False,
    debug: Debug = False,
) -> None:
    """Show where compiled code is kept on disk, or delete it."""
    with clear_errors(debug):
        from torch_radbp.jit.store import code_cache

        folder = code_cache.folder()
        if folder is None:
            words = "Nothing is kept: RADBP_KERNEL_CACHE is off"
        elif clear:
            count, size = code_cache.clear()
            words = f"{folder}: deleted {count:,} functions, {size / 2**20:.1f} MiB"
        else:
            sizes = [state.st_size for _, state in code_cache.files(folder)]
            words = (f"{folder}: {len(sizes):,} functions, {sum(sizes) / 2**20:.1f} MiB "
                     f"of at most {code_cache.LIMIT / 2**20:.0f} MiB")
        Console().print(words, soft_wrap=True, highlight=False)
