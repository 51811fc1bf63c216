"""The pages of plugins: examples run as they are printed and are the same scene twice, and every key has its text once."""

from __future__ import annotations

import re
import warnings
from functools import cache
from pathlib import Path

import pytest
import torch
from torch import Tensor

from docs.plugin_code import WIDTH
from docs.plugin_examples import EXAMPLES
from docs.plugin_pages import page
from docs.plugin_pictures import scene_of
from docs.plugin_scenes import PLACE
from docs.plugin_table import parameters, texts
from torch_radbp import Renderer
from torch_radbp.plugin import REGISTRY, Plugin, Texture, attributes

PLUGINS = [(category, name) for category in REGISTRY for name in sorted(REGISTRY[category])]
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
SMALLER = {"256": "8", "128": "4", "64": "1", '"max_depth": 8': '"max_depth": 3',  # pixels of a side, samples, bounces
           '"max_depth" value="8"': '"max_depth" value="3"'}


@cache
def parts(category: str) -> dict[str, str]:
    """The text of a page by its headings."""
    _, *rest = re.split(r"^## (.*)$", "\n".join(page(category)), flags=re.MULTILINE)
    return dict(zip(rest[::2], rest[1::2]))


def blocks(category: str, heading: str) -> list[tuple[str, str]]:
    """Language and source of the blocks of code under a heading, with fewer pixels, samples and bounces."""
    return [(language, re.sub(r'\b(256|128|64)\b|"max_depth"(:| value=)( 8|"8")', lambda match: SMALLER[match[0]], source))
            for language, source in BLOCK.findall(parts(category)[heading])]


@pytest.fixture
def in_double_precision():
    """Both ways to write a pose round in float32, so that a ray at the edge of a square meets one or the other."""
    torch.set_default_dtype(torch.float64)
    yield
    torch.set_default_dtype(torch.float32)


def both(category: str, name: str, folder: Path) -> tuple[Tensor, Tensor]:
    """The images of an example by its dict and by its XML, all as printed."""
    (first, example), (second, element) = blocks(category, name)
    (_, scene), (_, file), (_, call) = blocks(category, "The scene around the examples")
    assert (first, second) == ("python", "xml") and PLACE in file
    by_dict: dict = {}
    exec(f"{example}\n{scene}", by_dict)
    (folder / "scene.xml").write_text(file.replace(PLACE, element))
    by_xml: dict = {}
    exec(call, by_xml)
    return by_dict["images"], by_xml["images"]


@pytest.mark.parametrize("category, name", PLUGINS)
def test_examples_render_as_printed_and_the_xml_means_the_same(category, name, tmp_path, monkeypatch, in_double_precision):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(Renderer, "runs_compiled", lambda renderer: False)  # for so few samples that takes longer
    with warnings.catch_warnings():
        if EXAMPLES[category][name].like:  # is rendered as another, and says so
            warnings.simplefilter("ignore")
        by_dict, by_xml = both(category, name, tmp_path)
    assert torch.isfinite(by_dict).all() and by_dict.amax() > 0
    torch.testing.assert_close(by_xml, by_dict, rtol=1e-9, atol=1e-9)  # poses differ by the rounding of float64


@pytest.mark.parametrize("category, name", PLUGINS)
def test_examples_show_the_plugin(category, name):
    (_, example), (_, element) = blocks(category, name)
    assert f'"type": "{name}"' in example
    assert f'type="{name}"' in element or f"<{name} " in element


@pytest.mark.parametrize("category, name", PLUGINS)
def test_every_key_has_a_text_and_stands_in_one_row_and_in_no_list(category, name):
    plugin, text = REGISTRY[category][name], parts(category)[name]
    rows = re.findall(r"^\| (`.*?) \|", text, re.MULTILINE)
    named = [key for row in rows for key in re.findall(r"`(\w+)`", row)]
    assert sorted(named) == sorted({*attributes(plugin), *parameters(plugin)})
    assert not [key for key in named if not texts(plugin)[key]]
    assert not re.search(r"see `[A-Z]|^- |Args|Attributes:|Parameters:|Raises", text, re.MULTILINE)


@pytest.mark.parametrize("category, name", PLUGINS)
def test_what_is_marked_as_having_derivatives_is_what_the_scene_has_parameters_of(category, name):
    marked = parameters(REGISTRY[category][name])
    if category in ("film", "rfilter", "sampler", "integrator"):
        assert not marked
        return
    found = [module for module in scene_of(category, name).modules() if isinstance(module, Plugin) and module.type == name]
    assert found
    for module in found:
        own = {key for key, _ in module.named_parameters(recurse=False)}
        textures = {key for key, child in module.named_children() if isinstance(child, Texture)}
        assert (own | textures) - {*getattr(module, "attribute_names", ())} <= {*marked}


def test_every_plugin_has_an_example_with_a_caption_and_a_picture_or_one_that_is_like_it():
    for category, examples in EXAMPLES.items():
        assert set(examples) == set(REGISTRY[category])
        for name, example in examples.items():
            assert re.fullmatch(r"[A-Z].*\.", example.caption) and "{" not in example.caption, name
            assert not example.like or not examples[example.like].like
    assert set(EXAMPLES) == set(REGISTRY)


@pytest.mark.parametrize("category", REGISTRY)
def test_lines_of_code_fit_their_box(category):
    lines = [line for _, source in BLOCK.findall("\n".join(page(category))) for line in source.splitlines()]
    assert len(max(lines, key=len)) <= WIDTH, max(lines, key=len)
