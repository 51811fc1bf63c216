"""The quadratic model of least squares around a position, the step that it proposes, and how good that was."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

SOLVED = 0.2  # of the noise of the gradient, below which conjugate gradients need not solve for it
FLAT = 1e-10  # of the largest curvature, in units of those of single parameters: below, a step would have any length
LEAST_DIAGONAL = 0.1  # of the mean of the diagonal of H that is estimated


class Model(NamedTuple):
    """The quadratic model of half the squared residuals around a position: g^T d + d^T H d / 2."""

    gradient: Tensor  # (n,) g = J^T W r
    changes: Callable[[Tensor], Tensor]  # J d, (n,) to (M,), where parameters stand
    weights: Tensor  # (M,) W
    transposed: Callable[[Tensor], Tensor]  # J^T, (M,) to (n,)
    scale: Tensor  # (n,) what damping is in units of, > 0: the diagonal of H, or an estimate of it
    noise: Tensor  # (n,) the part of g that is noise: J^T W (r_1 - r_2) / 2
    noises: Tensor | None = None  # (n, M) that of each residual: the columns of J^T W times (r_1 - r_2) / 2
    matrix: Tensor | None = None  # (n, n) H, if it is known as a whole
    jacobian: Tensor | None = None  # (M, n) J, if it is known as a whole

    def curvature(self, step: Tensor) -> float:
        """The curvature d^T H d of the model along a step d."""
        change = self.changes(step)
        return float((self.weights * change) @ change)

    def fall(self, step: Tensor, true: float = 1.0) -> float:
        """The predicted fall of half the squared residuals by a step; `true`: the share of curvature that is no noise."""
        return -float(self.gradient @ step) - 0.5 * true * self.curvature(step)


class Trial(NamedTuple):
    """The effect of a step d and the error of J, estimated by residuals of two seeds without bias from their noise."""

    fall: float  # of r_1^T W r_2 / 2
    doubt: float  # how far two estimates of that are apart
    error_of_j: float | None  # (D - J d)^T W (D - J d) over D^T W D, D being their change; None: not told, D is all noise


def model_of(jacobian: Tensor, pair: list[Tensor], weights: Tensor) -> Model:
    """The quadratic model of residuals whose Jacobian is known as a whole.

    Args:
        jacobian: (M, n).
        pair: residuals r_1 and r_2 of two seeds, (M,) each.
        weights: W, (M,).

    Raises:
        ValueError: if the Jacobian is 0.
    """
    matrix = jacobian.T @ (weights[:, None] * jacobian)
    scale = matrix.diag()
    if not bool(scale.any()):
        raise ValueError("no parameter changes the residuals: does the closure read the optimizer's parameters?")
    mean, half = weights * (pair[0] + pair[1]) / 2, weights * (pair[0] - pair[1]) / 2
    return Model(jacobian.T @ mean, lambda step: jacobian @ step, weights, lambda part: jacobian.T @ part,
                 scale.clamp_min(1e-12 * float(scale.max())), jacobian.T @ half, jacobian.T * half, matrix, jacobian)


def proposed(model: Model, damping: float, free: Tensor, iterations: int) -> tuple[Tensor, float]:
    """The step of the damped model, (n,), for parameters that are free, and the length of its noise over its own.

    Args:
        damping: relative to `Model.scale`.
        free: (n,) 1, or 0 for parameters that stay.
        iterations: of conjugate gradients, if H is not known as a whole.
    """
    root = model.scale.sqrt()
    if model.matrix is None:
        step = conjugate_gradients(model, damping, free, iterations)
        return step, float((model.noise / root).norm() / (model.gradient / root).norm())
    values, vectors = torch.linalg.eigh(free * (model.matrix / root / root[:, None]) * free[:, None])
    known = values > FLAT * float(values.abs().max())
    inverse = torch.where(known, 1 / (values.clamp_min(1e-300) + damping), 0.0)
    solve = vectors @ (inverse[:, None] * vectors.T) * free / root  # of a gradient, in units of the root
    step = -(solve @ model.gradient) / root
    noise = max(float((solve @ model.noise).norm()), float((solve @ model.noises).norm()))
    return step, noise / max(float((root * step).norm()), 1e-300)


def conjugate_gradients(model: Model, damping: float, free: Tensor, iterations: int) -> Tensor:
    """Solves (H + damping scale) d = -g for the entries that are free, until noise is larger than what is left.

    Lengths are those of gradients over the root of the scale, which preconditions.

    Reference: Nocedal and Wright 2006, "Numerical Optimization", algorithm 5.3.
    """
    step, left = torch.zeros_like(model.gradient), -free * model.gradient
    direction = left / model.scale
    square = float(left @ direction)
    enough = max(1e-12 * square, SOLVED ** 2 * float((free * model.noise.square() / model.scale).sum()))
    for _ in range(iterations):
        if square <= enough:
            break
        change = model.changes(direction)
        bent = free * (model.transposed(model.weights * change) + damping * model.scale * direction)
        curvature = float((model.weights * change) @ change + damping * (model.scale * direction) @ direction)
        if curvature <= 0:
            break
        length = square / curvature
        step, left = step + length * direction, left - length * bent
        square, last = float(left @ (left / model.scale)), square
        direction = left / model.scale + square / last * direction
    return step


def diagonal_of(transposed: Callable[[Tensor], Tensor], weights: Tensor, probes: int, seed: int) -> Tensor:
    """An estimate of the diagonal of H = J^T W J, (n,): the mean square of J^T W^1/2 z over random signs z, at least a
    tenth of its mean.

    It scales steps. By their own curvature alone parameters that images hardly see, such as texels at the poles of a sky,
    would move as far as others, in order to make up for the errors of those, before these are found.

    Args:
        transposed: J^T w of w, (M,): (n,).
        weights: W, (M,).
        probes: the number of products.
        seed: of the signs.

    Raises:
        ValueError: if J is 0.
    """
    generator, root = torch.Generator().manual_seed(seed), weights.sqrt()
    signs = [torch.randint(0, 2, weights.shape, generator=generator).to(weights) * 2 - 1 for _ in range(probes)]
    found = torch.stack([transposed(root * sign).square() for sign in signs]).mean(0)
    if not bool(found.any()):
        raise ValueError("no parameter changes the residuals: does the closure read the optimizer's parameters?")
    return found.clamp_min(LEAST_DIAGONAL * float(found.mean()))


def trial_of(model: Model, step: Tensor, before: list[Tensor], after: list[Tensor], weights: Tensor) -> Trial:
    """Evaluates a step by residuals of two seeds before and after it, (M,) each."""
    falls = [-0.5 * float((weights * (before[one] + after[one])) @ (after[two] - before[two]))
             for one, two in ((0, 1), (1, 0))]
    off = None
    if model.jacobian is not None:
        a, b = (now - then for now, then in zip(after, before, strict=True))
        told = model.jacobian @ step
        change, noise = float((weights * a) @ b), 0.5 * float((weights * (a - b)) @ (a - b))
        if change > noise or noise == 0:
            off = float((weights * (a - told)) @ (b - told)) / max(change, 1e-300)
    return Trial(sum(falls) / 2, abs(falls[0] - falls[1]), off)


def noise_of_j(model: Model, step: Tensor, other: Tensor, weights: Tensor) -> float:
    """The variance of J d over d^T H d, by a product with J of another seed, (M,)."""
    apart = model.jacobian @ step - other
    return 0.5 * float((weights * apart) @ apart) / max(model.curvature(step), 1e-300)
