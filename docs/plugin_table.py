"""The table of a plugin's keys, and what else its docstring says, from the docstrings of its class and of their bases."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from itertools import groupby
from typing import Any

from docs.escaped import escaped
from torch_radbp.plugin import Attribute, Texture, attributes, options

SECTION = re.compile(r"^(Args|Attributes|Raises|Returns|Reference):", re.MULTILINE)
EVIDENT = re.compile(r"^Derivatives:\s+with\s+respect\s+to\s+(its\s+texels|it|both|all|all\s+of\s+them|these|`value`|"
                     r"its\s+value)\.(\s|$)", re.MULTILINE)  # as the marks in the table say
WORDS = {"bool": "true or false", "int": "integer", "float": "number", "str": "string", "Matrix4": "4 x 4 transform",
         "Point3": "point", "Filename": "file", "Tensor": "array", "Samples": "spectrum",
         "TriangleMesh": "trimesh.Trimesh or trimesh.Scene"}


def table(plugin: type) -> Iterator[str]:
    """The lines of a table: the keys, and after them parameters that are no keys."""
    schema, described, live = attributes(plugin), texts(plugin), parameters(plugin)
    kinds = {name: (kind_of(attribute.annotation), default_of(attribute)) for name, attribute in schema.items()}
    kinds |= {name: ("parameter, not a key", "") for name in live if name not in schema}
    rows = [(f"`{name}`{' ∂' if name in live else ''}", f"*{kind}*: {described[name]} | {default}")
            for name, (kind, default) in kinds.items()]
    if rows:
        yield from ("| key | what it is | default |", "|---|---|---|")
    for rest, alike in groupby(rows, lambda row: row[1]):
        yield f"| {', '.join(name for name, _ in alike)} | {rest} |"


def texts(plugin: type) -> dict[str, str]:
    """By key or parameter what the docstrings say, those of subclasses before those of their bases."""
    found: dict[str, str] = {}
    for cls in reversed(plugin.__mro__):
        for title, body in sections(cls):
            if title in ("Args", "Attributes"):
                for entry in re.split(r"\n(?=\S)", inspect.cleandoc(body)):
                    names, _, text = entry.partition(":")
                    found |= {name.strip(): escaped(" ".join(text.split())) for name in names.split(",")}
    return found


def parameters(plugin: type) -> list[str]:
    """The keys that have derivatives, and parameters that are no keys: textures, and what docstrings list."""
    textures = [name for name, attribute in attributes(plugin).items() if Texture in options(attribute.annotation)]
    listed = [name for cls in plugin.__mro__ for _, body in sections(cls)
              for sentence in re.findall(r"^Parameters: (.*?)\.(?:\s|$)", body, re.MULTILINE | re.DOTALL)
              for name in re.findall(r"`(\w+)`", sentence)]
    return list(dict.fromkeys([*textures, *listed]))


def sections(cls: type) -> Iterator[tuple[str, str]]:
    """The sections of a class's own docstring, the text before them first, by their titles."""
    first, *rest = SECTION.split(inspect.cleandoc(cls.__dict__.get("__doc__") or ""))
    yield "", first
    yield from zip(rest[::2], rest[1::2])


def prose(plugin: type) -> list[str]:
    """The paragraphs of a docstring, without what the table has."""
    text = re.sub(r"^Parameters: .*?\.(?:\s|$)", "", dict(sections(plugin))[""], flags=re.MULTILINE | re.DOTALL)
    text = EVIDENT.sub("", text)
    return [escaped(paragraph.rstrip()) for paragraph in text.split("\n\n") if paragraph.strip()]


def kind_of(annotation: Any) -> str:
    """What an attribute takes, in words."""
    members = [option for option in options(annotation) if option is not type(None)]
    return " or ".join(dict.fromkeys(name_of(member) for member in members))


def name_of(member: Any) -> str:
    """A member of an annotation, in words."""
    if origin := getattr(member, "__origin__", None):
        inner = name_of(member.__args__[-1])
        return f"{inner}s by name" if origin is dict else f"one or more of {inner}"
    return getattr(member, "category", "") or WORDS[member.__name__]


def default_of(attribute: Attribute) -> str:
    """The default of an attribute, as code."""
    if attribute.default is None:
        return "needed" if attribute.required else ""
    return f"`{attribute.default:.4g}`" if isinstance(attribute.default, float) else f"`{attribute.default}`"
