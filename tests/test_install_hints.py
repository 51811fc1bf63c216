"""What messages and pages say of installing the package is true: by its folder, as long as no index has it."""

import re
import subprocess
from pathlib import Path

import pytest

import torch_radbp as rb
from torch_radbp.install_hint import SOURCE, install_with

ROOT = Path(rb.__file__).parents[1]
HINT = re.compile(r"pip install ((?:-\S+ |constraints\.txt )*)([\"']?)([^\s\"'`;,)\\]+)")
NAME = re.compile(r"(torch[_-]radbp|\.)(?:\[([a-z,]+)\])?$")
LISTED = subprocess.run(["git", "ls-files", "*.py", "*.md", "*.toml", "Makefile", ".ci/run", ".github/*"], cwd=ROOT,
                        capture_output=True, text=True).stdout.split()
FILES = [ROOT / name for name in LISTED if name != "tests/test_install_hints.py"]


def hints() -> list[tuple[str, str]]:
    """Where this package is to be installed, and what pip is given there."""
    return [(path.name, found[3]) for path in FILES if path.exists()
            for found in HINT.finditer(path.read_text(encoding="utf-8")) if NAME.match(found[3])]


@pytest.mark.skipif(not FILES, reason="lists the files of the repository by git")
def test_every_hint_installs_the_package_by_what_install_hint_says():
    assert len(hints()) > 5
    wrong = [hint for hint in hints() if NAME.match(hint[1])[1] != SOURCE]
    assert not wrong, f"torch_radbp/install_hint.py says {SOURCE!r}: {wrong}"


@pytest.mark.skipif(not FILES, reason="lists the files of the repository by git")
def test_every_extra_that_is_named_exists():
    named = {extra for _, given in hints() if NAME.match(given)[2] for extra in NAME.match(given)[2].split(",")}
    named |= {extra for path in FILES if path.exists()
              for extra in re.findall(r"install_with\([\"'](\w+)[\"']\)", path.read_text(encoding="utf-8"))}
    extras = set(re.findall(r'"(\w+)":', re.search(r"extras_require=\{(.*?)\}", (ROOT / "setup.py").read_text())[1]))
    assert {"cuda", "bake", "docs"} <= named <= extras


def test_the_command_says_where_it_is_typed():
    assert install_with("cuda") == "pip install '.[cuda]' in the folder of torch_radbp's repository"
