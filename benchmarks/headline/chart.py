"""Curves of error over seconds, a panel for each task, as one picture."""

from __future__ import annotations

import math
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

from benchmarks.headline.race import Curve, soonest

WIDTH, HEIGHT, LEFT, RIGHT, TOP, BOTTOM = 560, 400, 64, 16, 64, 44  # pixels of a panel, and its margins
COLUMNS = 2
COLOURS = ("#0b62c4", "#5aa9e6", "#d1495b", "#e0a030", "#6b8e4e", "#7b52ab")  # ours first
INK, FAINT = "#222222", "#dddddd"


class Axes:
    """Where seconds and errors lie in a panel, both by their logarithms."""

    def __init__(self, curves: list[Curve]):
        times = [time for curve in curves for time in curve.seconds[1:]]
        errors = [error for curve in curves for error in curve.errors]
        self.times = math.log10(min(times)), math.log10(max(times))
        self.errors = math.log10(min(errors)) - 0.05, math.log10(max(errors)) + 0.05

    def place(self, time: float, error: float) -> tuple[float, float]:
        """Pixels from the left and the top."""
        (first, last), (least, most) = self.times, self.errors
        across, up = (math.log10(time) - first) / (last - first), (math.log10(error) - least) / (most - least)
        return LEFT + across * (WIDTH - LEFT - RIGHT), HEIGHT - BOTTOM - up * (HEIGHT - TOP - BOTTOM)


def marks(least: float, most: float) -> list[float]:
    """1, 2 and 5 times powers of ten between two logarithms."""
    powers = range(math.floor(least), math.ceil(most) + 1)
    return [mark for power in powers for digit in (1, 2, 5) if least <= math.log10(mark := digit * 10.0**power) <= most]


def panel(title: str, measure: str, runs: dict[str, list[Curve]], error: float) -> Image.Image:
    """The curves of one task, of the runs that are soonest; `error`: the common one, as a line."""
    runs = soonest(runs, error, len(COLOURS))
    picture = Image.new("RGB", (WIDTH, HEIGHT), "white")
    draw, large, small = ImageDraw.Draw(picture), ImageFont.load_default(17), ImageFont.load_default(12)
    axes = Axes([curve for curves in runs.values() for curve in curves])
    draw.text((LEFT, 8), title, INK, large)
    draw.text((WIDTH - RIGHT, HEIGHT - 8), f"seconds; error: {measure}", INK, small, anchor="rs")
    for mark in marks(*axes.times):
        x, _ = axes.place(mark, 10 ** axes.errors[0])
        draw.line((x, TOP, x, HEIGHT - BOTTOM), FAINT)
        draw.text((x, HEIGHT - BOTTOM + 4), f"{mark:g}", INK, small, anchor="mt")
    for mark in marks(*axes.errors):
        _, y = axes.place(10 ** axes.times[0], mark)
        draw.line((LEFT, y, WIDTH - RIGHT, y), FAINT)
        draw.text((LEFT - 6, y), f"{mark:g}", INK, small, anchor="rm")
    _, y = axes.place(10 ** axes.times[0], error)
    for x in range(LEFT, WIDTH - RIGHT, 12):
        draw.line((x, y, x + 6, y), INK)
    x, y = LEFT, 30
    for colour, (name, curves) in zip(COLOURS, runs.items()):
        width = int(draw.textlength(name, small))
        if x + width > WIDTH:
            x, y = LEFT, y + 16
        draw.text((x, y), name, colour, small)
        x += width + 24
        for curve in curves:
            draw.line([axes.place(*point) for point in zip(curve.seconds[1:], curve.errors[1:])], colour, 2)
    return picture


def write_chart(path: Path, panels: list[Image.Image]) -> None:
    """Writes the panels as one PNG, two beside each other."""
    sheet = Image.new("RGB", (COLUMNS * WIDTH, -(-len(panels) // COLUMNS) * HEIGHT), "white")
    for number, each in enumerate(panels):
        sheet.paste(each, (number % COLUMNS * WIDTH, number // COLUMNS * HEIGHT))
    path.parent.mkdir(parents=True, exist_ok=True)
    sheet.save(path)
