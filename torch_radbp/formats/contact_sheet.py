"""Contact sheets: images of several views beside each other, with labels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from PIL import Image, ImageDraw, ImageFont
from torch import Tensor

from torch_radbp.formats.image import linear_to_srgb, srgb_to_linear

SMALLEST = 96  # pixels, of the longer side of an image on a sheet
GAP, LETTERS = 6, 13  # pixels
PAPER, INK = (255, 255, 255), (29, 36, 51)


def contact_sheet(rows: Mapping[str, Tensor | Sequence[Tensor]], views: Sequence[str] = ()) -> Tensor:
    """One image of many: a row for each name, a column for each view, with their labels.

        rows = {"before": before, "target": batch.image, "after": after}
        sheet = rb.contact_sheet(rows, views=batch.sensors)
        rb.save_image("sheet.png", sheet)

    Small images are enlarged by a whole number, without smoothing, so that their pixels are seen.

    Args:
        rows: by their labels, images (B, 3, H, W) of linear RGB, or (B, 1, H, W) grey, or lists of (3, H, W) or (1, H, W) of
            several sizes; values are cut to [0, 1]. An empty label takes no place.
        views: labels of the columns, as many as the longest row has; none: no labels.

    Returns:
        (3, H, W) float32, linear RGB, on the CPU, detached.

    Raises:
        TypeError: if an image is no tensor of floating point numbers.
        ValueError: if there is no image, one has another shape or is not finite, or labels are too many or too few.
    """
    images = {name: [picture(f"rows[{name!r}][{number}]", image) for number, image in enumerate(row)]
              for name, row in rows.items()}
    count = max(map(len, images.values()), default=0)
    if not count:
        raise ValueError("a contact sheet needs images, such as {\"target\": (B, 3, H, W)}, got none")
    if len(views) not in (0, count):
        raise ValueError(f"views must be a label for each of {count} columns, got {len(views)}")
    pictures = [each for row in images.values() for each in row]
    zoom = -(-SMALLEST // max(max(each.size) for each in pictures))
    wide = zoom * max(each.width for each in pictures) + GAP
    font = ImageFont.load_default(LETTERS)
    left = max(round(font.getlength(name)) for name in images) + GAP
    left = GAP if left == GAP else left + GAP
    top = LETTERS + 2 * GAP if views else GAP
    heights = [zoom * max((each.height for each in row), default=0) + GAP for row in images.values()]
    sheet = Image.new("RGB", (left + count * wide, top + sum(heights)), PAPER)
    draw = ImageDraw.Draw(sheet)
    for column, name in enumerate(views):
        draw.text((left + column * wide, GAP), shortened(name, font, wide - GAP), INK, font)
    for (name, row), high in zip(images.items(), heights):
        draw.text((GAP, top + (high - GAP - LETTERS) // 2), name, INK, font)
        for column, each in enumerate(row):
            sheet.paste(each.resize((zoom * each.width, zoom * each.height), Image.Resampling.NEAREST),
                        (left + column * wide, top))
        top += high
    return srgb_to_linear(torch.from_numpy(np.array(sheet)).movedim(-1, 0) / 255)


def picture(place: str, image: Tensor) -> Image.Image:
    """An image converted to 8-bit sRGB; `place` names it in errors, which are those of `contact_sheet`."""
    if not isinstance(image, Tensor) or not image.is_floating_point():
        got = image.dtype if isinstance(image, Tensor) else type(image).__name__
        raise TypeError(f"{place} must be a tensor of floating point numbers, got {got}")
    if image.ndim != 3 or image.shape[0] not in (1, 3) or not image.numel():
        raise ValueError(f"{place} must have shape (3, H, W) or (1, H, W), got {tuple(image.shape)}; rows are (B, 3, H, W)")
    values = image.detach().cpu().float()
    if not bool(values.isfinite().all()):
        raise ValueError(f"{place} has values that are NaN or infinite")
    levels = (linear_to_srgb(values.clamp(0, 1)) * 255).round().byte()
    return Image.fromarray(levels.expand(3, -1, -1).movedim(0, -1).contiguous().numpy())


def shortened(text: str, font: ImageFont.FreeTypeFont | ImageFont.ImageFont, width: float) -> str:
    """A text cut at its beginning to fit its column: names of views differ at the end."""
    while font.getlength(text) > width and len(text) > 1:
        text = text[1:]
    return text
