"""Small files that describe more than any machine can hold end in one message that names file, line and limit."""

import pytest

from tests.io.documents import LAMP, SENSOR, scene_text, write_scene
from torch_radbp.io.load import load
from torch_radbp.plugin import SceneError

pytestmark = pytest.mark.hostile

WALL = '<shape type="rectangle"/>'


def refusal(path):
    with pytest.raises(SceneError) as caught:
        load(path)
    message = str(caught.value)
    assert "\n" not in message and len(message) < 1000
    return message


def write_parts(folder, count, body):
    """part0.xml, part1.xml, ...; `body(n)` is what stands in the n-th."""
    for number in range(count):
        write_scene(folder, body(number), f"part{number}.xml", complete=False)


def test_files_that_include_the_next_one_twice(tmp_path):
    write_parts(tmp_path, 23, lambda n: f'<include filename="part{n + 1}.xml"/>' * 2 if n < 22 else WALL)
    message = refusal(write_scene(tmp_path, '<include filename="part0.xml"/>'))
    assert "line 2: <include>: the scene includes more than 1000 files" in message and "part" in message


def test_a_long_chain_of_includes(tmp_path):
    write_parts(tmp_path, 600, lambda n: f'<include filename="part{n + 1}.xml"/>' if n < 599 else WALL)
    message = refusal(write_scene(tmp_path, '<include filename="part0.xml"/>'))
    assert "part48.xml, line 2: <include>: more than 50 files include one another in a chain" in message


def test_a_long_chain_of_includes_inside_objects(tmp_path):
    for number in range(45):
        inner = f'<include filename="bsdf{number + 1}.xml"/>' if number < 44 else '<bsdf type="diffuse"/>'
        nested = '<bsdf type="twosided">' * 4 + inner + "</bsdf>" * 4
        text = f'<bsdf type="twosided" version="3.0.0">{nested}</bsdf>'
        (tmp_path / f"bsdf{number}.xml").write_text(text)
    message = refusal(write_scene(tmp_path, f'{WALL[:-2]}><include filename="bsdf0.xml"/></shape>'))
    assert "line 1: <bsdf" in message and "objects are nested more than 100 deep, included files counted in" in message


def test_variables_in_variables(tmp_path):
    body = '<default name="a0" value="0.5 "/>' + "".join(
        f'\n<default name="a{n}" value="{f"$a{n - 1} " * 10}"/>' for n in range(1, 16))
    message = refusal(write_scene(tmp_path, body + f'<bsdf type="diffuse" id="$a15"/>{WALL}'))
    assert "scene.xml, line 7: <default name=\"a5\">" in message
    assert "variables in variables grow to more than 100000 characters here, at $a4" in message


def test_long_variables_in_many_places(tmp_path):
    values = "".join(f'<default name="x{n}" value="$a"/>' for n in range(300))
    message = refusal(write_scene(tmp_path, f'<default name="a" value="{"1" * 50_000}"/>{values}'))
    assert "variables in variables grow to more than 10000000 characters in this scene, at $a" in message


def test_many_elements(tmp_path, monkeypatch):
    monkeypatch.setattr("torch_radbp.io.xml_scene.MAX_ELEMENTS", 3000)
    write_scene(tmp_path, WALL * 400, "part.xml", complete=False)
    message = refusal(write_scene(tmp_path, '<include filename="part.xml"/>' * 20))
    assert "part.xml, line 2: <shape" in message and "the scene has more than 3000 elements" in message


def test_what_is_within_the_limits_loads(tmp_path):
    write_parts(tmp_path, 40, lambda n: WALL + (f'<include filename="part{n + 1}.xml"/>' if n < 39 else ""))
    scene = load(write_scene(tmp_path, '<include filename="part0.xml"/>'))
    assert len(scene.shapes) == 40 and len({scene.name_of(shape) for shape in scene.shapes}) == 40


def test_a_byte_order_mark_is_read_over(tmp_path):
    (tmp_path / "scene.xml").write_text(scene_text(WALL), encoding="utf-8-sig")
    assert len(load(tmp_path / "scene.xml").shapes) == 1
    (tmp_path / "scene.xml").write_text(scene_text(WALL), encoding="utf-16")
    assert len(load(tmp_path / "scene.xml").shapes) == 1


@pytest.mark.parametrize("content, message", [
    (b"", "not well-formed XML: no element found"),
    (b"\x89PNG\r\n\x1a\n", "not well-formed XML"),
    (b"\xef\xbb\xbf", "not well-formed XML: no element found"),
    ((SENSOR + LAMP).encode(), "line 1: not well-formed XML: junk after document element"),
    (b'<scene version="3.0.0">\xff</scene>', "line 1: not well-formed XML"),
])
def test_what_is_no_xml_is_named(tmp_path, content, message):
    (tmp_path / "scene.xml").write_bytes(content)
    assert f"{tmp_path / 'scene.xml'}, line 1: not well-formed XML" in refusal(tmp_path / "scene.xml")
    assert message in refusal(tmp_path / "scene.xml")
