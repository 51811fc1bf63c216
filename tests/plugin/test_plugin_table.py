"""The documentation's table of Mitsuba's plugins says what is registered, and leaves none of them out."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import torch_radbp as rb
from tests.plugin.plugin_table import CATEGORIES, TABLE, table
from torch_radbp.plugin import REGISTRY, attributes

# Mitsuba's integrators that are written in Python, and are no files of its folder of plugins.
IN_PYTHON = {"direct_projective", "prb", "prb_basic", "prb_projective", "prbvolpath", "volprim_rf_basic"}


def test_there_is_a_row_for_every_category():
    assert set(table()) == set(CATEGORIES)
    assert set(REGISTRY) <= {ours for ours, _ in CATEGORIES.values()}


@pytest.mark.parametrize("category", CATEGORIES)
def test_what_is_registered_is_what_the_table_calls_supported(category):
    ours, _ = CATEGORIES[category]
    supported, beyond, _ = table()[category]
    assert supported | beyond == (set(REGISTRY[ours]) if ours else set())


@pytest.mark.parametrize("category", CATEGORIES)
def test_every_plugin_of_mitsuba_is_in_the_table(category, mi):
    manager, wanted = mi.PluginManager.instance(), getattr(mi.ObjectType, CATEGORIES[category][1])
    plugins = (Path(mi.__file__).parent / "plugins").glob("*.*")
    names = {path.stem for path in plugins if path.suffix in (".so", ".dylib", ".dll")}
    theirs = {name for name in names if manager.plugin_type(name) == wanted} | (
        IN_PYTHON if category == "Integrators" else set())
    supported, beyond, missing = table()[category]
    assert theirs == supported | missing and not theirs & beyond


@pytest.mark.parametrize("category", CATEGORIES)
def test_the_loader_says_of_each_unsupported_plugin_why(category):
    for name in table()[category][2]:
        with pytest.raises(rb.SceneError, match=f"the [a-z]+ type '{name}' is not supported: [a-z].*"):
            rb.load_dict({"type": "scene", "thing": {"type": name}})


@pytest.mark.parametrize("category, name", [("shape", "mesh"), ("emitter", "envmap")])
def test_the_keys_of_what_is_not_as_in_mitsuba_are_listed(category, name):
    paragraph = next(each for each in TABLE.read_text().split("\n\n") if "takes these keys in a dict" in each)
    listed = set(re.findall(r"`([a-z_]+)`", paragraph))
    assert set(attributes(REGISTRY[category][name])) - {"data"} <= listed  # `data` is `bitmap` by another name
