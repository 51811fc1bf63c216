"""What is asked about: images, parameters with their names, and the noise of the images."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TypeAlias

import torch
from torch import Tensor

from torch_radbp.optim.linearisation import Images, Linearisation
from torch_radbp.rendering.renderer import Renderer

Parameters: TypeAlias = str | Iterable[str] | Mapping[str, Tensor]
Noise: TypeAlias = float | Tensor | Sequence[Tensor]


class Problem:
    """Images of named parameters, and how much noise they have; see `curvature` for the arguments."""

    def __init__(self, images: Renderer | Images, parameters: Parameters, noise: Noise, spp: int | None):
        self.linear = Linearisation(images_of(images), (held := named(images, parameters)).values())
        self.names, self.spp = list(held), spp
        self.held = held
        self.precision = precision_of(noise)

    @property
    def entries(self) -> list[str]:
        """The name of each of the n numbers: `green.reflectance.value[0]`."""
        return [name if parameter.numel() == 1 else f"{name}[{', '.join(map(str, _place(index, parameter)))}]"
                for name, parameter in self.held.items() for index in range(parameter.numel())]

    def weighted(self, rows: Tensor) -> Tensor:
        """Sigma^-1 times images, (M,) or (M, k)."""
        precision = self.precision
        if precision.numel() not in (1, len(rows)):
            raise ValueError(f"noise must be a number or have as many entries as the images, {len(rows)}, got "
                             f"{precision.numel()}: one for each number of each image, in their order")
        return precision.to(rows.device).view(-1, *[1] * (rows.ndim - 1)) * rows

    def by_name(self, flat: Tensor) -> dict[str, Tensor]:
        """Parts of (n,) numbers by the names of parameters, in their shapes, float64."""
        parts = flat.split([parameter.numel() for parameter in self.held.values()])
        return {name: part.view(parameter.shape) for (name, parameter), part in zip(self.held.items(), parts, strict=True)}


def images_of(images: Renderer | Images) -> Images:
    """The images as a function of seed and samples per pixel."""
    if not isinstance(images, Renderer):
        return images
    return lambda seed, spp: images(seed=seed, spp=spp)


def named(images: Renderer | Images, parameters: Parameters) -> dict[str, Tensor]:
    """The tensors of the parameters by name.

    Raises:
        TypeError: for names beside a function, whose scene is not known.
        AttributeError: if the scene has no such parameter; the message lists the nearest names.
    """
    if isinstance(parameters, Mapping):
        return dict(parameters)
    if not isinstance(images, Renderer):
        raise TypeError("beside a function parameters must map names to tensors, got "
                        f"{type(parameters).__name__}; for instance {{\"gains\": exposure.gains}}")
    return {name: images.scene.get_parameter(name) for name in ([parameters] if isinstance(parameters, str) else parameters)}


def precision_of(noise: Noise) -> Tensor:
    """The precision, one over the variance, of each number of the images, (M,) or (1,) float64.

    Raises:
        ValueError: unless standard deviations are positive; infinite ones are pixels that do not count.
    """
    several = [noise] if isinstance(noise, (float, int, Tensor)) else list(noise)
    deviations = torch.cat([torch.as_tensor(part, dtype=torch.float64).detach().reshape(-1) for part in several])
    if not len(deviations) or not bool((deviations > 0).all()):
        raise ValueError("noise is the standard deviation of pixels, and must be positive, got "
                         f"{float(deviations.min()) if len(deviations) else 'none'}; infinity masks a pixel")
    return deviations.square().reciprocal()


def _place(index: int, parameter: Tensor) -> list[int]:
    """The indices of an entry by its number in row-major order."""
    return [int(place) for place in torch.unravel_index(torch.tensor(index), parameter.shape)]
