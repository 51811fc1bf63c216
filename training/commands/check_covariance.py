"""`radbp check --covariance`: how far images tell the parameters of a scene or a recipe, before anything is optimised."""

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

import torch
from rich.console import Console
from rich.table import Table
from torch import Tensor

from torch_radbp.optim.linearisation import Images
from torch_radbp.uncertainty.covariance import CovarianceOfParameters, covariance_of, prior_precision
from torch_radbp.uncertainty.curvature import Curvature
from torch_radbp.uncertainty.problem import Problem

STRONG = 0.8  # correlations that are printed
SHARE = 0.01  # of the mean pixel, the noise that is taken if none is given
REPEATS = 4  # Jacobians


class Told(NamedTuple):
    """What images tell.

    Attributes:
        covariance: of the parameters.
        share: the noise as a share of the mean pixel.
    """

    covariance: CovarianceOfParameters
    share: float


def told_by(images: Images, parameters: dict[str, Tensor], noise: float | None, spp: int, seed: int) -> Told:
    """The covariance of parameters at where they stand, for images with noise.

    Args:
        images: by seed and samples per pixel, as for `rb.covariance`.
        parameters: leaves, by name.
        noise: standard deviation of a pixel; None: a hundredth of the mean pixel.
        spp: samples per pixel of each of four Jacobians.
        seed: of the first rendering.

    Raises:
        ValueError: the images are black and no noise is given, it is not positive, or there are too many parameters.
    """
    with torch.no_grad():
        mean = float(images(seed, spp).double().mean())
    if noise is None and not mean > 0:
        raise ValueError("the images are black, so that --noise has no default: give the standard deviation of a pixel")
    sigma = SHARE * mean if noise is None else noise
    problem = Problem(images, parameters, sigma, spp)
    found = covariance_of(problem, Curvature(problem, seed + 1).dense(REPEATS), prior_precision(problem, None))
    return Told(found, sigma / mean if mean > 0 else float("inf"))


def told_by_recipe(path: Path, noise: float | None, spp: int | None, seed: int, allow_outside: bool) -> Told:
    """That of a recipe: all of its parameters at their initial values, seen by the sensors of its targets."""
    from torch_radbp.training.recipe_file import read_recipe
    from torch_radbp.training.recovery.plain_values import plain_values
    from torch_radbp.training.recovery.problem import Recovery

    recovery = Recovery(read_recipe(path, allow_outside=allow_outside), allow_outside=allow_outside)
    for each in recovery.parameters:
        each.settle(recovery.scene)
    with ExitStack() as stack:
        plain = stack.enter_context(plain_values(recovery, recovery.parameters))
        return told_by(plain.images, plain.leaves, noise, spp or recovery.recipe.render.spp, seed)


def told_by_scene(renderer, names: Sequence[str], sensors: list[int], noise: float | None, spp: int, seed: int) -> Told:
    """That of named parameters of a scene, seen by some sensors."""
    leaves = {name: renderer.scene.get_parameter(name) for name in names}
    return told_by(lambda one, samples: renderer(seed=one, spp=samples, sensors=sensors), leaves, noise, spp, seed)


def print_told(console: Console, told: Told) -> None:
    """Prints deviations, correlations above 0.8, and what is flat."""
    found = told.covariance
    share = f"{100 * told.share:.2g} % of the mean"
    console.print(f"noise of a pixel: {found.noise:.3g}, {share}; deviations are in proportion to it", soft_wrap=True,
                  highlight=False)
    table = Table(box=None, padding=(0, 2, 0, 0))
    for number, heading in enumerate(("number", "value", "deviation")):
        table.add_column(heading, justify="right" if number else "left", overflow="fold")
    deviations = found.matrix.diag().sqrt().tolist()
    for name, value, deviation in zip(found.names, found.values.tolist(), deviations, strict=True):
        table.add_row(name, f"{value:.6g}", f"{deviation:.2g}" if deviation < float("inf") else "not told")
    console.print(table)
    for line in [f"not told: {each.words}" for each in found.flat] + correlations(found):
        console.print(line, soft_wrap=True, highlight=False, markup=False)


def correlations(found: CovarianceOfParameters) -> list[str]:
    """Correlated pairs, strongest first, a line each."""
    matrix = found.correlations.nan_to_num(0.0).triu(1)
    pairs = sorted((matrix.abs() > STRONG).nonzero().tolist(), key=lambda pair: -abs(float(matrix[pair[0], pair[1]])))
    return [f"correlated: {found.names[first]} and {found.names[second]}: {float(matrix[first, second]):+.3f}"
            for first, second in pairs] or [f"no correlation above {STRONG}"]
