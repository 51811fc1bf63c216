"""Sheets of images that are to be compared, a row for each scene."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw
from torch import Tensor

from torch_radbp.check.outcome import GradientCheck
from torch_radbp.check.statistics import BRIGHTEST, quantile
from torch_radbp.training.false_colour import signed_colour

PANEL, MARGIN, LABEL = 112, 8, 16  # pixels
COLUMNS = 2  # scenes side by side


def panel(image: Tensor, scale: float) -> Image.Image:
    """(1, 3, H, W) summed over channels; blue is negative, white zero, red positive; `scale` is darkest."""
    linear = signed_colour(image[0].sum(0), scale).permute(1, 2, 0).clamp(0, 1).cpu().numpy()
    picture = Image.fromarray((255 * linear ** (1 / 2.2) + 0.5).astype(np.uint8))
    return picture.resize((PANEL, PANEL), Image.Resampling.NEAREST)


def derivative_panels(found: dict[str, GradientCheck]) -> list[Image.Image]:
    """Finite differences first, then each sampling; all to one scale."""
    first = next(iter(found.values())).comparison.difference
    scale = max(float(quantile(first.sum(1).abs(), BRIGHTEST)), 1e-30)
    return [panel(image, scale) for image in (first, *(result.comparison.jvp for result in found.values()))]


def write_sheet(path: Path, rows: list[tuple[str, list[Image.Image]]], columns: int = COLUMNS) -> None:
    """Writes the sheet as PNG.

    Args:
        path: of the file; its folder is made.
        rows: the title of a scene, and its panels; of each row as many, and as large, as of the first.
        columns: scenes side by side.
    """
    panels = rows[0][1]
    wide = sum(each.width + MARGIN for each in panels) + MARGIN
    high = panels[0].height + LABEL + MARGIN
    lines = -(-len(rows) // columns)
    sheet = Image.new("RGB", (columns * wide, lines * high + MARGIN), "white")
    draw = ImageDraw.Draw(sheet)
    for number, (title, images) in enumerate(rows):
        left, top = MARGIN + number // lines * wide, MARGIN + number % lines * high
        draw.text((left, top), title, fill="black")
        for image in images:
            sheet.paste(image, (left, top + LABEL))
            left += image.width + MARGIN
    path.parent.mkdir(parents=True, exist_ok=True)
    sheet.save(path)
