"""Runs a tutorial, and writes it with what it printed and drew as a page, and as a notebook to download.

    python -m docs.tutorial_page docs/tutorials/01_first_gradient.py
"""

from __future__ import annotations

import io
import sys
import textwrap
import time
from contextlib import redirect_stdout
from pathlib import Path

import jupytext
import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402

WIDTH = 88  # characters that fit a box of code; `docs.widths` looks


def wrapped(printed: str) -> str:
    """Printed text with its long lines broken between words."""
    return "\n".join(textwrap.fill(line, WIDTH, subsequent_indent="    ", break_long_words=False, break_on_hyphens=False)
                     for line in printed.splitlines())


def write_page(script: Path) -> None:
    """Executes the cells of a py:percent notebook in turn and writes NAME.md, NAME.ipynb and pictures beside it.

    Raises:
        Whatever a cell raises, such as the AssertionError of a tutorial that did not find what it promises.
    """
    notebook = jupytext.read(script)
    names = {"__name__": "__main__"}
    page, drawn, start = [], 0, time.perf_counter()
    for cell in notebook.cells:
        if cell.cell_type == "markdown":
            page.append(cell.source)
            continue
        page.append(f"```python\n{cell.source}\n```")
        with redirect_stdout(io.StringIO()) as printed:
            try:
                exec(compile(cell.source, f"{script.name}, cell {len(page)}", "exec"), names)
            except BaseException:
                print(*page, printed.getvalue(), sep="\n\n", file=sys.stderr)  # what it found so far
                raise
        if printed.getvalue().strip():
            page.append(f"```text\n{wrapped(printed.getvalue().rstrip())}\n```")
        for number in plt.get_fignums():
            drawn += 1
            picture = script.with_name(f"{script.stem}_{drawn}.png")
            plt.figure(number).savefig(picture, dpi=110, bbox_inches="tight")
            page.append(f"![What the lines above draw]({picture.name})")
        plt.close("all")
    seconds = time.perf_counter() - start
    jupytext.write(notebook, script.with_suffix(".ipynb"))
    page.append(f"---\n\n*These lines ran in {seconds:.0f} s. To run them yourself, from the folder of the repository: "
                f"`python docs/tutorials/{script.name}`, or {{download}}`the notebook <{script.stem}.ipynb>`.*\n")
    script.with_suffix(".md").write_text("\n\n".join(page))


if __name__ == "__main__":
    write_page(Path(sys.argv[1]))
