"""No plugin and no parameter is forgotten: all that the code registers is examined in a scene of this folder."""

import pytest
import torch

from tests.scenes.every_plugin import SCENES, build
from tests.scenes.moving import SCENES as MOVING_SCENES
from tests.scenes.pairs import CATEGORIES, Pair, examined, nested, own_parameters, pairs_of, registered
from tests.scenes.quiet import is_still
from torch_radbp.plugin import REGISTRY, Plugin, Texture, register

PAIRS = sorted(registered())


@pytest.fixture(scope="module")
def found():
    return set().union(*(examined(build(name)) for name in SCENES))


@pytest.mark.parametrize("pair", PAIRS, ids=str)
def test_a_scene_examines(pair, found):
    assert pair in found, f"no scene of tests/scenes/every_plugin.py has {pair} in its subject: add one"


@pytest.mark.parametrize("category, kind", [  # but for those without parameters
    (c, k) for c in CATEGORIES for k in REGISTRY[c] if k not in ("null", "isotropic", "rayleigh")])
def test_a_scene_has_the_plugin(category, kind, found):
    assert any(pair.plugin == f"{category} {kind}" for pair in found), f"no scene examines the {category} {kind}: add one"


def test_every_parameter_that_moves_something_is_moved_in_expectation():
    """In a scene of `moving_scenes.py`; the others are in `test_still_parameters.py` by themselves."""
    moved = set().union(*(pairs_of(moving.build(), moving.name) for moving in MOVING_SCENES.values()))
    missing = [str(pair) for pair in PAIRS if not is_still(pair) and pair not in moved]
    assert not missing, f"no scene moves {missing}: add some"


def test_what_modules_register_is_what_their_code_says(found):
    assert len(PAIRS) > 40
    direct = {Pair(f"{c} {k}", name) for c in CATEGORIES for k, plugin in REGISTRY[c].items()
              for name in own_parameters(plugin)}
    for name in SCENES:
        for module in build(name).modules():
            if isinstance(module, Plugin) and module.category in CATEGORIES:
                given = getattr(module, "attribute_names", ())  # by files
                for parameter in {name for name, _ in module.named_parameters(recurse=False)} - set(given):
                    assert Pair(f"{module.category} {module.type}", parameter) in direct


def test_a_new_plugin_is_noticed():
    class Glitter(Plugin):
        def __init__(self, *, colour: Texture | float = 1.0):
            super().__init__()
            self.freeze("size", torch.tensor(1.0))

    register("bsdf", "glitter")(Glitter)
    try:
        assert {Pair("bsdf glitter", "size"), Pair("bsdf glitter", "colour")} == registered() - set(PAIRS)
        assert own_parameters(Glitter) == {"size"} and nested(Glitter) == {"colour"}
    finally:
        del REGISTRY["bsdf"]["glitter"]
