"""A perceptual distance by the features of a network that the caller brings."""

from __future__ import annotations

from collections.abc import Callable

from torch import Tensor

from torch_radbp.losses.exchange import exchanged
from torch_radbp.losses.images import check_images
from torch_radbp.losses.masked import counted


def lpips(image_a: Tensor, image_b: Tensor, target: Tensor, module: Callable[[Tensor, Tensor], Tensor],
          mask: Tensor | None = None) -> Tensor:
    """The mean of `module(image, target)` over two renderings with exchanged derivatives.

        distance = lpips.LPIPS(net="vgg")  # pip install lpips; its weights are downloaded
        loss = rb.losses.lpips(a, b, target, distance)

    Images are scaled from [0, 1] to [-1, 1], and cut off there, as `lpips.LPIPS` and
    `torchmetrics.image.LearnedPerceptualImagePatchSimilarity` take them. Biased with noisy renderings: features respond to
    noise. Take it with many samples, or late, beside an unbiased loss.

    Args:
        image_a, image_b: (B, 3, H, W), attached; of two seeds; as they are seen, coded as sRGB or behind an `rb.ToneCurve`.
        target: (B, 3, H, W), the same; NaN and infinity do not count where the mask is 0.
        module: a distance of two batches of images, of any shape; it should be in evaluation mode.
        mask: (B, 1, H, W) weights in [0, 1]; outside of it the target stands in the place of the images. None: all count.

    Returns:
        A scalar.

    Raises:
        ValueError: if the shapes or devices differ, the mask is negative, or the target is not finite where it counts.
        TypeError: for another dtype than float32 and float64, or if `module` cannot be called.

    Reference: Zhang et al. 2018, "The Unreasonable Effectiveness of Deep Features as a Perceptual Metric".
    """
    check_images(image_a=image_a, image_b=image_b, target=target)
    if not callable(module):
        raise TypeError(f"module must be a distance of two batches of images, such as lpips.LPIPS(), got "
                        f"{type(module).__name__}")
    target = counted(target, mask)

    def distance(image: Tensor, target: Tensor) -> Tensor:
        seen = image if mask is None else mask * image + (1 - mask) * target
        return module(2 * seen.clamp(0, 1) - 1, 2 * target.clamp(0, 1) - 1).mean()

    return exchanged(distance, image_a, image_b, target)
