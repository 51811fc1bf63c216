"""Text of docstrings in which Markdown finds no HTML."""

from __future__ import annotations

import re


def escaped(text: str) -> str:
    """Text without what Markdown would take for HTML, outside of `code`."""
    parts = re.split(r"(`[^`]*`)", text)
    return "".join(part if part.startswith("`") else part.replace("<", "&lt;") for part in parts)
