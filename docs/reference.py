"""Writes the pages of the reference: signatures and docstrings of the public names, in groups."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import torch_radbp as rb
from docs.contents import GROUPS, ungrouped
from docs.docstring import markdown_of


class Text(str):
    """An annotation that is shown as it is written in the source."""

    def __repr__(self) -> str:
        return str(self)


def write_reference(folder: Path) -> None:
    """Writes a page for each group, and their index, into a folder.

    Raises:
        ValueError: if a public name is in no group.
    """
    if ungrouped():
        raise ValueError(f"add {', '.join(sorted(ungrouped()))} to a group of docs/contents.py: they are public names")
    folder.mkdir(exist_ok=True)
    for page, group in GROUPS.items():
        parts = [f"# {group.title}", group.about, *map(entry, group.names)]
        (folder / f"{page}.md").write_text("\n\n".join(parts) + "\n")
    (folder / "index.md").write_text("\n".join(index()))


def index() -> Iterator[str]:
    """The lines of the index: all names with the first line of what they are."""
    yield from ("# Reference", "", "All public names, after `import torch_radbp as rb`. What a scene is made of is on the "
                "pages of [plugins](../plugins/index.md).", "")
    yield from (":::{toctree}", ":hidden:", "", *GROUPS, ":::", "")
    for group in GROUPS.values():
        yield from (f"## {group.title}", "", "| name | what it is |", "|---|---|")
        for name in group.names:
            first = (inspect.getdoc(found(name)) or "").splitlines()[0].replace("|", "\\|").rstrip(":")
            yield f"| {{py:obj}}`{name} <torch_radbp.{name}>` | {first} |"
        yield ""


def found(name: str) -> Any:
    """What a public name means."""
    value = rb
    for part in name.split("."):
        value = getattr(value, part)
    return value


def entry(name: str) -> str:
    """The entry of a name: its signature, with its docstring."""
    value, owner = found(name), name.rpartition(".")[0]
    kind = "class" if inspect.isclass(value) else "method" if owner and inspect.isclass(found(owner)) else "function"
    return f"`````{{py:{kind}}} torch_radbp.{name}{signature(value)}\n\n{markdown_of(value)}\n`````"


def signature(value: Any) -> str:
    """The signature of a class or function, annotations as they are in the source; none for errors."""
    if inspect.isclass(value) and issubclass(value, Exception):
        return ""
    shown = inspect.signature(value)
    parameters = [parameter.replace(annotation=as_written(parameter.annotation))
                  for parameter in shown.parameters.values() if parameter.name != "self"]
    returned = inspect.Signature.empty if inspect.isclass(value) else as_written(shown.return_annotation)
    return str(shown.replace(parameters=parameters, return_annotation=returned))


def as_written(annotation: Any) -> Any:
    """An annotation that prints as the source has it."""
    return Text(annotation) if isinstance(annotation, str) else annotation
