"""XML is parsed safely, and every element knows its line."""

import time

import pytest

from torch_radbp.io.xml import MAX_DEPTH, parse_xml, read_xml
from torch_radbp.plugin import SceneError, SceneWarning

BILLION_LAUGHS = "<!DOCTYPE scene [" + '<!ENTITY a0 "ha">' + "".join(
    f'<!ENTITY a{n} "{f"&a{n - 1};" * 10}">' for n in range(1, 30)) + ']>\n<scene version="3.0.0" id="&a29;"/>'


def test_elements_know_file_and_line():
    root = parse_xml(b'<scene version="3.0.0">\n<shape\n type="cube" id="box"/>\n<!-- <x/> --><bsdf/></scene>', "a.xml")
    assert [(child.tag, child.line) for child in root.children] == [("shape", 2), ("bsdf", 4)]
    assert str(root.children[0]) == 'a.xml, line 2: <shape type="cube" id="box">'


@pytest.mark.parametrize("document", [
    BILLION_LAUGHS,
    '<!DOCTYPE scene [<!ENTITY secret SYSTEM "file:///etc/passwd">]>\n<scene version="3.0.0" id="&secret;"/>',
    '<!DOCTYPE scene SYSTEM "http://localhost:9/scene.dtd">\n<scene version="3.0.0"/>',
    '<!DOCTYPE scene [<!ENTITY % more SYSTEM "file:///etc/passwd"> %more;]>\n<scene version="3.0.0"/>',
    '<!DOCTYPE scene>\n<scene version="3.0.0"/>',
])
def test_document_types_and_entities_are_refused_at_once(document):
    start = time.perf_counter()
    with pytest.raises(SceneError, match=r"evil\.xml, line 1: .*DOCTYPE.*not allowed.*<include"):
        parse_xml(document.encode(), "evil.xml")
    assert time.perf_counter() - start < 1.0


@pytest.mark.parametrize("document, message", [
    (b'<scene version="3.0.0">\n<shape>\n</scene>', "line 3: not well-formed XML: mismatched tag"),
    (b"", "not well-formed XML: no element found"),
    (b"<scene>&undefined;</scene>", "line 1: not well-formed XML: undefined entity"),
    (b"<a>" * (MAX_DEPTH + 1), f"nested more than {MAX_DEPTH} deep"),
    (b'<?xml version="1.0" encoding="klingon"?><scene/>', "encoding"),
    (b'<scene a="1" a="2"/>', "duplicate attribute"),
    (b"\x00\x01\x02", "not well-formed"),
])
def test_documents_that_are_not_plain_xml_are_refused(document, message):
    with pytest.raises(SceneError, match=message):
        parse_xml(document, "bad.xml")


def test_text_between_elements_is_left_out_with_a_warning():
    """Mitsuba leaves it out, too."""
    with pytest.warns(SceneWarning, match="a.xml, line 2: the text 'hello' is left out"):
        root = parse_xml(b'<scene>\nhello<shape type="cube"/></scene>', "a.xml")
    assert [child.tag for child in root.children] == ["shape"]


def test_predefined_entities_and_utf8_are_read():
    root = parse_xml('<scene id="a &amp; b &#228; ö"/>'.encode(), "a.xml")
    assert root.attributes["id"] == "a & b ä ö"


def test_a_missing_file_and_a_folder_are_named(tmp_path):
    with pytest.raises(SceneError, match=r"nothing\.xml: file not found"):
        read_xml(tmp_path / "nothing.xml")
    with pytest.raises(SceneError, match="is a folder"):
        read_xml(tmp_path)
