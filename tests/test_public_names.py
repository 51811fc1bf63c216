"""The public names: there whatever is imported first, and without torch as long as none of them is asked for."""

import importlib
import re
import subprocess
import sys
from importlib.util import find_spec

import pytest

import torch_radbp as rb


def in_a_new_process(script: str) -> str:
    """Standard output of a script that must end well."""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_command_line_explains_itself_without_torch():
    in_a_new_process("""
import contextlib, io, sys
import torch_radbp
from torch_radbp.training.cli import app
for arguments in ["--version"], ["--help"], ["render", "--help"], ["info", "-h"], ["optimize", "--help"], ["check", "-h"]:
    with contextlib.redirect_stdout(io.StringIO()) as text, contextlib.suppress(SystemExit):
        app(arguments)
    assert len(text.getvalue()) > 10, arguments
heavy = {"torch", "numpy", "numba", "kornia", "trimesh"} & set(sys.modules)
assert not heavy, heavy
""")


def test_plugins_and_public_names_are_there_whatever_is_imported_first_and_no_run_needs_tensorboard():
    """Runs import it when they write for it."""
    in_a_new_process("""
import sys
from torch_radbp.plugin import REGISTRY
assert "diffuse" in REGISTRY["bsdf"] and "path" in REGISTRY["integrator"] and len(REGISTRY["shape"]) > 5
import torch_radbp.rendering.jvp, torch_radbp.rendering.renderer
import torch_radbp as rb
from torch_radbp import *
assert render is rb.render and callable(render) and callable(jvp) and Scene is rb.Scene
import torch_radbp.training.run, torch_radbp.training.commands.check, torch_radbp.training.cli
assert not {name.partition(".")[0] for name in sys.modules} & {"tensorboard", "tensorflow"}
""")


@pytest.mark.parametrize("name", rb.__all__)
def test_no_part_of_the_package_has_the_name_of_what_is_public(name):
    """The module would hide it once it is imported."""
    assert find_spec(f"torch_radbp.{name}") is None


def test_dir_lists_the_public_names_and_parts_and_no_imports():
    shown = [name for name in dir(rb) if not name.startswith("_")]
    assert set(rb.__all__) <= set(shown)
    assert all(getattr(rb, name).__name__.startswith("torch_radbp.") for name in set(shown) - set(rb.__all__))


def test_parts_are_there_without_an_import_of_their_own():
    assert rb.formats.image.read_image and rb.plugin.SceneError is rb.SceneError


def test_a_name_that_does_not_exist_is_an_attribute_error():
    with pytest.raises(AttributeError, match="module 'torch_radbp' has no attribute 'rendr'"):
        rb.rendr  # noqa: B018
    assert not hasattr(rb, "__wrapped__")


def test_what_is_stable_is_listed_with_every_public_name():
    text = " ".join(importlib.import_module("torch_radbp.public").__doc__.split())
    for home in (rb, rb.bake, rb.losses, rb.priors, rb.optim):
        assert home is rb or home.__name__ in text
        missing = [name for name in home.__all__ if not re.search(rf"\b{name}\b", text)]
        assert not missing
    listed = set(re.findall(r"\b\w+\b", text.split("CHANGELOG.md.")[1].split("So are")[0]))
    known = {name for home in (rb, rb.bake, rb.losses, rb.priors, rb.optim) for name in home.__all__}
    words = {"scenes", "poses", "and", "cameras", "images", "derivatives", "errors", "warnings", "torch_radbp", "losses",
             "optim", "photographs", "priors", "bake", "plugins", "uncertainty"}
    assert listed - words <= known, "names that do not exist"
