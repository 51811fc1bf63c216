"""What notebooks show of scenes and checks: the tables of their text as well-formed HTML, escaped."""

import xml.etree.ElementTree as ElementTree

import pytest

import torch_radbp as rb
from torch_radbp.formats.html_table import MOST_ROWS, html_table


def cells(html: str) -> list[str]:
    """The text of all cells, of HTML that must be well-formed."""
    tree = ElementTree.fromstring(f"<all>{html}</all>")
    return ["".join(cell.itertext()) for cell in tree.iter() if cell.tag in ("td", "th")]


@pytest.fixture(scope="module")
def scene():
    return rb.load(rb.asset("cornell_box/scene.xml"), resolution=8)


def test_text_is_escaped():
    html = html_table("<a>", ("b & c",), [("<script>",)], "'d'")
    assert "<script>" not in html and cells(html) == ["b & c", "<script>"]


def test_a_long_table_says_how_much_is_left_out():
    html = html_table("numbers", ("n",), [(number,) for number in range(MOST_ROWS + 3)])
    assert "and 3 more" in html and len(cells(html)) == MOST_ROWS + 1
    assert "more" not in html_table("numbers", ("n",), [(1,)])


def test_a_scene_shows_shapes_emitters_sensors_and_parameters_with_shapes(scene):
    scene.get_parameter("green.reflectance.value").requires_grad_()
    shown = cells(scene._repr_html_())
    for shape in scene.shapes:
        assert scene.name_of(shape) in shown
    rows = [shown[place:place + 4] for place in range(len(shown)) if shown[place] == "green.reflectance.value"]
    value = scene.get_parameter("green.reflectance.value")
    assert rows == [["green.reflectance.value", "3", f"{float(value.mean()):.4g}", "yes"]]
    assert {"8 x 8", scene.name_of(scene.emitters[0])} <= set(shown)
    scene.get_parameter("green.reflectance.value").requires_grad_(False)


def test_checks_show_what_they_print(scene):
    check = rb.check_gradient(scene, "green.reflectance.value", spp=16, max_depth=2)
    html = check._repr_html_()
    assert check.verdict in html and {cell for row in check.rows() for cell in row} <= set(cells(html))
    plugin = rb.check_texture({"type": "rgb", "value": 0.5})
    assert {finding.check for finding in plugin.findings} <= set(cells(plugin._repr_html_()))
    assert plugin.verdict in plugin._repr_html_()
