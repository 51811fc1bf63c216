"""Tables as HTML, by which notebooks show objects that have `_repr_html_`."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

MOST_ROWS = 40  # of a table; a scene may have thousands of shapes
CELL = "text-align: left; padding: 0.1em 1em 0.1em 0; vertical-align: top"


def html_table(title: str, headings: Sequence[object], rows: Sequence[Sequence[object]], note: str = "") -> str:
    """A table of text as HTML: the first rows, if there are many.

    Args:
        title: above the table.
        headings: of the columns.
        rows: of cells, shown as their `str`.
        note: below the table.
    """
    left_out = f"and {len(rows) - MOST_ROWS} more" if len(rows) > MOST_ROWS else ""
    below = "".join(f"<p>{escape(part)}</p>" for part in (left_out, note) if part)
    body = "".join(html_row("td", row) for row in rows[:MOST_ROWS])
    return f"<div><b>{escape(title)}</b><table>{html_row('th', headings)}{body}</table>{below}</div>"


def html_row(tag: str, cells: Sequence[object]) -> str:
    """One row of an HTML table, its cells escaped."""
    return f"<tr>{''.join(f'<{tag} style={CELL!r}>{escape(str(cell))}</{tag}>' for cell in cells)}</tr>"
