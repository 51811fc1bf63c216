"""Products with the Jacobian of images, by forward mode, and with its transpose, by the backward pass."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

import torch
from torch import Tensor
from torch.autograd import forward_ad

from torch_radbp.optim.separate_columns import SeparateColumns, parts_of
from torch_radbp.scene.cache.common_work import CommonWork
from torch_radbp.tensors.torch_internals import same_versions

Images = Callable[[int, int | None], Tensor | Sequence[Tensor]]  # of a seed and a number of samples per pixel


@dataclass
class Products:
    """The work that products with one Jacobian J, and with its transpose, share."""

    position: Tensor  # (n,) float64, of the parameters
    seed: int
    spp: int | None
    common: CommonWork = field(default_factory=CommonWork)  # of forward mode
    images: list[Tensor] | None = None  # attached
    versions: list[int] | None = None  # of the parameters, as these were written into


class Linearisation:
    """Images as a function of n parameters, with products of its Jacobian J, (M, n), at their current values.

    The function may be any composition of torch and of renderers that reads the parameters where they are: modules with
    parametrisations, networks, exposures. While J v is computed the parameters are dual tensors in place, of unchanged
    value. At the same seed products with J and with its transpose are exact transposes of each other; at several,
    independent.

    Args:
        images: a function of seed and samples per pixel that returns a tensor, or several, of any shapes; M numbers in all.
        parameters: leaves that it reads, floating-point, n numbers in all.
        columns: the columns of J that change no part of the images in common, as an earlier one showed; None: unknown.

    Raises:
        TypeError: if they are no leaves of a floating dtype, or `images` cannot be called.
        ValueError: if there is none, or one occurs twice.

    Reference: Griewank and Walther 2008, "Evaluating Derivatives", chapter 3.
    """

    def __init__(self, images: Images, parameters: Iterable[Tensor], columns: SeparateColumns | None = None):
        self.images, self.parameters, self.columns = images, list(parameters), columns
        if not callable(images):
            raise TypeError(f"images must be a function of seed and spp, got {type(images).__name__}")
        if not self.parameters:
            raise ValueError("there must be at least one parameter, got none")
        for parameter in self.parameters:
            if not isinstance(parameter, Tensor) or not parameter.is_floating_point() or not parameter.is_leaf:
                raise TypeError("parameters must be leaves of a floating dtype, such as scene.get_parameter(NAME), of a "
                                f"parametrised one its `original`; got {_described(parameter)}")
        if len({id(parameter) for parameter in self.parameters}) < len(self.parameters):
            raise ValueError("each parameter may be given once only")
        self.size = sum(parameter.numel() for parameter in self.parameters)
        self.shapes: list[torch.Size] = []  # of the images of the last product
        self.products: Products | None = None  # at one place; None: they share nothing

    @contextmanager
    def sharing(self) -> Iterator[None]:
        """A context in which products with J and J^T at the same values, seed and samples share their work.

        Forward mode finds paths, and places at which images jump, once. Of backward products the graph is kept, with the
        paths that it needs; it takes the memory of a step of training until other products follow, or the context ends.
        """
        before, self.products = self.products, Products(torch.empty(0, dtype=torch.float64), 0, 0)
        try:
            yield
        finally:
            self.products = before

    def products_at(self, seed: int, spp: int | None) -> Products:
        """The record of shared work for products at the current values, this seed and spp; a new one if any has changed."""
        if self.products is None:
            return Products(torch.empty(0, dtype=torch.float64), seed, spp)
        here = self.position()
        if (self.products.seed, self.products.spp) != (seed, spp) or not torch.equal(self.products.position, here):
            self.products = Products(here, seed, spp)
        versions = [parameter._version for parameter in self.parameters]
        if self.products.versions != versions:  # written into, if only what they held before: no graph goes back past that
            self.products.versions, self.products.images = versions, None
        return self.products

    def position(self) -> Tensor:
        """The values of all parameters, (n,) float64, detached."""
        return _flat(self.parameters)

    def move_to(self, position: Tensor) -> None:
        """Assigns values to the parameters, (n,)."""
        with torch.no_grad():
            for parameter, values in zip(self.parameters, self.shaped(position), strict=True):
                parameter.copy_(values)

    def shaped(self, flat: Tensor) -> list[Tensor]:
        """The parts of (n,) numbers in the shapes and dtypes of the parameters."""
        parts = flat.split([parameter.numel() for parameter in self.parameters])
        return [part.view(parameter.shape).to(parameter) for part, parameter in zip(parts, self.parameters, strict=True)]

    def values(self, seed: int, spp: int | None) -> Tensor:
        """The images, (M,) float64, detached."""
        with torch.no_grad():
            return _flat(_several(self.images(seed, spp)))

    def forward(self, tangent: Tensor, seed: int, spp: int | None) -> Tensor:
        """J v for a direction v, (n,): (M,) float64."""
        common = self.products_at(seed, spp).common
        with same_versions(self.parameters), torch.no_grad(), forward_ad.dual_level(), common.shared():
            for parameter, part in zip(self.parameters, self.shaped(tangent), strict=True):
                if bool(part.any()):
                    parameter.copy_(forward_ad.make_dual(parameter.detach().clone(), part.contiguous()))
            images = [forward_ad.unpack_dual(image) for image in _several(self.images(seed, spp))]
            self.shapes = [image.primal.shape for image in images]
            return _flat([torch.zeros_like(image.primal) if image.tangent is None else image.tangent for image in images])

    def backward(self, cotangent: Tensor, seed: int, spp: int | None) -> Tensor:
        """J^T w for w, (M,): (n,) float64; 0 for parameters that the images do not depend on."""
        required, products = [parameter.requires_grad for parameter in self.parameters], self.products_at(seed, spp)
        try:
            for parameter in self.parameters:
                parameter.requires_grad_()
            if products.images is None:
                with torch.enable_grad():
                    products.images = _several(self.images(seed, spp))
            found = self.gradients(products.images, cotangent)
        finally:
            for parameter, was in zip(self.parameters, required, strict=True):
                parameter.requires_grad_(was)
        return _flat([torch.zeros_like(parameter) if gradient is None else gradient
                      for parameter, gradient in zip(self.parameters, found, strict=True)])

    def gradients(self, images: list[Tensor], cotangent: Tensor) -> Sequence[Tensor | None]:
        """The derivatives of <images, cotangent> by each parameter, None where there is none; images are attached."""
        attached = [image for image in images if image.requires_grad]
        parts = cotangent.split([image.numel() for image in images])
        weights = [part.view(image.shape).to(image) for part, image in zip(parts, images, strict=True)
                   if image.requires_grad]
        if not attached:
            return [None] * len(self.parameters)
        return torch.autograd.grad(attached, self.parameters, weights, retain_graph=self.products is not None,
                                   allow_unused=True)

    def jacobian(self, seed: int, spp: int | None) -> Tensor:
        """J, (M, n) float64, by forward mode: a product for each column, or for each group of separate ones."""
        with self.sharing():
            return self._jacobian(seed, spp)

    def _jacobian(self, seed: int, spp: int | None) -> Tensor:
        if self.columns is not None and self.columns.save:
            separate = self.columns.jacobian(lambda direction: self.forward(direction, seed, spp), self.parts)
            if separate is not None:
                return separate
        identity = torch.eye(self.size, dtype=torch.float64, device=self.parameters[0].device)
        found = torch.stack([self.forward(direction, seed, spp) for direction in identity], dim=1)
        if self.columns is None or self.columns.save:
            self.columns = SeparateColumns.of(found, self.parts(), self.columns)
        return found

    def parts(self) -> Tensor:
        """The part of the images, such as a channel, to which each row of the last product belongs, (M,) int64."""
        return parts_of(self.shapes, self.parameters[0].device)


def _several(images: Tensor | Sequence[Tensor]) -> list[Tensor]:
    """The images that a function returns, as a list."""
    found = [images] if isinstance(images, Tensor) else list(images)
    if not found or not all(isinstance(image, Tensor) for image in found):
        raise TypeError("images must return a tensor or a sequence of tensors, got "
                        f"{type(images).__name__} of {[type(image).__name__ for image in found]}")
    return found


def _flat(tensors: Sequence[Tensor]) -> Tensor:
    """All numbers of some tensors, (N,) float64, detached."""
    return torch.cat([tensor.detach().reshape(-1).double() for tensor in tensors])


def _described(value: object) -> str:
    """A description, for messages, of a value that is no valid parameter."""
    return f"a tensor of {value.dtype} that is computed from others" if isinstance(value, Tensor) else type(value).__name__
