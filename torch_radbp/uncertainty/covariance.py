"""`covariance`: how far parameters that were found from images are known, and which only together."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.optim.linearisation import Images, Linearisation
from torch_radbp.rendering.renderer import Renderer
from torch_radbp.uncertainty.curvature import Curvature, DenseCurvature, signs_of
from torch_radbp.uncertainty.directions import Direction, in_words, sparse_basis
from torch_radbp.uncertainty.problem import Noise, Parameters, Problem, images_of, named

FLAT = 1e-8  # of a curvature relative to that of single parameters: below is rounding
ERRORS = 3.0  # standard errors that a curvature must be above 0 to be one
STRONG = 0.95  # correlations that are put into words
DIAGONAL_PROBES = 8  # of the diagonal that preconditions conjugate gradients


class CovarianceOfParameters(NamedTuple):
    """The posterior covariance (J^T Sigma^-1 J + P)^-1 of n parameters, but for what is flat; see `covariance`."""

    names: list[str]  # of the n entries
    values: Tensor  # (n,) float64, where the parameters stand
    matrix: Tensor  # (n, n) float64, infinite variances on the diagonal of what is flat, and zeros beside these
    flat: list[Direction]  # along which images and prior say nothing, or no more than the noise of the derivatives
    weak: list[str]  # strongly correlated pairs, in words
    noise: float  # standard deviation of the pixels, the root of the mean of squares where they differ
    problem: Problem
    basis: Tensor  # (n, k) directions in which it is finite; matrix = basis basis^T where nothing is flat

    @property
    def standard_deviations(self) -> dict[str, Tensor]:
        """Standard deviations by parameter, in its shape and units, float64; infinite where a flat direction takes part."""
        return self.problem.by_name(self.matrix.diag().sqrt())

    @property
    def correlations(self) -> Tensor:
        """(n, n) float64, the correlations of the parameters; NaN for those that take part in a flat direction."""
        deviation = self.matrix.diag().sqrt()
        deviation = torch.where(deviation.isfinite(), deviation, torch.nan)
        return self.matrix / deviation / deviation[:, None]

    def propagated(self, function: Callable[[], Tensor]) -> Tensor:
        """Standard deviations of a function of the parameters to first order, in its shape, float64.

            covariance.propagated(lambda: scene.white.reflectance.value)  # of a value with a parametrisation

        They are infinite where the function changes along a flat direction: a product may be known whose factors are not.
        """
        linear = Linearisation(lambda seed, spp: function(), self.problem.linear.parameters)
        jacobian = linear.jacobian(0, None).cpu()
        variance = (jacobian @ self.basis).square().sum(1)
        for direction in self.flat:
            change = (jacobian @ direction.change).abs()
            alone = (jacobian * direction.change).abs().amax(1)
            variance = torch.where(change > 1e-3 * alone, torch.inf, variance)
        return variance.sqrt().view(function().shape)

    def __str__(self) -> str:
        """A table of values and deviations, then what is flat, and what is correlated."""
        deviation, width = self.matrix.diag().sqrt().tolist(), max(map(len, self.names))
        lines = [f"{name:{width}}  {value:12.6g} +- {spread:.2g}" for name, value, spread in
                 zip(self.names, self.values.tolist(), deviation, strict=True)]
        return "\n".join(lines + [f"not told: {direction.words}" for direction in self.flat] + self.weak)


class Diagonal(NamedTuple):
    """Standard deviations of many parameters, found by probing."""

    standard_deviations: dict[str, Tensor]  # by parameter, in its shape and units, float64
    error: dict[str, Tensor]  # their standard errors, by the scatter of the probes


def covariance(images: Renderer | Images, targets: Tensor | Sequence[Tensor], parameters: Parameters, *,
               noise: Noise | str = "residuals", prior: Mapping[str, float | Tensor] | None = None, spp: int | None = None,
               repeats: int = 4, seed: int = 0) -> CovarianceOfParameters:
    """The covariance of parameters that were fitted to images by least squares, weighted by the noise of these.

        found = rb.covariance(renderer, target, ["white.reflectance.value", "lamp.emitter.radiance.value"])
        print(found)  # values +- deviations, and what the images cannot tell

    It is that of a linear model around where the parameters stand, which must be what the images fit best; it does not know
    of other places that fit as well, of ranges, and of what renderer and world do not share. What changes images by no more
    than three standard errors of the derivatives' own noise is said to be flat: more `spp` or `repeats` tell.

    Args:
        images, parameters, spp, seed: as for `curvature`; up to 200 numbers in all, `diagonal_covariance` takes more.
        targets: of the shapes of the images.
        noise: standard deviation of a pixel of targets and renderings together, as for `curvature`; "residuals": one number
            for all, from the difference of images and targets, which holds the noise of both, and what does not fit.
        prior: standard deviations of what is known beforehand about parameters, by name, numbers or in the parameter's
            shape, around where they stand; infinity is none.
        repeats: Jacobians, of seeds of their own, at least 3.

    Returns:
        A `CovarianceOfParameters`, which prints as a table: `standard_deviations` by parameter; `matrix` and `correlations`,
        (n, n) float64, of the numbers called `names`; `flat`, directions that are not told, each with its `change`, (n,),
        and `words`; `weak`, strongly correlated pairs in words; `noise`; `propagated(function)`, deviations of a function of
        the parameters, such as the value of a parametrised one.

    Raises:
        ValueError: for a prior that is not positive or of no parameter, targets of another size, too many parameters, or
            fewer than 3 repeats.
        TypeError: as `curvature`.

    Reference: Tarantola 2005, "Inverse Problem Theory", section 3.2.
    """
    if repeats < 3:
        raise ValueError(f"repeats must be at least 3, or derivatives have no errors, got {repeats}")
    problem = Problem(images, parameters, noise_of(images, targets, parameters, noise, spp, seed), spp)
    precision = prior_precision(problem, prior)
    hessian = Curvature(problem, seed + 2).dense(repeats)
    return covariance_of(problem, hessian, precision)


def covariance_of(problem: Problem, hessian: DenseCurvature, prior: Tensor) -> CovarianceOfParameters:
    """The covariance that follows from a curvature, (n, n), and the precision of a prior, (n,)."""
    values, names = problem.linear.position().cpu(), problem.entries
    own, error = hessian.along(torch.eye(len(values), dtype=torch.float64))
    seen = (own > ERRORS * error) & (own > 0) | (prior > 0)
    sizes = torch.where(seen, (own.clamp_min(0) + prior), 1.0).rsqrt()  # the deviation of each if all others were known
    scaled = seen * (sizes * (hessian.matrix + prior.diag()) * sizes[:, None]) * seen[:, None]
    curvatures, vectors = torch.linalg.eigh(scaled)
    changes = sizes[:, None] * vectors
    _, error = hessian.along(changes)
    told = (curvatures > ERRORS * error) & (curvatures > FLAT)
    basis = changes[:, told] / curvatures[told].sqrt()
    matrix = basis @ basis.T
    flat = [Direction(change, in_words(change, values, names, sizes))
            for change in (sizes[:, None] * sparse_basis(vectors[:, ~told])).T]
    for direction in flat:
        share = (direction.change / sizes).abs()
        lost = share > 1e-3
        matrix[lost], matrix[:, lost] = 0.0, 0.0
        matrix[lost, lost] = torch.inf
    sigma = problem.precision[problem.precision > 0].reciprocal().mean().sqrt()
    weak = correlated(matrix, values, names)
    return CovarianceOfParameters(names, values, matrix, flat, weak, float(sigma), problem, basis)


def correlated(matrix: Tensor, values: Tensor, names: list[str]) -> list[str]:
    """Strongly correlated pairs of parameters in words, strongest first, with the joint change that images hardly show."""
    deviation = matrix.diag().sqrt()
    deviation = torch.where(deviation.isfinite(), deviation, torch.nan)
    correlation = matrix / deviation / deviation[:, None]
    found = []
    for first, second in (correlation.abs() > STRONG).triu(1).nonzero().tolist():
        change = torch.zeros_like(values)
        strength = float(correlation[first, second])
        change[first], change[second] = deviation[first], deviation[second] * (1 if strength > 0 else -1)
        found.append((-abs(strength), f"{in_words(change, values, names, deviation)}: {strength:.3f}"))
    return [words for _, words in sorted(found)]


def diagonal_covariance(images: Renderer | Images, parameters: Parameters, *, noise: Noise,
                        prior: Mapping[str, float | Tensor], spp: int | None = None, probes: int = 32,
                        seed: int = 0) -> Diagonal:
    """Standard deviations of any number of parameters, such as the texels of a bitmap, by samples of what they may be.

    Each probe draws noise for images and prior, b = J^T Sigma^-1/2 e + P^1/2 f, and solves (J^T Sigma^-1 J + P) x = b by
    conjugate gradients: x is then what a fit may be off by, and the mean of x^2 its variance, to sqrt(2 / probes) of it at
    worst. Most of that is taken off where parameters are hardly correlated, and where there is hardly more than the prior.
    J is of one seed: its noise makes deviations too small where samples are few.

    Args:
        images, parameters, noise, spp, seed: as for `curvature`.
        prior: as for `covariance`; every parameter must have one, so that what nothing sees has a deviation.
        probes: at least 4.

    Returns:
        A `Diagonal`, of `standard_deviations` and their standard `error` by the scatter of the probes, by parameter, each in
        its shape and units, float64.

    Raises:
        ValueError: for a parameter without a prior, or fewer than 4 probes.
        TypeError: as `curvature`.

    Reference: Papandreou and Yuille 2010, "Gaussian sampling by local perturbations".
    """
    problem = Problem(images, parameters, noise, spp)
    precision = prior_precision(problem, prior)
    if probes < 4 or not bool((precision > 0).all()):
        raise ValueError("probing needs at least 4 probes and a finite prior of every parameter, got "
                         f"{probes} and priors of {sorted(prior)} for {problem.names}")
    variance, error = variance_by(posterior_samples(problem, precision.rsqrt(), probes, seed))
    deviation = precision.rsqrt() * variance.sqrt()
    return Diagonal(problem.by_name(deviation), problem.by_name(deviation * error / (2 * variance)))


class PosteriorSamples(NamedTuple):
    """Samples x of errors of fits, in units of the prior's deviations S: (S H S + 1) x = b = S J^T Sigma^-1/2 e + f."""

    found: Tensor  # (K, n) float64, x
    drawn: Tensor  # (K, n) b
    prior: Tensor  # (K, n) f
    precision: Tensor  # (n,) of each parameter if all others were known, roughly: the diagonal of S H S + 1


def posterior_samples(problem: Problem, spread: Tensor, probes: int, seed: int) -> PosteriorSamples:
    """Draws `probes` samples of what fits may be off by, for a prior of standard deviations `spread`, (n,)."""
    import numpy
    from scipy.sparse.linalg import LinearOperator, cg

    linear, hessian, generator = problem.linear, Curvature(problem, seed), torch.Generator().manual_seed(seed)
    device, size = linear.parameters[0].device, linear.size
    weights = problem.weighted(torch.ones(len(linear.values(seed, 1)), dtype=torch.float64, device=device))

    def transposed(residuals: Tensor) -> Tensor:
        return spread * linear.backward(residuals, seed, problem.spp).cpu()

    def product(direction):
        """(S H S + 1) times a direction; the eigenvalues of this matrix are at least 1."""
        vector = spread * torch.from_numpy(direction.reshape(-1))
        return (spread * hessian.product(vector, 1, independent=False).value).numpy() + direction.reshape(-1)

    # Where J is 0 by chance, the prior is all that there is.
    own = torch.stack([transposed(weights.sqrt() * signs_of(len(weights), generator).to(device)).square()
                       for _ in range(DIAGONAL_PROBES)]).mean(0)
    rough = 1 + own
    operator = LinearOperator((size, size), matvec=product, dtype="float64")
    preconditioner = LinearOperator((size, size), matvec=lambda vector: vector.reshape(-1) / rough.numpy(), dtype="float64")
    found, drawn, of_prior = [], [], []
    for _ in range(probes):
        normal = torch.randn(len(weights), generator=generator, dtype=torch.float64).to(device)
        of_prior.append(torch.randn(size, generator=generator, dtype=torch.float64))
        drawn.append(transposed(weights.sqrt() * normal) + of_prior[-1])
        solved, left = cg(operator, drawn[-1].numpy(), rtol=1e-4, maxiter=10 * size, M=preconditioner)
        if left:
            raise RuntimeError(f"conjugate gradients did not converge in {left} iterations: take a narrower prior")
        found.append(torch.from_numpy(numpy.ascontiguousarray(solved)))
    return PosteriorSamples(torch.stack(found), torch.stack(drawn), torch.stack(of_prior), rough)


def variance_by(samples: PosteriorSamples) -> tuple[Tensor, Tensor]:
    """The variance of fits, the mean of x^2, (n,), improved by regression on control variates; and its standard error.

    These are x b and f^2, whose means are known to be 1: the first explains all of the error for parameters that images tell
    well by themselves, the second for those that only the prior tells. The variance is clamped to at most 1, and at least
    0.1 over the precision.
    """
    off = torch.stack([samples.found * samples.drawn, samples.prior.square()], -1).movedim(0, 1) - 1  # (n, K, 2)
    squares = samples.found.square().T[:, :, None]
    slopes = torch.linalg.lstsq(off - off.mean(1, keepdim=True), squares - squares.mean(1, keepdim=True), driver="gelsd")
    rest = (squares - off @ slopes.solution)[:, :, 0]
    variance = rest.mean(1).maximum(0.1 / samples.precision).clamp_max(1)
    return variance, rest.std(1) / (rest.shape[1] - 2) ** 0.5


def noise_of(images: Renderer | Images, targets: Tensor | Sequence[Tensor], parameters: Parameters, noise: Noise | str,
             spp: int | None, seed: int) -> Noise:
    """The noise as standard deviations: as given, or that of residuals, with the freedom of the parameters taken off.

    Raises:
        ValueError: if targets have not the shapes of images, or the noise is an unknown word, or residuals are all 0.
    """
    if isinstance(noise, str) and noise != "residuals":
        raise ValueError(f"noise must be a number, tensors, or \"residuals\", got {noise!r}")
    found, wanted = images_of(images), [targets] if isinstance(targets, Tensor) else list(targets)
    with torch.no_grad():
        rendered = found(seed, spp)
    rendered = [rendered] if isinstance(rendered, Tensor) else list(rendered)
    if [image.shape for image in rendered] != [target.shape for target in wanted]:
        raise ValueError(f"targets must have the shapes of the images, {[tuple(image.shape) for image in rendered]}, got "
                         f"{[tuple(target.shape) for target in wanted]}")
    if not isinstance(noise, str):
        return noise
    left = torch.cat([(image - target).double().reshape(-1) for image, target in zip(rendered, wanted, strict=True)])
    free = len(left) - sum(parameter.numel() for parameter in named(images, parameters).values())
    sigma = float(left.square().sum() / max(free, 1)) ** 0.5
    if not sigma > 0:
        raise ValueError("images and targets are equal, bit by bit: say what the noise of a pixel is")
    return sigma


def prior_precision(problem: Problem, prior: Mapping[str, float | Tensor] | None) -> Tensor:
    """One over the variances of a prior, (n,) float64, 0 where there is none.

    Raises:
        ValueError: if a deviation is not positive, or of no parameter.
    """
    for name, deviation in (prior or {}).items():
        if name not in problem.held:
            raise ValueError(f"the prior names {name!r}, which is none of the parameters: {problem.names}")
        if not bool((torch.as_tensor(deviation) > 0).all()):
            raise ValueError(f"the prior of {name!r} is a standard deviation and must be positive, got {deviation}: what is "
                             "known exactly is no parameter, so leave it out")
    parts = [torch.as_tensor((prior or {}).get(name, torch.inf), dtype=torch.float64).expand(parameter.shape).reshape(-1)
             for name, parameter in problem.held.items()]
    return torch.cat(parts).cpu().square().reciprocal()
