"""Vignetting: how a lens darkens an image towards its corners."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from torch_radbp.photographs.linear_images import check_linear_images
from torch_radbp.plugin import integer


class LensFalloff(nn.Module):
    """Multiplies images by 1 + k1 r^2 + k2 r^4 + k3 r^6, r the distance from a centre, 1 at the corners of the image.

        window = (x, y, 32, 32)
        image = renderer(seed=step, window=window)
        image = falloff(image, window=window, size=(width, height))

    Linear in the images, so that whatever is unbiased with noisy renderings is so behind it. The factor becomes negative
    where coefficients are far below 0.

    Parameters:
        coefficients: (K,) k1, k2, ..., no unit; 0 to begin with.
        centre: (2,) x and y of the centre relative to the middle of the image, in half diagonals, x to the right and y
            down; 0 to begin with. It has no effect on the image, and no derivative, while all coefficients are 0.

    Args:
        coefficients: to begin with: three zeros, or as many numbers as there are to be.

    Raises:
        ValueError: if they are not finite numbers, one or more.

    Reference: Goldman 2010, "Vignette and Exposure Calibration and Compensation".
    """

    def __init__(self, coefficients: Sequence[float] | Tensor = (0.0, 0.0, 0.0)):
        super().__init__()
        start = torch.as_tensor(coefficients, dtype=torch.get_default_dtype()).detach().clone()
        if start.ndim != 1 or not len(start) or not bool(start.isfinite().all()):
            raise ValueError(f"coefficients must be one or more finite numbers, got {coefficients!r:.80}")
        self.coefficients = nn.Parameter(start)
        self.centre = nn.Parameter(torch.zeros(2))

    def factors(self, height: int, width: int, window: Sequence[int] | None = None) -> Tensor:
        """(H, W) the factor of each pixel of an image, or of a window x, y, width and height; attached."""
        like = self.coefficients
        left, top, wide, high = (0, 0, width, height) if window is None else window
        half = 0.5 * (height**2 + width**2) ** 0.5
        y, x = ((torch.arange(first, first + count, dtype=like.dtype, device=like.device) + 0.5 - 0.5 * side) / half - middle
                for first, count, side, middle in ((top, high, height, self.centre[1]), (left, wide, width, self.centre[0])))
        square = x.square() + y.square()[:, None]
        factors = torch.zeros_like(square)
        for coefficient in reversed(self.coefficients):
            factors = (factors + coefficient) * square
        return 1 + factors

    def forward(self, images: Tensor, views: int | Tensor | None = None, *,
                window: Sequence[int] | Sequence[Sequence[int]] | None = None, size: Sequence[int] | None = None) -> Tensor:
        """Multiplies images by the lens's factors.

        Args:
            images: (B, 3, H, W) linear radiance, attached.
            views: without effect: all views have one lens.
            window: where the images lie in whole ones, as given to the renderer: (x, y, width, height), pixels, one for all
                images or one for each. Without it they are whole.
            size: width and height of the whole image, with a window.

        Returns:
            (B, 3, H, W), attached to images and parameters.

        Raises:
            ValueError: for another shape; for a window without a size, of another size than the images, or not inside.
        """
        check_linear_images(images)
        if window is None and size is None:
            return images * self.factors(*images.shape[2:]).to(images)
        if window is None or size is None or len(size) != 2:
            raise ValueError(f"a window needs the size of the whole image, (width, height), and only a window does, got "
                             f"window={window!r:.60} and size={size!r:.60}")
        width, height = (integer("size", side, 1) for side in size)
        windows = windows_of(window, images, width, height)
        return images * torch.stack([self.factors(height, width, each) for each in windows])[:, None].to(images)


def windows_of(window: Sequence, images: Tensor, width: int, height: int) -> list[tuple[int, ...]]:
    """The window of each image, or one for all; errors as of `LensFalloff.forward`."""
    rows = torch.as_tensor(window)
    if rows.is_floating_point() or rows.ndim not in (1, 2) or rows.shape[-1] != 4 or (
            rows.ndim == 2 and len(rows) != len(images)):
        raise ValueError(f"window must be (x, y, width, height), integers, or one for each of {len(images)} images, got "
                         f"{window!r:.80}")
    windows = [tuple(row) for row in rows.view(-1, 4).tolist()]
    for x, y, wide, high in windows:
        if (high, wide) != tuple(images.shape[2:]) or min(x, y) < 0 or x + wide > width or y + high > height:
            raise ValueError(f"a window of {wide} x {high} pixels at ({x}, {y}) must have the size of the images, "
                             f"{images.shape[3]} x {images.shape[2]}, and lie inside the whole of {width} x {height}")
    return windows
