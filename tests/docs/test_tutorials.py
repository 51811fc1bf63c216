"""Tutorials are short, use public names, check what they promise, and run (deep)."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest

import torch_radbp as rb

ROOT = Path(__file__).parents[2]
TUTORIALS = sorted((ROOT / "docs" / "tutorials").glob("[0-9]*.py"))
MODULES = {"bake", "losses", "optim", "priors"}  # public modules
FOR_PLUGINS = {"bsdf", "domain", "plugin", "texture", "vec"}  # what is derived from where a plugin is written
MOST_LINES = 62


def code_lines(tutorial: Path) -> int:
    """The lines of a tutorial that are neither text nor empty."""
    return sum(bool(line.strip()) and not line.startswith("#") for line in tutorial.read_text().splitlines())


@pytest.mark.parametrize("tutorial", TUTORIALS, ids=lambda path: path.stem)
def test_a_tutorial_is_short_and_checks_at_its_end_what_it_promises(tutorial):
    assert code_lines(tutorial) <= MOST_LINES
    assert isinstance(ast.parse(tutorial.read_text()).body[-1], ast.Assert)


@pytest.mark.parametrize("tutorial", TUTORIALS, ids=lambda path: path.stem)
def test_a_tutorial_uses_public_names_only(tutorial):
    tree = ast.parse(tutorial.read_text())
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            assert not (node.module or "").startswith("torch_radbp"), f"{tutorial.name} imports from {node.module}"
        if isinstance(node, ast.Import):
            assert all(name.name == "torch_radbp" and name.asname == "rb" for name in node.names if "radbp" in name.name)
    used = {node.attr for node in ast.walk(tree)
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "rb"}
    allowed = {*rb.__all__, *MODULES, *(FOR_PLUGINS if tutorial.stem == "09_own_material" else ())}
    assert used and used <= allowed, f"{tutorial.name} uses {used - allowed}"


@pytest.mark.deep
@pytest.mark.parametrize("tutorial", TUTORIALS, ids=lambda path: path.stem)
def test_a_tutorial_runs_and_finds_what_it_promises(tutorial):
    environment = os.environ | {"MPLBACKEND": "Agg", "PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, str(tutorial)], cwd=ROOT, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
