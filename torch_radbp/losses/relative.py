"""A squared error relative to the brightness of the rendering."""

from __future__ import annotations

from torch import Tensor

from torch_radbp.losses.images import check_images
from torch_radbp.losses.masked import counted, masked_mean
from torch_radbp.plugin import positive


def two_buffer_relative_l2(image_a: Tensor, image_b: Tensor, target: Tensor, mask: Tensor | None = None,
                           epsilon: float = 1e-2) -> Tensor:
    """The mean of (image_a - target) (image_b - target) / (image^2 + epsilon), in which dark and bright things count alike.

    The denominator is detached. In the derivative each residual is weighted by the other image, whose derivative it meets:
    (a - T) db / (b^2 + epsilon). So it is E[I - T] E[dI / (I^2 + epsilon)]: in expectation zero where the image is right,
    whatever the noise, with the sign of the unbiased one wherever a pixel's weight and its derivative are independent, as
    those of a renderer are that does not share samples; only its size has the bias of E[1 / I^2]. One denominator from
    both images would correlate with the residuals and move the optimum. The value is biased, since its residuals do meet
    the noise of their denominator.

    Args:
        image_a, image_b: (B, 3, H, W) linear, attached; of two seeds.
        target: (B, 3, H, W); NaN and infinity do not count where the mask is 0.
        mask: (B, 1, H, W) or (B, 3, H, W) weights of at least 0; None: all pixels count the same.
        epsilon: is added to the squared image; the square of what counts as black.

    Returns:
        A scalar.

    Raises:
        ValueError: if the shapes or devices differ, the mask is negative, the target is not finite where it counts, or
            epsilon is not positive.
        TypeError: for another dtype than float32 and float64.

    Reference: Lehtinen et al. 2018, "Noise2Noise", section 3.3.
    """
    check_images(image_a=image_a, image_b=image_b, target=target)
    target = counted(target, mask)
    least = positive("epsilon", epsilon)
    weight_a, weight_b = (1 / (image.detach().square() + least) for image in (image_a, image_b))
    a, b = image_a - target, image_b - target
    errors = a.detach() * b * weight_b + b.detach() * a * weight_a  # twice the value, with the derivative that is wanted
    return masked_mean(errors - errors.detach() / 2, mask)
