"""Line charts as inline SVG: sharp at any size, a few kilobytes, no library and no network."""

import html
import math
from typing import NamedTuple

WIDTH, HEIGHT = 520, 240
LEFT, RIGHT, TOP, BOTTOM = 58, 12, 14, 34
MOST_POINTS = 400


class Line(NamedTuple):
    """One curve.

    Attributes:
        label: for the legend.
        colour: CSS colour.
        x, y: the points; y that is not finite, or not positive in a log chart, is left out.
        goal: a constant to compare with, dashed in the same colour.
    """

    label: str
    colour: str
    x: list[float]
    y: list[float]
    goal: float | None = None


def line_chart(title: str, lines: list[Line], log: bool = False) -> str:
    """Returns a chart over steps as an SVG element with a legend below.

    Args:
        title: shown above.
        lines: the curves.
        log: logarithmic y axis.
    """
    values = [y for line in lines for y in line.y if _drawable(y, log)]
    values += [line.goal for line in lines if line.goal is not None and _drawable(line.goal, log)]
    xs = [x for line in lines for x in line.x]
    if not values or not xs:
        return ""
    low, high = _padded(min(values), max(values), log)
    first, last = min(xs), max(max(xs), min(xs) + 1)

    def place(x: float, y: float) -> str:
        level = (_scaled(y, log) - _scaled(low, log)) / (_scaled(high, log) - _scaled(low, log))
        across = LEFT + (x - first) / (last - first) * (WIDTH - LEFT - RIGHT)
        return f"{across:.1f},{HEIGHT - BOTTOM - level * (HEIGHT - TOP - BOTTOM):.1f}"

    parts = [f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{html.escape(title)}">']
    for tick in _ticks(low, high, log):
        x, y = place(first, tick).split(",")
        parts.append(f'<line class="grid" x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{y}" y2="{y}"/>')
        parts.append(f'<text x="{LEFT - 8}" y="{y}" dy="0.35em" text-anchor="end">{tick:.3g}</text>')
    for tick in _ticks(first, last, False):
        x = place(tick, low).split(",")[0]
        parts.append(f'<text x="{x}" y="{HEIGHT - BOTTOM + 18}" text-anchor="middle">{tick:.6g}</text>')
    parts.append(f'<line class="axis" x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{HEIGHT - BOTTOM}" y2="{HEIGHT - BOTTOM}"/>')
    parts.append(f'<text x="{WIDTH - RIGHT}" y="{HEIGHT - BOTTOM + 30}" text-anchor="end">step</text>')
    for line in lines:
        if line.goal is not None and _drawable(line.goal, log):
            ends = f"{place(first, line.goal)} {place(last, line.goal)}"
            parts.append(f'<polyline points="{ends}" stroke="{line.colour}" class="goal"/>')
    for line in lines:
        every = max(1, math.ceil(len(line.x) / MOST_POINTS))
        kept = [(x, y) for x, y in zip(line.x, line.y) if _drawable(y, log)]
        points = " ".join(place(x, y) for x, y in kept[:-1:every] + kept[-1:])
        parts.append(f'<polyline points="{points}" stroke="{line.colour}" class="curve"/>')
    parts.append("</svg>")
    legend = "".join(
        f'<span><i style="background:{line.colour}"></i>{html.escape(line.label)}</span>' for line in lines
    )
    if any(line.goal is not None for line in lines):
        legend += '<span><i class="dashed"></i>true</span>'
    heading = f"<figcaption>{html.escape(title)}</figcaption>"
    return f'<figure class="chart">{heading}{"".join(parts)}<div class="legend">{legend}</div></figure>'


def _drawable(y: float, log: bool) -> bool:
    return math.isfinite(y) and (y > 0 or not log)


def _scaled(y: float, log: bool) -> float:
    return math.log10(y) if log else y


def _padded(low: float, high: float, log: bool) -> tuple[float, float]:
    if log:
        return low / 1.3, high * 1.3
    margin = 0.06 * (high - low) or max(abs(high) * 0.1, 1e-6)
    # A curve of values that cannot be negative should not show an axis below 0.
    return (max(low - margin, 0.0) if low >= 0 else low - margin), high + margin


def _ticks(low: float, high: float, log: bool) -> list[float]:
    """Returns round numbers between low and high, about five."""
    if log:
        decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
        for steps in ((1,), (1, 3), (1, 2, 5)):
            ticks = [step * 10.0**decade for decade in decades for step in steps]
            ticks = [tick for tick in ticks if low <= tick <= high]
            if len(ticks) >= 3:
                return ticks[:: math.ceil(len(ticks) / 7)]
        return _ticks(low, high, False)  # a small part of a decade, nearly linear
    raw = (high - low) / 5
    magnitude = 10.0 ** math.floor(math.log10(raw))
    step = next(factor * magnitude for factor in (1, 2, 2.5, 5, 10) if factor * magnitude >= raw)
    first = math.ceil(low / step - 1e-9)
    return [round(index * step, 12) for index in range(first, math.floor(high / step + 1e-9) + 1)]
