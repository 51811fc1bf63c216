"""Reads an XML file into a tree of elements that know their line.

A scene file may come from anywhere, so that document type declarations, and with them entities of every kind, are
refused before they are read, and nesting is limited. Text between elements is left out with a warning.
"""

from __future__ import annotations

import os
import warnings
from typing import NamedTuple
from xml.parsers import expat

from torch_radbp.formats.files import opened
from torch_radbp.plugin import SceneError, SceneWarning

MAX_DEPTH = 100


class Element(NamedTuple):
    """One element of an XML file."""

    tag: str
    attributes: dict[str, str]
    children: list[Element]
    file: str
    line: int

    def __str__(self) -> str:
        """The place of the element and its first words, as error messages print them."""
        named = "".join(f' {key}="{abridged(self.attributes[key])}"' for key in ("type", "id", "name")
                        if key in self.attributes)
        return f"{self.file}, line {self.line}: <{self.tag}{named}>"

    def fail(self, message: str) -> SceneError:
        """An error about this element, to be raised."""
        return SceneError(f"{self}: {message}")


def abridged(text: str, length: int = 80) -> str:
    """Shortens a long text, for messages."""
    return text if len(text) <= length else f"{text[:length]}..."


def read_xml(path: str | os.PathLike) -> Element:
    """Reads an XML file and returns its root element.

    Raises:
        SceneError: if the file cannot be read, is not well-formed XML, declares a document type or entities, or nests
            deeper than `MAX_DEPTH`.
    """
    file = os.fspath(path)
    try:
        with opened(path) as source:
            return parse_xml(source.read(), file)
    except OSError as error:
        raise SceneError(str(error)) from error


def parse_xml(content: bytes, file: str) -> Element:
    """Parses an XML document in memory and returns its root; `file` is the name for messages. Raises as `read_xml`."""
    parser = expat.ParserCreate()
    document = Element("", {}, [], file, 0)
    open_elements = [document]

    def fail(message: str) -> SceneError:
        return SceneError(f"{file}, line {parser.CurrentLineNumber}: {message}")

    def start(tag: str, attributes: dict[str, str]) -> None:
        if len(open_elements) > MAX_DEPTH:
            raise fail(f"elements are nested more than {MAX_DEPTH} deep")
        element = Element(tag, attributes, [], file, parser.CurrentLineNumber)
        open_elements[-1].children.append(element)
        open_elements.append(element)

    def text(data: str) -> None:
        if data.strip():
            warnings.warn(f"{file}, line {parser.CurrentLineNumber}: the text {data.strip()[:40]!r} is left out, as in "
                          "Mitsuba; values are written as attributes, value=\"...\"", SceneWarning, stacklevel=2)

    def refuse_doctype(*_) -> None:
        raise fail("a document type declaration (<!DOCTYPE ...>) or entity is not allowed in a scene; "
                   "use <default name= value=> and $name for values and <include filename=> for files")

    parser.StartElementHandler = start
    parser.EndElementHandler = lambda tag: open_elements.pop()
    parser.CharacterDataHandler = text
    parser.StartDoctypeDeclHandler = refuse_doctype
    parser.EntityDeclHandler = refuse_doctype
    parser.ExternalEntityRefHandler = refuse_doctype
    try:
        parser.Parse(content, True)
    except expat.ExpatError as error:
        reason = expat.ErrorString(error.code)
        raise SceneError(f"{file}, line {error.lineno}: not well-formed XML: {reason}") from error
    except (LookupError, ValueError) as error:
        if isinstance(error, SceneError):
            raise
        raise SceneError(f"{file}: its XML encoding is not supported ({error}); save it as UTF-8") from error
    return document.children[0]
