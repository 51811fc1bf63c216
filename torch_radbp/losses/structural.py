"""Structural dissimilarity, by kornia."""

from __future__ import annotations

from torch import Tensor

from torch_radbp.losses.exchange import exchanged
from torch_radbp.losses.images import check_images
from torch_radbp.losses.masked import counted, masked_mean


def ssim(image_a: Tensor, image_b: Tensor, target: Tensor, mask: Tensor | None = None, window: int = 11,
         max_val: float = 1.0) -> Tensor:
    """The mean of (1 - SSIM) / 2, `kornia.losses.ssim_loss`, of two renderings with exchanged derivatives.

    Biased with noisy renderings: noise is structure that the target lacks, so that the value is too large, and surfaces
    become too smooth or too dark, where they have less noise. Take it with many samples, or late, beside an unbiased loss.

    Args:
        image_a, image_b: (B, 3, H, W), attached; of two seeds; as they are seen, such as behind an `rb.ToneCurve`.
        target: (B, 3, H, W); NaN and infinity do not count where the mask is 0.
        mask: (B, 1, H, W) weights in [0, 1]; None: all pixels count the same. Outside of it the target stands in the
            place of the images, so that windows across its border do not see what is masked.
        window: pixels of the side of the window, odd.
        max_val: the range of values.

    Returns:
        A scalar in [0, 1].

    Raises:
        ValueError: if the shapes or devices differ, the mask is negative, or the target is not finite where it counts.
        TypeError: for another dtype than float32 and float64.

    Reference: Wang et al. 2004, "Image Quality Assessment: From Error Visibility to Structural Similarity".
    """
    import kornia  # takes a second to import

    check_images(image_a=image_a, image_b=image_b, target=target)
    target = counted(target, mask)

    def dissimilarity(image: Tensor, target: Tensor) -> Tensor:
        seen = image if mask is None else mask * image + (1 - mask) * target
        return masked_mean(kornia.losses.ssim_loss(seen, target, window, float(max_val), reduction="none"), mask)

    return exchanged(dissimilarity, image_a, image_b, target)
