"""How a lens darkens an image towards its corners."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from torch_radbp.photographs.linear_images import check_images


class LensFalloff(nn.Module):
    """Multiplies images by 1 + k1 r^2 + k2 r^4 + k3 r^6, r the distance from a centre, 1 at the corners of the image.

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

    def factors(self, height: int, width: int) -> Tensor:
        """(H, W) what the pixels of an image are multiplied by, attached."""
        like = self.coefficients
        half = 0.5 * (height**2 + width**2) ** 0.5
        y, x = ((torch.arange(side, dtype=like.dtype, device=like.device) + 0.5 - 0.5 * side) / half - middle
                for side, middle in ((height, self.centre[1]), (width, self.centre[0])))
        square = x.square() + y.square()[:, None]
        factors = torch.zeros_like(square)
        for coefficient in reversed(self.coefficients):
            factors = (factors + coefficient) * square
        return 1 + factors

    def forward(self, images: Tensor, views: int | Tensor | None = None) -> Tensor:
        """The images behind the lens.

        Args:
            images: (B, 3, H, W) linear radiance, attached.
            views: without effect: all views have one lens.

        Returns:
            (B, 3, H, W), attached to images and parameters.

        Raises:
            ValueError: for another shape.
        """
        check_images(images)
        return images * self.factors(*images.shape[2:]).to(images)
