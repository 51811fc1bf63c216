"""A sheet of derivative images: a row per scene, finite differences first, then each sampling."""

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


def write_sheet(path: Path, rows: list[tuple[str, dict[str, GradientCheck]]]) -> None:
    """Writes the sheet as PNG.

    Args:
        path: of the file; its folder is made.
        rows: name of a scene, and what was found for each sampling.
    """
    wide, high = 3 * (PANEL + MARGIN) + MARGIN, PANEL + LABEL + MARGIN
    lines = -(-len(rows) // COLUMNS)
    sheet = Image.new("RGB", (COLUMNS * wide, lines * high + MARGIN), "white")
    draw = ImageDraw.Draw(sheet)
    for number, (name, found) in enumerate(rows):
        left, top = MARGIN + number // lines * wide, MARGIN + number % lines * high
        draw.text((left, top), f"{name}: differences, {', '.join(found)}", fill="black")
        first = next(iter(found.values())).comparison.difference
        scale = max(float(quantile(first.sum(1).abs(), BRIGHTEST)), 1e-30)
        for k, image in enumerate([first, *(result.comparison.jvp for result in found.values())]):
            sheet.paste(panel(image, scale), (left + k * (PANEL + MARGIN), top + LABEL))
    path.parent.mkdir(parents=True, exist_ok=True)
    sheet.save(path)
