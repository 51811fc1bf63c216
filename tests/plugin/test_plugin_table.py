"""The documentation's table of Mitsuba's plugins says what is registered, and leaves none of them out."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import torch_radbp as rb
from torch_radbp.plugin import REGISTRY, attributes

TABLE = Path(__file__).parents[2] / "docs" / "what_there_is.md"
CATEGORIES = {  # by the first cell of a row: ours, Mitsuba's
    "BSDFs": ("bsdf", "BSDF"), "Emitters": ("emitter", "Emitter"), "Shapes": ("shape", "Shape"),
    "Textures and spectra": ("texture", "Texture"), "Sensors": ("sensor", "Sensor"), "Films": ("film", "Film"),
    "Filters": ("rfilter", "ReconstructionFilter"), "Samplers": ("sampler", "Sampler"),
    "Integrators": ("integrator", "Integrator"), "Media": (None, "Medium"), "Phase functions": (None, "PhaseFunction"),
    "Volumes": (None, "Volume"),
}
# Mitsuba's integrators that are written in Python, and are no files of its folder of plugins.
IN_PYTHON = {"direct_projective", "prb", "prb_basic", "prb_projective", "prbvolpath", "volprim_rf_basic"}


def table() -> dict[str, list[set[str]]]:
    """By category the names that are supported, those beyond Mitsuba's, and those that are not supported."""
    rows = re.findall(rf"^\| ({'|'.join(CATEGORIES)}) \|(.*)\|$", TABLE.read_text(), re.MULTILINE)
    found = {}
    for category, rest in rows:
        cells = rest.split("|")
        assert len(cells) == 3, f"the row {category} must have 4 cells"
        names = [name for cell in cells for chunk in re.findall(r"`([^`]*)`", cell) for name in chunk.split()]
        assert len(names) == len(set(names)), f"{category}: a plugin is listed twice"
        found[category] = [{name for chunk in re.findall(r"`([^`]*)`", cell) for name in chunk.split()} for cell in cells]
    return found


def beyond_mitsuba() -> set[str]:
    """The plugins that Mitsuba does not have, so that nothing of hers is compared with them."""
    return set().union(*(beyond for _, beyond, _ in table().values()))


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
