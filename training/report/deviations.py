"""The deviations of a report: values with theirs, a matrix of correlations, what is flat, and maps."""

import html
from typing import Any

import torch

from torch_radbp.training.false_colour import signed_colour
from torch_radbp.training.recovery.run_folder import RunFolder
from torch_radbp.training.recovery.verdict import CONVERGED
from torch_radbp.training.report.curve_colours import srgb_levels
from torch_radbp.training.report.pictures import deviation_figure

CELL, MARGIN = 22, 4  # of the matrix, pixels of the picture
LETTER = 6.6  # width of a letter of a name, likewise
SHOWN = 40  # rows of table and matrix at most
WHAT_THEY_ARE = (
    "Standard deviations by the derivatives of the images at the recovered values, where a pixel's noise is {noise:.2g}: "
    "what the two renderings of one step and the targets differ by. They hold for a fit to one such pair: a run that "
    "averages over many steps is better known, one that has not converged worse. They know nothing of what scene and "
    "photographs do not share. Computed in {seconds:.1f} s."
)


def deviations_of_parameter(summary: dict[str, Any], name: str) -> list[float | None]:
    """The deviations of a parameter's numbers, None where they are not told; empty if none were computed."""
    found = summary.get("deviations", {"names": []})
    return [deviation for entry, deviation in zip(found["names"], found.get("deviations", []))
            if entry == name or entry.startswith((f"{name}[", f"{name}:"))]


def unsettled(summary: dict[str, Any]) -> str:
    """A sentence that values of a run that has not converged may be off by more than their deviations; else nothing."""
    word = summary["verdict"]["word"]
    return "" if word == CONVERGED else (f"The run has not converged ({word}), so that values may be off by far more than "
                                         f"their deviations")


def with_deviation(deviation: float | None) -> str:
    """A deviation in words."""
    return "not told" if deviation is None else f"± {deviation:.2g}"


def deviations_section(folder: RunFolder, summary: dict[str, Any]) -> str:
    """Returns the section, empty for a run that was not asked for it."""
    found = summary.get("deviations")
    if found is None:
        return ""
    if not found["computed"]:
        return _section(f"<p class=note>Not computed: {html.escape(found['why'])}.</p>")
    parts = []
    if found["names"]:
        parts.append(f'<div class="charts"><div>{_table(found)}</div><div>{_matrix(found)}</div></div>')
    words = [f"Not told: {each}" for each in found["flat"]] + [f"Correlated: {each}" for each in found["weak"]]
    if words:
        parts.append("<ul>" + "".join(f"<li>{html.escape(each)}</li>" for each in words) + "</ul>")
    for each in found["maps"]:
        figure = deviation_figure(folder.texture_path(each["name"], "deviations"), each["largest"])
        parts.append(f"<h3>{html.escape(each['name'])}</h3><div class=\"pictures textures\">{figure}</div>"
                     f"<p class=note>{html.escape(_of_map(each))}</p>")
    more = [f" {sentence}." for sentence in (unsettled(summary), found["why"]) if sentence]
    note = WHAT_THEY_ARE.format(**found) + "".join(more)
    return _section("".join(parts) + f"<p class=note>{html.escape(note)}</p>")


def _section(body: str) -> str:
    return f"<section><h2>How far values are known</h2>{body}</section>"


def _of_map(found: dict[str, Any]) -> str:
    text = f"The median is {found['median']:.2g}, the largest {found['largest']:.2g}."
    if found["prior"] is None:
        return text
    return f"{text} Where nothing is seen it is {found['prior']:.2g}, that of a uniform distribution between the bounds."


def _table(found: dict[str, Any]) -> str:
    rows = "".join(f"<tr><th>{html.escape(name)}</th><td class=number>{value:.6g}</td><td class=number>"
                   f"{with_deviation(deviation)}</td></tr>"
                   for name, value, deviation in
                   list(zip(found["names"], found["values"], found["deviations"]))[:SHOWN])
    return f"<table class=narrow><tr><th>number</th><th>value</th><th>deviation</th></tr>{rows}</table>"


def _matrix(found: dict[str, Any]) -> str:
    """The correlations as coloured squares, blue below zero, red above, grey where a number is not told."""
    count = min(len(found["names"]), SHOWN)
    names = found["names"][:count]
    left = round(LETTER * max(map(len, names))) + 2 * MARGIN
    cells = []
    for row, name in enumerate(names):
        y = row * CELL
        cells.append(f'<text x="{left - MARGIN}" y="{y + 0.7 * CELL:.1f}" text-anchor="end">{html.escape(name)}</text>')
        for column, other in enumerate(names):
            value = found["correlations"][row][column]
            title = f"{name}, {other}: " + ("not told" if value is None else f"{value:+.3f}")
            cells.append(f'<rect x="{left + column * CELL}" y="{y}" width="{CELL - 1}" height="{CELL - 1}" '
                         f'fill="{_colour(value)}"><title>{html.escape(title)}</title></rect>')
    size = f"0 0 {left + count * CELL} {count * CELL}"
    rest = f" Of {len(found['names'])} numbers the first {SHOWN} are shown." if len(found["names"]) > SHOWN else ""
    return (f'<svg class="correlations" viewBox="{size}" style="max-width:{left + count * CELL}px">{"".join(cells)}</svg>'
            f"<small>Correlations: dark blue −1, white 0, dark red +1; grey: not told.{rest}</small>")


def _colour(value: float | None) -> str:
    if value is None:
        return "#c3c9d6"
    levels = srgb_levels(signed_colour(torch.tensor([[value]]), 1.0)[:, 0, 0].tolist())
    return f"rgb({','.join(map(str, levels))})"

