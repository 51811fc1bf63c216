"""Converts Mitsuba 3 scene XML to the dict vocabulary, with the place of every value beside it.

    <scene version="3.0.0">                      {"type": "scene",
        <default name="spp" value="16"/>
        <bsdf type="diffuse" id="white">          "white": {"type": "diffuse", "id": "white",
            <rgb name="reflectance"                         "reflectance": {"type": "rgb",
                 value="0.8, 0.7, 0.6"/>                                    "value": [0.8, 0.7, 0.6]}},
        </bsdf>
        <shape type="sphere">                     "sphere": {"type": "sphere",
            <ref id="white"/>                                "ref": {"type": "ref", "id": "white"}}}
        </shape>
    </scene>
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from torch_radbp.io.xml import MAX_DEPTH, Element, abridged, read_xml
from torch_radbp.io.xml_upgrade import upgraded
from torch_radbp.io.xml_values import PROPERTIES, check_element, property_value
from torch_radbp.plugin import REGISTRY, nearest

DIRECTIVES = ("default", "include", "path", "alias")
UNSUPPORTED_OBJECTS = ("field",)

# A few small files can describe more than any machine can hold, by including each other and by variables in variables.
MAX_CHAIN = 50  # files that are open at once, each including the next
MAX_INCLUDES = 1000
MAX_ELEMENTS = 1_000_000
MAX_TEXT = 100_000  # characters of one attribute with its variables replaced
MAX_TEXTS = 10_000_000  # and of all such attributes

VERSION = re.compile(r"(\d{1,9})(\.\d+){0,2}", re.ASCII)


class XMLObject(dict):
    """An object of a scene as a dict, with its XML element and those of its attributes."""

    def __init__(self, element: Element, folders: list[Path]):
        super().__init__()
        self.element = element
        self.folders = folders  # where relative file names are looked for, first match wins
        self.places: dict[str, Element] = {}  # attribute name -> its own element

    @property
    def category(self) -> str:
        """The plugin category of the element's tag."""
        return "texture" if self.element.tag == "spectrum" else self.element.tag


def read_scene(path: str | os.PathLike, variables: dict[str, Any]) -> XMLObject:
    """Reads a scene file, with all that it includes.

    Args:
        path: the file.
        variables: values for `$name` in attributes; they win over <default>.

    Raises:
        SceneError: on anything that is not Mitsuba 3 scene XML, and on variables that no attribute uses.
    """
    reader = _Reader({name: _as_text(value) for name, value in variables.items()})
    root = reader.open(Path(path))
    if root.tag != "scene":
        raise root.fail("the root of a scene file must be <scene version=\"3.0.0\">")
    scene = reader.scene(root)
    for name in variables:
        if name not in reader.used:
            raise root.fail(f"the value given for {name!r} is not used: no attribute of the scene contains ${name}; "
                            f"{nearest(name, reader.used)}")
    return scene


def _as_text(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


class _Reader:
    """Reads one scene: holds its variables, ids and files."""

    def __init__(self, variables: dict[str, str]):
        self.variables = variables
        self.used: set[str] = set()
        self.open_files: list[Path] = []  # the file being read and those that include it
        self.folders: list[Path] = []
        self.ids: dict[str, Element] = {}
        self.aliases: dict[str, str] = {}
        self.references: list[XMLObject] = []
        self.depth = 0  # of the object being read
        self.includes = self.elements = self.characters = 0  # so far, to be limited

    def open(self, path: Path) -> Element:
        """Opens a scene file and checks its version; from here on relative names are looked for beside it."""
        root = self.substitute(read_xml(path))
        if _is_of_old_version(root):
            root = upgraded(root)
        self.open_files.append(path.resolve())
        self.folders = [path.parent, *self.folders]
        return root

    def scene(self, root: Element) -> XMLObject:
        """Converts the whole scene; children without an id are called by their type: rectangle, rectangle_1, ..."""
        check_element(root, ("version",), ("type", "id", "name"))
        scene = XMLObject(root, self.folders)
        scene["type"] = "scene"
        children = []
        for element in self.expand(root.children):
            if element.tag in PROPERTIES and "type" not in element.attributes:
                raise element.fail(f"<scene> takes no values; supported inside it: {_supported()}")
            children.append(self.child(element))
        used = {"type": 0, **{child["id"]: 0 for child in children if "id" in child and child["type"] != "ref"}}
        for child in children:
            name = child.get("id") if child["type"] != "ref" else None
            scene[name or _free_name(child["type"], used)] = child
        for reference in self.references:
            reference["id"] = self.aliases.get(reference["id"], reference["id"])
        return scene

    def child(self, element: Element) -> XMLObject:
        """Converts a plugin or a reference to one."""
        if element.tag == "ref":
            check_element(element, ("id",), ("name",))
            reference = XMLObject(element, self.folders)
            reference.update(type="ref", id=element.attributes["id"])
            self.references.append(reference)
            return reference
        return self.plugin(element)

    def plugin(self, element: Element) -> XMLObject:
        """Converts one object with its attributes and nested objects."""
        if element.tag in UNSUPPORTED_OBJECTS:
            raise element.fail(f"fields are not supported; supported here: {_supported()}")
        if element.tag not in (*REGISTRY, "spectrum"):
            raise element.fail(f"this element is not supported; supported here: {_supported()}, "
                               f"{', '.join(PROPERTIES)}")
        check_element(element, ("type",), ("id", "name", "version"))
        self.depth += 1
        if self.depth > MAX_DEPTH:
            raise element.fail(f"objects are nested more than {MAX_DEPTH} deep, included files counted in")
        node = XMLObject(element, self.folders)
        node["type"] = element.attributes["type"]
        if element.attributes.get("id"):
            node["id"] = self.register(element)
        used = {child.attributes["name"]: 0 for child in element.children if "name" in child.attributes}
        for child in self.expand(element.children):
            is_value = child.tag in PROPERTIES and not (child.tag == "spectrum" and "type" in child.attributes)
            value = property_value(child) if is_value else self.child(child)
            name = child.attributes.get("name") or _free_name(child.tag, used)
            if name in node.places or name in ("type", "id"):
                first = f"first in line {node.places[name].line}" if name in node.places else "it is reserved"
                raise child.fail(f"the name {name!r} is given twice in <{element.tag}> ({first})")
            node[name], node.places[name] = value, child
        self.depth -= 1
        return node

    def register(self, element: Element) -> str:
        """Registers the id of an element, which must be new."""
        name = element.attributes["id"]
        if name == "type":
            raise element.fail("the id 'type' is reserved; use another")
        if name in self.ids or name in self.aliases:
            first = self.ids[self.aliases.get(name, name)]
            raise element.fail(f"the id {name!r} is already taken by {first}; every id must be unique")
        self.ids[name] = element
        return name

    def expand(self, children: list[Element]) -> Iterator[Element]:
        """Yields elements with variables replaced, directives applied, and <include> replaced by the file's elements."""
        for child in children:
            self.elements += 1
            if self.elements > MAX_ELEMENTS:
                raise child.fail(f"the scene has more than {MAX_ELEMENTS} elements, included files counted in; give what is "
                                 "the same an id and refer to it")
            element = self.substitute(child)
            if element.tag == "include":
                yield from self.include(element)
            elif element.tag in DIRECTIVES:
                getattr(self, element.tag)(element)
            else:
                yield element

    def include(self, element: Element) -> Iterator[Element]:
        """Yields the elements of an included file: the children of its <scene>, or its only object."""
        check_element(element, ("filename",), ("name",))
        filename = element.attributes["filename"]
        path = find_file(filename, self.folders)
        if path is None:
            raise element.fail(f"file {abridged(filename)!r} not found; looked in {_listed(self.folders)}")
        if path.resolve() in self.open_files:
            raise element.fail(f"{filename!r} includes itself")
        self.includes += 1
        if len(self.open_files) >= MAX_CHAIN:
            raise element.fail(f"more than {MAX_CHAIN} files include one another in a chain; include them from one file")
        if self.includes > MAX_INCLUDES:
            raise element.fail(f"the scene includes more than {MAX_INCLUDES} files, counted as often as they are included; "
                               "does each include the next one twice?")
        outer = self.folders
        root = self.open(path)
        if root.tag == "scene":
            yield from self.expand(root.children)
        else:
            name = element.attributes.get("name")
            yield root._replace(attributes={**root.attributes, **({"name": name} if name else {})})
        self.open_files.pop()
        self.folders = outer

    def default(self, element: Element) -> None:
        """Sets the default of a variable."""
        check_element(element, ("name", "value"))
        self.variables.setdefault(element.attributes["name"], element.attributes["value"])

    def path(self, element: Element) -> None:
        """Adds a folder in which files are looked for."""
        check_element(element, ("value",))
        folder = find_file(element.attributes["value"], self.folders, os.path.isdir)
        if folder is None:
            raise element.fail(f"folder {element.attributes['value']!r} not found; looked in {_listed(self.folders)}")
        self.folders = [folder, *self.folders]

    def alias(self, element: Element) -> None:
        """Registers a second id for an earlier object."""
        check_element(element, ("id", "as"))
        source, alias = element.attributes["id"], element.attributes["as"]
        if source not in self.ids and source not in self.aliases:
            raise element.fail(f"no object with the id {source!r} comes before; {nearest(source, self.ids)}")
        if alias in self.ids or alias in self.aliases:
            raise element.fail(f"the id {alias!r} is already taken; every id must be unique")
        self.aliases[alias] = self.aliases.get(source, source)

    def substitute(self, element: Element) -> Element:
        """Replaces `$name` in the element's attributes, and in the operations of a transform."""
        attributes = {key: self.replace(value, element) for key, value in element.attributes.items()}
        if element.tag == "transform":
            element = element._replace(children=[self.substitute(child) for child in element.children])
        return element._replace(attributes=attributes)

    def replace(self, text: str, element: Element) -> str:
        """Replaces variables in `text`, the longest matching name first; a backslash before $ escapes it."""
        result, *pieces = text.split("$")
        for piece in pieces:
            if result.endswith("\\"):
                result = f"{result[:-1]}${piece}"
                continue
            name = max((name for name in self.variables if piece.startswith(name)), key=len, default="")
            if not name:
                wanted = re.match(r"\w*", piece)[0]
                raise element.fail(f"${wanted} has no value; give one, load(path, {wanted or 'name'}=...), or declare "
                                   f"<default name=\"{wanted}\" value=\"...\"/> before it; "
                                   f"{nearest(wanted, self.variables)}")
            self.used.add(name)
            result += self.variables[name] + piece[len(name):]
            self.characters += len(self.variables[name])
            if len(result) > MAX_TEXT or self.characters > MAX_TEXTS:
                limit = f"{MAX_TEXT} characters here" if len(result) > MAX_TEXT else f"{MAX_TEXTS} characters in this scene"
                raise element.fail(f"variables in variables grow to more than {limit}, at ${name}; write their values out")
        return result


def find_file(name: str, folders: list[Path], exists: Callable[[Path], bool] = os.path.isfile) -> Path | None:
    """The path of `name` in the first of `folders` that has it, or None; an absolute name stands for itself."""
    return next((folder / name for folder in folders if exists(folder / name)), None)


def _is_of_old_version(root: Element) -> bool:
    """True if a file is for Mitsuba 0.x or 1.x; raises on unknown versions."""
    version = root.attributes.get("version")
    if version is None:
        raise root.fail("the attribute 'version' is missing; scenes of Mitsuba 3 begin with <scene version=\"3.0.0\">")
    match = VERSION.fullmatch(version)
    if not match:
        raise root.fail(f"version must read like \"3.0.0\", got {version!r}")
    if int(match[1]) > 3:
        raise root.fail(f"version {version} is newer than what is supported, which is 0.4.0 to 3.x")
    return int(match[1]) < 2


def _free_name(name: str, used: dict[str, int]) -> str:
    """A free name: `name`, or name_1, name_2, ...; `used` holds the last number of each name, and is updated."""
    number, free = used.get(name, 0), name
    while free in used:
        number += 1
        free = f"{name}_{number}"
    used[name] = number
    used.setdefault(free, 0)
    return free


def _listed(folders: list[Path]) -> str:
    return ", ".join(str(folder.resolve()) for folder in folders)


def _supported() -> str:
    return ", ".join([*REGISTRY, "ref", *DIRECTIVES])

