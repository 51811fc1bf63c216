"""`curvature`: products with J^T Sigma^-1 J, how sharply images determine parameters."""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING, NamedTuple

import torch
from torch import Tensor

from torch_radbp.optim.linearisation import Images
from torch_radbp.rendering.cost import bytes_text, memory_of
from torch_radbp.rendering.renderer import Renderer
from torch_radbp.uncertainty.problem import Noise, Parameters, Problem

if TYPE_CHECKING:
    from scipy.sparse.linalg import LinearOperator

DENSE = 200  # parameters, for which a matrix is computed


class Product(NamedTuple):
    """A product with the curvature J^T Sigma^-1 J, or its diagonal, and the standard error."""

    value: Tensor  # (n,) float64
    error: Tensor  # (n,) its standard error by the noise of the renderings; NaN of a single pair


class DenseCurvature(NamedTuple):
    """The curvature J^T Sigma^-1 J as a matrix, with standard errors."""

    matrix: Tensor  # (n, n) float64, symmetric; unbiased, so that eigenvalues may be negative by noise
    error: Tensor  # (n, n) standard errors, by the jackknife
    without: Tensor  # (K, n, n) the matrices without the samples of one of the K seeds

    def along(self, directions: Tensor) -> tuple[Tensor, Tensor]:
        """The curvatures v^T H v along the columns v of (n, k) directions, and their standard errors, (k,) each."""
        others = torch.einsum("ik,sij,jk->sk", directions, self.without, directions)
        return torch.einsum("ik,ij,jk->k", directions, self.matrix, directions), _jackknife(others)


class Curvature:
    """Products with the curvature J^T Sigma^-1 J at the parameters' current values; see `curvature`."""

    def __init__(self, problem: Problem, seed: int):
        self.problem, self.seed = problem, seed

    @property
    def size(self) -> int:
        """The number n of parameters."""
        return self.problem.linear.size

    def product(self, direction: Tensor, pairs: int = 4, *, independent: bool = True) -> Product:
        """The product J^T Sigma^-1 J v with a direction v, and its standard error.

        Args:
            direction: v, (n,), in the order of the parameters.
            pairs: of forward and backward passes that are averaged; from two on, their scatter is the error.
            independent: False: both passes of a pair have the same seed. The product is then that of one noisy J, exactly,
                and biased upwards by the variance of its noise.

        Raises:
            ValueError: if v has another size, or there is no pair.
        """
        direction = torch.as_tensor(direction, dtype=torch.float64).detach().reshape(-1)
        if len(direction) != self.size or pairs < 1:
            raise ValueError(f"direction must have {self.size} entries and pairs be at least 1, got {len(direction)} and "
                             f"{pairs}")
        found = torch.stack([self._half(direction, self.seed + 2 * pair, self.seed + 2 * pair + independent)
                             for pair in range(pairs)])
        error = found.std(0) / pairs ** 0.5 if pairs > 1 else torch.full_like(found[0], torch.nan)
        return Product(found.mean(0), error)

    def linear_operator(self) -> LinearOperator:
        """(J_a^T Sigma^-1 J_b + J_b^T Sigma^-1 J_a) / 2 of two fixed seeds, for the solvers of scipy.

        It is symmetric, the same in every product, and unbiased over seeds; so it may have negative eigenvalues as large as
        noise makes them: add a prior, or take more samples. Float64 arrays of numpy, (n,).
        """
        from scipy.sparse.linalg import LinearOperator

        def product(direction):
            vector = torch.as_tensor(direction, dtype=torch.float64).reshape(-1)
            return self.symmetric(vector).cpu().numpy()

        return LinearOperator((self.size, self.size), matvec=product, rmatvec=product, dtype="float64")

    def symmetric(self, direction: Tensor) -> Tensor:
        """The product of `linear_operator` with v, (n,), as a tensor."""
        return (self._half(direction, self.seed, self.seed + 1) + self._half(direction, self.seed + 1, self.seed)) / 2

    def dense(self, repeats: int = 4) -> DenseCurvature:
        """The matrix, (n, n), from `repeats` Jacobians of independent seeds, at least 2: the mean over pairs of two.

        Raises:
            ValueError: for more than 200 parameters, or fewer than 2 repeats.
            MemoryError: if the Jacobians would not fit into memory.
        """
        if self.size > DENSE:
            raise ValueError(f"a matrix is for up to {DENSE} parameters, got {self.size}: use product or linear_operator")
        if repeats < 2:
            raise ValueError(f"repeats must be at least 2, since a Jacobian times itself is biased by noise, got {repeats}")
        spp, linear = self.problem.spp, self.problem.linear
        device, count = linear.parameters[0].device, len(linear.values(self.seed, 1))
        if (bytes_needed := 8 * repeats * self.size * count) > memory_of(device) / 2:
            raise MemoryError(f"{repeats} Jacobians of {count} by {self.size} numbers take {bytes_text(bytes_needed)}, and "
                              f"there are {bytes_text(memory_of(device))}: take fewer repeats, smaller images, or "
                              "`diagonal`")
        jacobians = [linear.jacobian(self.seed + number, spp) for number in range(repeats)]
        grams = torch.zeros(repeats, repeats, self.size, self.size, dtype=torch.float64)
        for a, b in combinations(range(repeats), 2):
            gram = (jacobians[a].T @ self.problem.weighted(jacobians[b])).cpu()
            grams[a, b] = grams[b, a] = (gram + gram.T) / 2

        def mean_of(chosen: list[int]) -> Tensor:
            return grams[chosen][:, chosen].sum((0, 1)) / max(len(chosen) * (len(chosen) - 1), 1)

        matrix = mean_of(list(range(repeats)))
        without = torch.stack([mean_of([other for other in range(repeats) if other != number]) for number in range(repeats)])
        if repeats == 2:
            without = torch.full_like(without, torch.nan)
        return DenseCurvature(matrix, _jackknife(without), without)

    def diagonal(self, probes: int = 32) -> Product:
        """The diagonal of J^T Sigma^-1 J, (n,), for any number of parameters: mean of z J_a^T Sigma^-1 J_b z, z = +-1.

        Its error has the noise of probing, which falls with the root of their number and with what lies beside the diagonal.

        Reference: Bekas, Kokiopoulou and Saad 2007, "An estimator for the diagonal of a matrix".
        """
        generator = torch.Generator().manual_seed(self.seed)
        found = []
        for probe in range(probes):
            signs = signs_of(self.size, generator)
            found.append(signs * self._half(signs, self.seed + 2 * probe, self.seed + 2 * probe + 1))
        return Product(torch.stack(found).mean(0), torch.stack(found).std(0) / probes ** 0.5)

    def _half(self, direction: Tensor, forward: int, backward: int) -> Tensor:
        """The product J_b^T Sigma^-1 J_a v with Jacobians of two seeds."""
        linear, spp = self.problem.linear, self.problem.spp
        return linear.backward(self.problem.weighted(linear.forward(direction, forward, spp)), backward, spp).cpu()


def signs_of(size: int, generator: torch.Generator) -> Tensor:
    """Independent signs, (size,) float64."""
    return torch.randint(0, 2, (size,), generator=generator).double() * 2 - 1


def _jackknife(without: Tensor) -> Tensor:
    """The standard error of a statistic by its values without one of K samples, (K, ...)."""
    return ((len(without) - 1) * (without - without.mean(0)).square().mean(0)).sqrt()


def curvature(images: Renderer | Images, parameters: Parameters, *, noise: Noise = 1.0, spp: int | None = None,
              seed: int = 0) -> Curvature:
    """J^T Sigma^-1 J of images by parameters: half the second derivative of the squared error where images meet targets.

        hessian = rb.curvature(renderer, ["green.reflectance.value", "light.emitter.radiance.value"], noise=0.02)
        matrix, error, _ = hessian.dense()

    J comes by forward mode, J^T by the backward pass, without second derivatives of anything; the two of a product have
    seeds of their own, so that noise does not bias it.

    Args:
        images: a renderer, all of whose sensors count; or a function of seed and samples per pixel that returns a tensor or
            several: some sensors, with exposures, networks, masks. It must read the parameters where they are.
        parameters: names of the renderer's scene; or names of one's own mapped to tensors, leaves that the images read.
        noise: Sigma^1/2, the standard deviation of pixels, in units of the images: a number, or a tensor or several of as
            many numbers as the images have; infinity where pixels do not count.
        spp: samples per pixel; None: as the renderer.
        seed: of the first rendering; the next ones follow.

    Returns:
        A `Curvature`: `product(v)`, with its standard error; `linear_operator()` for scipy; `dense()`, the matrix of up to
        200 parameters with its standard errors; `diagonal()`, by probing.

    Raises:
        TypeError, ValueError: for parameters that are none, and noise that is not positive.

    Reference: Nocedal and Wright 2006, "Numerical Optimization", section 10.3.
    """
    return Curvature(Problem(images, parameters, noise, spp), seed)
