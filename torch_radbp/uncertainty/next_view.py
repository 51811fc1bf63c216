"""`next_view`: which of some photographs not yet taken would tell most about parameters; and images of what each tells."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.optim.linearisation import Images
from torch_radbp.rendering.renderer import Renderer
from torch_radbp.uncertainty.covariance import prior_precision
from torch_radbp.uncertainty.curvature import Curvature
from torch_radbp.uncertainty.problem import Parameters, Problem


class Outlook(NamedTuple):
    """The uncertainty of the parameters that would be left after photographs by a candidate."""

    name: str
    left: float  # the mean over parameters of their variance after it over that of the prior, 0 to 1
    standard_deviations: dict[str, Tensor]  # after it, by parameter, in its shape and units, float64


class RankedViews(NamedTuple):
    """Candidate views, the one that tells most about the parameters first."""

    ranking: list[Outlook]
    before: Outlook  # without any of them

    @property
    def best(self) -> str:
        """The name of the candidate that tells most."""
        return self.ranking[0].name

    def __str__(self) -> str:
        """A line for each candidate: the share of the prior's variance that it leaves."""
        return "\n".join(f"{view.name:20} leaves {100 * view.left:.3g} % of what was unknown"
                         for view in [*self.ranking, self.before])


def next_view(images: Renderer | Images, candidates: Sequence[str | int] | Mapping[str, Renderer | Images],
              parameters: Parameters, *, noise: float, prior: Mapping[str, float | Tensor], taken: Sequence[str | int] = (),
              spp: int | None = None, repeats: int = 3, seed: int = 0) -> RankedViews:
    """Ranks candidate views by how much they would shrink the covariance of parameters, by derivatives at their values.

        views = rb.next_view(renderer, ["left", "above", "close"], names, noise=0.02, prior={name: 0.3 for name in names})
        views.best

    It needs no photograph, as the covariance of a linear model does not depend on what is measured; but it holds for where
    the parameters stand, which should be a first fit.

    Args:
        images: a renderer; or, with a mapping of candidates, what has been photographed as a function of seed and spp.
        candidates: sensors of the renderer, by name or index; or names mapped to renderers or functions of seed and spp,
            such as the same view by another lamp.
        parameters: as for `curvature`, of up to 200 numbers; with functions names mapped to tensors.
        noise: standard deviation of the pixels of all, in units of the images.
        prior: as for `covariance`, of every parameter; what is left is told relative to it.
        taken: sensors of which there are photographs already.
        spp, repeats, seed: as for `covariance`; all candidates have the same seeds.

    Returns:
        `RankedViews`, which print as a table: `best`, a name; `ranking`, for each candidate its `name`, the share of the
        prior's variance that is `left`, and `standard_deviations`; `before`, the same without any.

    Raises:
        ValueError: without candidates, for a parameter without a prior, or as `curvature`.
        TypeError: if sensors are named beside a function.

    Reference: Chaloner and Verdinelli 1995, "Bayesian Experimental Design: A Review", section 2 (A-optimality).
    """
    if not candidates:
        raise ValueError("next_view chooses among candidates, got none")
    views: dict[str, Renderer | Images] = dict(candidates) if isinstance(candidates, Mapping) else {
        str(sensor): _sensors_of(images, [sensor]) for sensor in candidates}
    held = Problem(images, parameters, noise, spp).held
    first = Problem(images, held, noise, spp)
    precision = prior_precision(first, prior)
    if not bool((precision > 0).all()):
        raise ValueError(f"next_view needs a finite prior of every parameter, got {sorted(prior)} for {first.names}")

    def matrix_of(view: Renderer | Images) -> Tensor:
        return Curvature(Problem(view, held, noise, spp), seed).dense(repeats).matrix

    known = torch.zeros(len(precision), len(precision), dtype=torch.float64)
    if len(taken):
        known = matrix_of(_sensors_of(images, list(taken)))
    elif isinstance(candidates, Mapping) and not isinstance(images, Renderer):
        known = matrix_of(images)

    def left_by(name: str, matrix: Tensor) -> Outlook:
        variance = _variances(matrix, precision)
        return Outlook(name, float((variance * precision).mean()), first.by_name(variance.sqrt()))

    found = [left_by(name, known + matrix_of(view)) for name, view in views.items()]
    return RankedViews(sorted(found, key=lambda view: view.left), left_by("none of them", known))


def sensitivity(images: Renderer | Images, parameters: Parameters, *, spp: int | None = None, seed: int = 0
                ) -> dict[str, Tensor]:
    """The derivative of images by every number of some parameters: the columns of J, as pictures of where each is seen.

    Args:
        images, parameters: as for `curvature`; the function must return one tensor.
        spp, seed: as for a rendering.

    Returns:
        By the name of each number, such as `green.reflectance.value[0]`, the shape of the images, in their unit per unit of
        the parameter, float64.

    Raises:
        TypeError: as `curvature`.
    """
    problem = Problem(images, parameters, 1.0, spp)
    with torch.no_grad():
        image = problem.linear.images(seed, 1)
    if not isinstance(image, Tensor):
        raise TypeError(f"sensitivity takes a function that returns one tensor, got {type(image).__name__}")
    columns = problem.linear.jacobian(seed, spp)
    return {name: column.view(image.shape) for name, column in zip(problem.entries, columns.T, strict=True)}


def _sensors_of(renderer: Renderer | Images, sensors: list) -> Images:
    """The images of some sensors of a renderer, as a function of seed and spp; raises TypeError for a function."""
    if not isinstance(renderer, Renderer):
        raise TypeError("beside a function, candidates must map names to renderers or functions of seed and spp, and "
                        f"nothing can be `taken`, got sensors {sensors}")
    return lambda seed, spp: renderer(seed=seed, spp=spp, sensors=sensors)


def _variances(matrix: Tensor, precision: Tensor) -> Tensor:
    """The diagonal of (H + P)^-1, (n,); what noise makes of H below 0 counts as 0."""
    root = precision.sqrt()
    curvatures, vectors = torch.linalg.eigh(matrix / root / root[:, None])
    return (vectors.square() / (1 + curvatures.clamp_min(0))).sum(1) / precision
