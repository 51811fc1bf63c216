"""Builds the documentation into site/: runs the tutorials, writes the reference and the plugins' pages, and calls Sphinx.

    python -m docs.build             # `make docs`; tutorials run again if they or the package have changed
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

from docs.plugin_pages import write_plugin_pages
from docs.reference import write_reference

HERE = Path(__file__).parent
SITE = HERE.parent / "site"
PACKAGE = HERE.parent / "torch_radbp"


def tutorials() -> list[Path]:
    """The scripts of the tutorials, in order."""
    return sorted((HERE / "tutorials").glob("[0-9]*.py"))


def out_of_date(script: Path) -> bool:
    """True if the page of a tutorial is missing, or older than the tutorial, what runs it, or any file of the package."""
    page = script.with_suffix(".md")
    sources = [script, HERE / "tutorial_page.py", *PACKAGE.rglob("*.py")]
    return not page.exists() or page.stat().st_mtime < max(source.stat().st_mtime for source in sources)


def main() -> None:
    """Builds the site; ends with an error if a tutorial fails or Sphinx has a warning."""
    environment = os.environ | {"PYTHONPATH": str(HERE.parent)}
    for script in filter(out_of_date, tutorials()):
        start = time.perf_counter()
        subprocess.run([sys.executable, "-m", "docs.tutorial_page", str(script)], check=True, cwd=HERE.parent,
                       env=environment)
        print(f"{script.name}: {time.perf_counter() - start:.0f} s", flush=True)
    write_reference(HERE / "reference")
    write_plugin_pages(HERE / "plugins")
    subprocess.run([sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-E", str(HERE), str(SITE)], check=True)
    print(f"{SITE.name}/index.html")


if __name__ == "__main__":
    main()
