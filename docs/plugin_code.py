"""Objects of a scene, written once, as the Python and as the XML that is shown."""

from __future__ import annotations

import typing
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple
from xml.etree import ElementTree

from torch_radbp.plugin import REGISTRY, Attribute, Point3, Texture, attributes, options, plugin_categories

MODULES = {"np.": "import numpy as np", "torch.": "import torch", "rb.": "import torch_radbp as rb"}
WIDTH = 88  # of a line, about what fits beside the table of contents


class LookAt(NamedTuple):
    """A pose at `origin` that looks at `target`."""

    origin: tuple[float, ...]
    target: tuple[float, ...] = (0, 0, 0)
    up: tuple[float, ...] = (0, 0, 1)

    def python(self) -> str:
        return f"rb.look_at({', '.join(f'[{listed(point)}]' for point in self)})"

    def operations(self) -> dict[str, dict[str, str]]:
        return {"lookat": {name: listed(point) for name, point in self._asdict().items()}}


class Scaled(NamedTuple):
    """A pose with a scale along its axes."""

    pose: LookAt
    factor: float

    def python(self) -> str:
        return f"{self.pose.python()} @ torch.diag(torch.tensor([{listed([self.factor] * 3)}, 1.0]))"

    def operations(self) -> dict[str, dict[str, str]]:
        return {"scale": {"value": str(self.factor)}, **self.pose.operations()}


class Scale(NamedTuple):
    """A scale of the coordinates u and v."""

    u: float
    v: float

    def python(self) -> str:
        return f"np.diag([{self.u}, {self.v}, 1])"

    def operations(self) -> dict[str, dict[str, str]]:
        return {"scale": {"x": str(self.u), "y": str(self.v)}}


class Placed(NamedTuple):
    """A scale along the axes, and then a translation."""

    factors: tuple[float, float, float]
    offset: tuple[float, float, float]

    def python(self) -> str:
        (x, y, z), (a, b, c) = self
        return f"[[{x}, 0, 0, {a}], [0, {y}, 0, {b}], [0, 0, {z}, {c}], [0, 0, 0, 1]]"

    def operations(self) -> dict[str, dict[str, str]]:
        return {"scale": dict(zip("xyz", map(str, self.factors))), "translate": dict(zip("xyz", map(str, self.offset)))}


class Asset(NamedTuple):
    """A file that comes with the package."""

    name: str

    def python(self) -> str:
        return f'rb.asset("{self.name}")'


def listed(numbers: Iterable[float]) -> str:
    """Numbers with commas between them."""
    return ", ".join(map(str, numbers))


def python(value: Any, before: str = "") -> str:
    """The source of a value, which stands after `before` in a line."""
    if hasattr(value, "python"):
        source = value.python()
        if len(before + source) < WIDTH:
            return source
        start = "\n" + " " * len(before)
        return source.replace("], [", f"],{start} [") if source.startswith("[[") else source.replace(" @ ", f"{start}@ ")
    if not isinstance(value, dict):
        return f'"{value}"' if isinstance(value, str) else repr(value)
    entries = [f'"{key}": {python(item)}' for key, item in value.items()]
    line = f"{{{', '.join(entries)}}}"
    if len(before + line) < WIDTH:
        return line
    outer = " " * (len(before) - len(before.lstrip()))
    starts = {key: f'{outer}    "{key}": ' for key in value}
    return "{\n" + "".join(f"{starts[key]}{python(item, starts[key])},\n" for key, item in value.items()) + outer + "}"


def runnable(source: str) -> str:
    """Source with the imports that it needs."""
    used = [line for start, line in MODULES.items() if start in source]
    return "\n".join([*used, *[""] * bool(used), source])


def xml(objects: dict[str, Any]) -> str:
    """The elements of the objects of a scene, by their ids."""
    texts = []
    for name, value in objects.items():
        element = next(elements(name, value, None))
        ElementTree.indent(element, "    ")
        texts.append(ElementTree.tostring(element, encoding="unicode").replace(" />", "/>"))
    return "\n".join(texts)


def elements(key: str, value: Any, owner: type | None) -> Iterator[ElementTree.Element]:
    """The element of a value that an owner has under a key; a list has one for each entry. Without an owner: by id."""
    if isinstance(value, dict) and value["type"] == "ref":
        yield ElementTree.Element("ref", id=value["id"], **({"name": key} if is_texture(key, owner) else {}))
    elif isinstance(value, dict) and value["type"] == "rgb":
        yield ElementTree.Element("rgb", name=key, value=listed(value["value"]))
    elif isinstance(value, dict):
        category = next(category for category in REGISTRY if value["type"] in REGISTRY[category])
        element = ElementTree.Element(category, type=value["type"])
        if owner is None or category in ("texture", "volume") or is_named(attributes(owner), category):
            element.set("id" if owner is None else "name", key)
        for name, item in value.items():
            if name != "type":
                element.extend(elements(name, item, REGISTRY[category][value["type"]]))
        yield element
    else:
        yield plain(key, value, options(attributes(owner)[key].annotation))


def is_named(schema: dict[str, Attribute], category: str) -> bool:
    """True if an attribute takes several objects of a category by their names, or several attributes take one."""
    takes = [typing.get_origin(option) is dict for attribute in schema.values() for option in options(attribute.annotation)
             if category in plugin_categories(option)]
    return any(takes) or len(takes) > 1


def is_texture(key: str, owner: type | None) -> bool:
    """True if an owner reads a texture under a key."""
    schema = attributes(owner) if owner else {}
    return key in schema and Texture in options(schema[key].annotation)


def plain(key: str, value: Any, kinds: tuple[Any, ...]) -> ElementTree.Element:
    """The element of a plain value of an attribute that takes some kinds."""
    if hasattr(value, "operations"):
        element = ElementTree.Element("transform", name=key)
        for tag, numbers in value.operations().items():
            ElementTree.SubElement(element, tag, numbers)
        return element
    if isinstance(value, list):
        tag = "point" if Point3 in kinds else "rgb" if Texture in kinds else "vector"
        return ElementTree.Element(tag, name=key, value=listed(value))
    if isinstance(value, (Asset, str)):
        return ElementTree.Element("string", name=key, value=value.name if isinstance(value, Asset) else value)
    if isinstance(value, bool):
        return ElementTree.Element("boolean", name=key, value=str(value).lower())
    return ElementTree.Element("integer" if int in kinds else "float", name=key, value=str(value))
