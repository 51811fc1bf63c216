"""Images of signed numbers side by side, in colours that show the sign, each with a scale."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from PIL import Image, ImageDraw, ImageFont
from torch import Tensor

from torch_radbp.formats.atomic import replacing
from torch_radbp.formats.image import linear_to_srgb
from torch_radbp.training.false_colour import signed_colour

LEAST_WIDTH, LARGEST_ZOOM = 256, 64  # of a panel, pixels, and of a pixel in it
MARGIN, GAP, TITLE, BAR, FOOT = 14, 18, 26, 12, 24
PAPER, INK, SOFT, LINE = (255, 255, 255), (29, 36, 51), (102, 112, 133), (227, 230, 236)
FONT_SIZE = 14


class Panel(NamedTuple):
    """One picture.

    Attributes:
        title: shown above.
        values: (H, W) signed numbers.
        scale: the magnitude at the ends of the colour bar; larger ones look the same.
    """

    title: str
    values: Tensor
    scale: float


def write_panels(path: Path, panels: list[Panel]) -> None:
    """Writes panels of one size side by side as a PNG, pixels enlarged to be seen, a colour bar below each."""
    height, width = panels[0].values.shape
    zoom = min(LARGEST_ZOOM, max(1, -(-LEAST_WIDTH // width)))
    column, row = max(zoom * width, LEAST_WIDTH), zoom * height
    size = (2 * MARGIN + len(panels) * column + (len(panels) - 1) * GAP, 2 * MARGIN + TITLE + row + 8 + BAR + FOOT)
    picture = Image.new("RGB", size, PAPER)
    draw, font = ImageDraw.Draw(picture), ImageFont.load_default(FONT_SIZE)
    for number, panel in enumerate(panels):
        left, top = MARGIN + number * (column + GAP), MARGIN + TITLE
        draw.text((left, MARGIN), panel.title, INK, font)
        picture.paste(_as_pixels(panel.values, panel.scale, zoom), (left, top))
        draw.rectangle((left - 1, top - 1, left + zoom * width, top + row), outline=LINE)
        bar_top = top + row + 8
        ramp = torch.linspace(-1, 1, zoom * width).expand(BAR, -1)
        picture.paste(_as_pixels(ramp, 1.0, 1), (left, bar_top))
        for text, anchor, x in ((f"-{panel.scale:.3g}", "la", 0), ("0", "ma", zoom * width // 2),
                                (f"+{panel.scale:.3g}", "ra", zoom * width)):  # fmt: skip
            draw.text((left + x, bar_top + BAR + 4), text, SOFT, font, anchor)
    with replacing(path) as partial:
        picture.save(partial)


def _as_pixels(values: Tensor, scale: float, zoom: int) -> Image.Image:
    colours = linear_to_srgb(signed_colour(values.detach().cpu().float(), scale)).permute(1, 2, 0)
    image = Image.fromarray(np.uint8((colours.clamp(0, 1) * 255).round()))
    return image.resize((image.width * zoom, image.height * zoom), Image.Resampling.NEAREST)
