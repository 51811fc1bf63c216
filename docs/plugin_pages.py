"""Writes a page for each category of plugins from their registry: docstrings, parameters with defaults, and pictures."""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import torch

from docs.contents import PAGES
from docs.docstring import escaped, markdown_of
from docs.plugin_pictures import EXAMPLES, draw
from torch_radbp.plugin import REGISTRY, Attribute, attributes, options

WORDS = {bool: "true or false", int: "integer", float: "number", str: "string", type(None): "none"}


def write_plugin_pages(folder: Path) -> None:
    """Writes a page for each category, their index, and the pictures that are not there yet, into a folder."""
    folder.mkdir(exist_ok=True)
    for category in REGISTRY:
        (folder / f"{category}.md").write_text("\n".join(page(category, folder)) + "\n")
    (folder / "index.md").write_text("\n".join(index()) + "\n")


def index() -> Iterator[str]:
    """The lines of the index."""
    yield from ("# Plugins", "", "What a scene is made of, by Mitsuba's names, with its parameters and defaults. "
                "`radbp info scene.xml` says how a scene's own parameters are called.", "", ":::{toctree}", ":hidden:",
                "", *REGISTRY, ":::", "", "| | |", "|---|---|")
    for category in REGISTRY:
        names = ", ".join(f"[`{name}`]({category}.md#{name})" for name in sorted(REGISTRY[category]))
        yield f"| [{PAGES[category].title}]({category}.md) | {names} |"


def page(category: str, folder: Path) -> Iterator[str]:
    """The lines of a category's page."""
    yield from (f"# {PAGES[category].title}", "", PAGES[category].about)
    for name, plugin in sorted(REGISTRY[category].items()):
        yield from ("", f"## {name}", "")
        if name in EXAMPLES.get(category, {}):
            picture = folder / f"{category}_{name}.png"
            if not picture.exists():
                with warnings.catch_warnings():
                    warnings.simplefilter("error")
                    draw(category, name, picture)
            yield from (f"![An example of {name}]({picture.name})", "", f"*{shown(EXAMPLES[category][name], name)}*", "")
        yield from (markdown_of(plugin) if inspect.getdoc(plugin) else "", "", *table(attributes(plugin)))


def table(schema: dict[str, Attribute]) -> Iterator[str]:
    """The lines of a table of parameters."""
    if schema:
        yield from ("| key | what it is | default |", "|---|---|---|")
    for name, attribute in schema.items():
        default = "needed" if attribute.required else "" if attribute.default is None else f"`{attribute.default}`"
        yield f"| `{name}` | {kind_of(attribute.annotation)} | {default} |"


def kind_of(annotation: Any) -> str:
    """What an attribute takes, in words."""
    members = [option for option in options(annotation) if option is not type(None)]
    return " or ".join(escaped(WORDS.get(member) or name_of(member)) for member in members)


def name_of(member: Any) -> str:
    """A member of an annotation, in words."""
    if getattr(member, "__origin__", None) is list:
        return f"one or more of {name_of(member.__args__[0])}"
    return getattr(member, "category", "") or {"Matrix4": "4 x 4 transform", "Point3": "point", "Filename": "file",
                                               "TriangleMesh": "trimesh.Trimesh or trimesh.Scene",
                                               "Tensor": "array"}.get(member.__name__, member.__name__)


def shown(value: Any, name: str = "") -> str:
    """The example of a plugin in a few words."""
    if isinstance(value, dict):
        inner = ", ".join(f"{key} {shown(item)}" for key, item in value.items() if key != "type")
        kind = name or value["type"]
        return f"{kind}: {inner}" if name and inner else f"{kind} ({inner})" if inner else kind
    if isinstance(value, torch.Tensor):
        return f"({' x '.join(map(str, value.shape))} numbers)"
    if isinstance(value, list):
        return ", ".join(f"{item:g}" for item in value)
    return Path(value).name if isinstance(value, str) else f"{value:g}" if isinstance(value, float) else str(value)
