"""Two renderings with exchanged derivatives, for unbiased derivatives of any loss."""

from __future__ import annotations

from collections.abc import Callable

from torch import Tensor

from torch_radbp.losses.images import check_images


def exchange_derivatives(image_a: Tensor, image_b: Tensor) -> tuple[Tensor, Tensor]:
    """Two independent renderings, each with the derivative of the other, for any loss f:

        a, b = exchange_derivatives(renderer(seed=2 * step), renderer(seed=2 * step + 1))
        loss = (f(a, target) + f(b, target)) / 2

    Its derivative is E[f'(a)] dI in expectation: unbiased up to the curvature of f itself, which sees one noisy image. Each
    of the two is rendered with half of the samples, so that no pass is added and no sample is lost.

    Args:
        image_a, image_b: (B, 3, H, W), attached; of two seeds.

    Returns:
        The values of `image_a` and `image_b`, (B, 3, H, W) each.

    Raises:
        ValueError: if the shapes or devices differ.
        TypeError: for another dtype than float32 and float64.
    """
    check_images(image_a=image_a, image_b=image_b)
    return image_a.detach() + (image_b - image_b.detach()), image_b.detach() + (image_a - image_a.detach())


def exchanged(loss: Callable[[Tensor, Tensor], Tensor], image_a: Tensor, image_b: Tensor, target: Tensor) -> Tensor:
    """The mean of a loss over two independent renderings with exchanged derivatives:

        a, b = renderer(seed=2 * step), renderer(seed=2 * step + 1)
        loss = rb.losses.exchanged(kornia.losses.CharbonnierLoss(), a, b, target)

    The derivative is unbiased up to the curvature of the loss's own derivative: exact for the squared error, off by half its
    third derivative times the variance of a pixel for others. The value is that of noisy images, too large by half of the
    second derivative times the variance.

    Args:
        loss: of an image and the target, a scalar, such as `torch.nn.functional.l1_loss`.
        image_a, image_b: (B, 3, H, W), attached; of two seeds.
        target: (B, 3, H, W).

    Returns:
        A scalar.

    Raises:
        ValueError: if the shapes or devices differ.
        TypeError: for another dtype than float32 and float64.
    """
    check_images(image_a=image_a, image_b=image_b, target=target)
    a, b = exchange_derivatives(image_a, image_b)
    return (loss(a, target) + loss(b, target)) / 2
