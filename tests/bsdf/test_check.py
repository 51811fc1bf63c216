"""Every BSDF of the package has a row in `lanes.py`, and is what `check_bsdf` wants of one."""

import pytest

from tests.bsdf.lanes import KINDS, material
from tests.deep import deep_but
from tests.scenes.materials import MATERIALS
from torch_radbp.check import check_bsdf
from torch_radbp.check.balance import claims
from torch_radbp.plugin import BSDF, REGISTRY, register

QUICK = {"samples": 10_000}
RICH = ("bumps", "hills", "leaf", "nested blend")  # of several plugins each
PLUGINS = [name for name, plugin in REGISTRY["bsdf"].items() if plugin.__module__.startswith("torch_radbp.")]
# What the models are known for, see `test_energy.py`; of others it is checked.
NOT_RECIPROCAL = {"film", "sheet with all", "bumps", "brushed bumps", "mirror with bumps", "glass with bumps", "hills",
                  "glass with hills"}


def types_in(description) -> set[str]:
    """The types of a material and of those in it."""
    if not isinstance(description, (dict, list)):
        return set()
    own, parts = ({description["type"]}, description.values()) if isinstance(description, dict) else (set(), description)
    return own.union(*map(types_in, parts))


def covering(materials: dict) -> list[str]:
    """Materials that together have every plugin that any of them has; of several the first."""
    found, chosen = set(), []
    for name, description in materials.items():
        if not types_in(description) <= found:
            found |= types_in(description)
            chosen.append(name)
    return chosen


def check_has_row(plugin: str) -> None:
    assert plugin in types_in(list(MATERIALS.values())), (
        f"the bsdf {plugin!r} has no row: add one, of numbers and colours none of which is special, to MATERIALS in "
        f"tests/scenes/materials.py; the tests of this folder then examine it")


@pytest.mark.parametrize("plugin", PLUGINS)
def test_every_bsdf_has_a_row(plugin):
    check_has_row(plugin)


def test_a_new_bsdf_without_a_row_is_named():
    register("bsdf", "glitter")(type("Glitter", (BSDF,), {}))
    try:
        with pytest.raises(AssertionError, match="the bsdf 'glitter' has no row: .* in tests/scenes/materials.py"):
            check_has_row("glitter")
    finally:
        del REGISTRY["bsdf"]["glitter"]


@pytest.mark.parametrize("name", deep_but(covering({name: MATERIALS[name] for name in (*RICH, *MATERIALS)}), MATERIALS))
def test_a_material_is_what_it_says(name):
    result = check_bsdf(material(MATERIALS[name]), **QUICK)
    assert result.agrees, str(result)


def test_only_models_that_are_known_for_it_claim_less():
    assert {name for name, kind in KINDS.items() if not claims(kind, "reciprocal")} == NOT_RECIPROCAL
    burley = {name for name in MATERIALS if types_in(MATERIALS[name]) & {"principled", "principledthin"}}
    assert {name for name, kind in KINDS.items() if not claims(kind, "conserves")} == burley
