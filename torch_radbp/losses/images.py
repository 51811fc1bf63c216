"""Checks of the arguments of losses."""

from __future__ import annotations

import torch
from torch import Tensor

DTYPES = (torch.float32, torch.float64)


def check_images(**images: Tensor) -> None:
    """Raises TypeError unless images are dense floating-point tensors, ValueError unless shapes broadcast on one device."""
    for name, image in images.items():
        check_floats(name, image)
    (first, image), *others = images.items()
    for name, other in others:
        if other.device != image.device:
            raise ValueError(f"{first} is on {image.device} and {name} on {other.device}; move one, "
                             f"{name}.to({first}.device)")
        if other.shape != image.shape:
            raise ValueError(f"{first} and {name} must have one shape, got {tuple(image.shape)} and {tuple(other.shape)}")


def check_floats(name: str, image: Tensor) -> None:
    """Raises TypeError unless `image` is a dense tensor of float32 or float64."""
    if not isinstance(image, Tensor) or image.dtype not in DTYPES:
        kind = image.dtype if isinstance(image, Tensor) else type(image).__name__
        raise TypeError(f"{name} must be a tensor of torch.float32 or torch.float64, got {kind}; convert it, "
                        f"{name}.float()")
    if image.layout != torch.strided:
        raise TypeError(f"{name} must be a dense tensor, got {image.layout}; convert it, {name}.to_dense()")
    if image.is_meta:
        raise TypeError(f"{name} is on the device meta, which holds no numbers: give it on the CPU")
