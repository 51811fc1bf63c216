"""Docstrings, which are Markdown in Google's style, as Markdown for MyST."""

from __future__ import annotations

import inspect
from collections.abc import Iterable
from typing import Any

import griffe

from docs.escaped import escaped

TITLES = {"parameters": "Parameters", "attributes": "Attributes", "returns": "Returns", "raises": "Raises"}


def markdown_of(documented: Any) -> str:
    """The docstring of a class or function: its text, and its sections as lists."""
    return markdown(inspect.getdoc(documented) or "")


def markdown(docstring: str) -> str:
    """A docstring, its indentation removed, with its sections as lists.

    Raises:
        ValueError: for a kind of section that has no title here.
    """
    sections = griffe.Docstring(docstring, lineno=1).parse("google", warnings=False, returns_multiple_items=False)
    return "\n\n".join(section_text(section) for section in sections)


def section_text(section: griffe.DocstringSection) -> str:
    """A section of a docstring."""
    kind = section.kind.value
    if kind == "text":
        return escaped(section.value)
    if kind == "admonition":
        return f"**{section.title}**\n\n{escaped(section.value.description)}"
    if kind not in TITLES:
        raise ValueError(f"sections of the kind {kind} are not known; known: text, admonition, {', '.join(TITLES)}")
    return f"**{TITLES[kind]}**\n\n" + "\n".join(entries(section))


def entries(section: griffe.DocstringSection) -> Iterable[str]:
    """The entries of a section, each an item of a list; names of parameters and errors stand before their texts."""
    for entry in section.value:
        name = entry.annotation if section.kind.value == "raises" else entry.name
        text = escaped(entry.description).replace("\n", "\n  ")
        yield f"- `{name}`: {text}" if name else f"- {text}"
