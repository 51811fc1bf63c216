"""Losses of noisy images whose derivatives are not biased by the noise.

A rendering I is a random estimate of the true image. The derivative of a loss f(I) at one set of samples is f'(I) dI, and
E[f'(I) dI] differs from E[f'(I)] E[dI], because the same noise is in both factors: of the squared error by twice the
covariance of a pixel and its derivative, which pulls bright things to dark. Two independent renderings take it apart.

References: Gkioulekas et al. 2016, "An evaluation of computational imaging techniques for heterogeneous inverse scattering";
Azinovic et al. 2019, "Inverse path tracing for joint material and lighting estimation", section 4.
"""

from __future__ import annotations

import torch
from torch import Tensor

__all__ = ["exchange_derivatives", "two_buffer_l2"]

DTYPES = (torch.float32, torch.float64)


def two_buffer_l2(image_a: Tensor, image_b: Tensor, target: Tensor) -> Tensor:
    """mean((image_a - target) (image_b - target)) of two independent renderings.

    Value and derivative are unbiased at any number of samples. It may be negative: near the optimum it is a difference of
    noises.

    Args:
        image_a, image_b: (B, 3, H, W), attached; of two seeds.
        target: (B, 3, H, W).

    Returns:
        A scalar.

    Raises:
        ValueError: if the shapes or devices differ.
        TypeError: for another dtype than float32 and float64.
    """
    check_images(image_a=image_a, image_b=image_b, target=target)
    return ((image_a - target) * (image_b - target)).mean()


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


def check_images(**images: Tensor) -> None:
    """Raises TypeError for what is no dense tensor of floats, ValueError if shapes, which broadcast, or devices differ."""
    for name, image in images.items():
        if not isinstance(image, Tensor) or image.dtype not in DTYPES:
            kind = image.dtype if isinstance(image, Tensor) else type(image).__name__
            raise TypeError(f"{name} must be a tensor of torch.float32 or torch.float64, got {kind}; convert it, "
                            f"{name}.float()")
        if image.layout != torch.strided:
            raise TypeError(f"{name} must be a dense tensor, got {image.layout}; convert it, {name}.to_dense()")
        if image.is_meta:
            raise TypeError(f"{name} is on the device meta, which holds no numbers: give it on the CPU")
    (first, image), *others = images.items()
    for name, other in others:
        if other.device != image.device:
            raise ValueError(f"{first} is on {image.device} and {name} on {other.device}; move one, "
                             f"{name}.to({first}.device)")
        if other.shape != image.shape:
            raise ValueError(f"{first} and {name} must have one shape, got {tuple(image.shape)} and {tuple(other.shape)}")
