"""The documentation, not built: all pages are listed, links lead somewhere, every public name has its place."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import pytest

from docs.contents import GROUPS, PAGES, ungrouped
from torch_radbp.plugin import REGISTRY

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
TUTORIALS = sorted((DOCS / "tutorials").glob("[0-9]*.py"))
WRITTEN = sorted({*DOCS.glob("*.md"), DOCS / "tutorials" / "index.md"})
BESIDE = [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "SECURITY.md", "training/README.md", "tests/README.md",
                                   "assets/README.md")]
GENERATED = {*(DOCS / "tutorials" / f"{tutorial.stem}.md" for tutorial in TUTORIALS),
             *(DOCS / "reference" / f"{name}.md" for name in ("index", *GROUPS)),
             *(DOCS / "plugins" / f"{name}.md" for name in ("index", *PAGES))}


def listed(page: Path) -> set[Path]:
    """The pages in the tables of contents of a page."""
    entries = re.findall(r"^:::\{toctree\}\n(.*?)^:::$", page.read_text(), re.MULTILINE | re.DOTALL)
    names = [line for entry in entries for line in entry.splitlines() if line and not line.startswith(":")]
    return {page.parent / f"{name}.md" for name in names}


def test_every_page_is_in_a_table_of_contents():
    found = {entry for page in WRITTEN for entry in listed(page)}
    assert len(TUTORIALS) >= 10
    groups = {DOCS / "reference" / f"{name}.md" for name in GROUPS} | {DOCS / "plugins" / f"{name}.md" for name in PAGES}
    assert found == {*WRITTEN, *GENERATED} - groups - {DOCS / "index.md"}  # groups are listed by the generated index


@pytest.mark.parametrize("page", [*WRITTEN, *TUTORIALS, *BESIDE], ids=lambda page: f"{page.parent.name}/{page.stem}")
def test_links_inside_of_the_documentation_lead_somewhere(page):
    targets = re.findall(r"\]\(([^)\s]+)\)", page.read_text())
    for target in targets:
        if re.match(r"https?://", target):
            continue
        path = (page.parent / target.partition("#")[0]).resolve()
        assert path.exists() or path in GENERATED, f"{page.name} links to {target}"


@pytest.mark.parametrize("page", [page for page in WRITTEN if "{include}" in page.read_text()], ids=lambda page: page.stem)
def test_what_is_included_from_other_documents_is_there(page):
    block = r"^```\{include\} (\S+)\n:start-after: \"(.*)\"\n:end-before: \"(.*)\"$"
    blocks = re.findall(block, page.read_text(), re.MULTILINE)
    assert len(blocks) == page.read_text().count("{include}")
    for name, start, end in blocks:
        text = (page.parent / name).read_text()
        assert text.count(start) == 1 and end in text.partition(start)[2], f"{page.name}: {start!r} to {end!r} of {name}"


def test_every_public_name_is_on_a_page_of_the_reference():
    assert not ungrouped(), "add these to a group of docs/contents.py"
    names = [name for group in GROUPS.values() for name in group.names]
    assert len(names) == len(set(names))


def test_every_kind_of_plugin_has_a_page():
    assert set(PAGES) == set(REGISTRY)


def test_nothing_is_fetched_from_other_hosts():
    settings = runpy.run_path(str(DOCS / "conf.py"))
    assert settings["html_theme"] == "furo" and settings["nitpicky"]
    assert all((DOCS / "_static" / name).exists() for name in settings["html_css_files"])
    assert "sphinx.ext.mathjax" not in settings["extensions"]


def test_what_the_page_on_the_code_names_is_there():
    """Files, and functions or methods of the file that is named before them, up to the colon of each entry."""
    text = (DOCS / "reading_the_code.md").read_text()
    package, named = ROOT / "torch_radbp", 0
    for entry in re.findall(r"^\d+\. (.*?):", text, re.MULTILINE | re.DOTALL):
        source = ""
        for name in re.findall(r"`([^`]+)`", entry):
            if name.endswith(".py"):
                source = (package / name).read_text()
                continue
            named += 1
            for part in name.split("."):
                assert re.search(rf"^ *(def|class) {part}\b", source, re.MULTILINE), f"{name} in: {entry}"
    assert named >= 20
    for path in re.findall(r"`([\w/]+(?:\.py|/))`", text):
        assert (package / path).exists() or (ROOT / path).exists(), path
