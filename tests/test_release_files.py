"""What goes with a release, CHANGELOG.md and CITATION.cff: they say what the package says."""

import ast
import re
from pathlib import Path

import pytest

import torch_radbp as rb

ROOT = Path(rb.__file__).parents[1]
CHANGES = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
CITATION = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
SETUP = next(node for node in ast.walk(ast.parse((ROOT / "setup.py").read_text(encoding="utf-8")))
             if isinstance(node, ast.Call) and getattr(node.func, "id", None) == "setup")


def metadata(field: str):
    """What setup.py says."""
    return next(ast.literal_eval(given.value) for given in SETUP.keywords if given.arg == field)


def cited(field: str) -> str:
    """A field of the citation that is one line."""
    return re.search(rf'^{field}: "?(.*?)"?$', CITATION, re.M)[1]


@pytest.mark.parametrize("field", ["version", "license"])
def test_the_citation_has_what_the_package_has(field):
    assert cited(field) == metadata(field)


def test_the_citation_names_package_and_note():
    assert cited("title").startswith(f"{metadata('name')}: ") and cited("cff-version") == "1.2.0"
    assert metadata("description").lower() in cited("title").lower()
    assert re.findall(r"^  - ([A-Za-z].*)$", CITATION.split("authors:")[0], re.M) == metadata("keywords")
    assert "title: Deriving Radiative Backpropagation using the Recursive Form of Path Tracing" in CITATION


def test_the_newest_changes_are_those_of_this_version():
    assert re.search(r"^## (\S+?),? ", CHANGES, re.M)[1] == metadata("version")


@pytest.mark.parametrize("home", [rb, rb.bake, rb.losses, rb.priors, rb.optim], ids=lambda home: home.__name__)
def test_the_changes_have_every_public_name(home):
    missing = [name for name in home.__all__ if f"`{name}`" not in CHANGES]
    assert not missing, f"say in CHANGELOG.md what they are: {', '.join(missing)}"
