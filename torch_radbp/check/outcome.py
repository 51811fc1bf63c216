"""`GradientCheck`: the outcome of a gradient check, and its verdict."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from torch import Tensor

from torch_radbp.check.statistics import STEP_ERROR, Comparison, Projection
from torch_radbp.formats.html_table import html_table

AGREES, BIASED, SILHOUETTES, TOO_NOISY = "agrees", "biased", "biased, probably by silhouettes", "too noisy"
TOO_LARGE, AT_FLOOR = "too large a step", "at a floor"

MOST_Z = 4.0  # of a projection; by chance about once in a thousand with 16 batches
DETECT = 0.05  # the relative error that must not go unnoticed
SHRINKS = 0.6  # an error of differences shrinks to 1/4 or 1/2 by half of the step, one of the derivative stays
MOST_ROUNDINGS = 1e4  # of the dtype's epsilon, between forward and backward pass: sums in another order


class Question(NamedTuple):
    """The settings of a gradient check, whether geometry moves, and which terms of the derivative are left out."""

    name: str  # these fields as in `GradientCheck`
    direction: Tensor
    step: float
    sides: str
    spp: int
    batches: int
    seed: int
    moves: bool  # the parameter moves geometry, so that derivatives of edges could be missing
    left_out: list[str]  # known omissions of the renderer's derivatives


@dataclass(frozen=True)
class GradientCheck:
    """The derivative of an image along a direction, by finite differences and by the renderer.

    Attributes:
        name: of the parameter.
        direction: of the parameter's shape.
        step: h of the differences, in units of `direction`.
        sides: "to both sides", or "to one side" at the end of the parameter's domain.
        spp: samples per pixel of each estimate.
        batches: the number of independent repetitions.
        seed: of the random numbers.
        comparison: the images (`difference`, `jvp`, `standard_error`, `z`, each (B, 3, H, W) float64 on the scene's device)
            and the figures (`pixels`, `tiles`, `projections`).
        verdict: "agrees", "biased", "biased, probably by silhouettes", "too noisy", "too large a step" or "at a floor".
        explanation: a sentence that says why, and what to do.
        detectable: the smallest relative error of the derivative that would have been detected.
    """

    name: str
    direction: Tensor
    step: float
    sides: str
    spp: int
    batches: int
    seed: int
    comparison: Comparison
    verdict: str
    explanation: str
    detectable: float

    @property
    def agrees(self) -> bool:
        """True if the verdict is "agrees"."""
        return self.verdict == AGREES

    @property
    def title(self) -> str:
        """The parameter, with step and samples, as text."""
        return (f"{self.name}, step {self.step:.3g} {self.sides}, "
                f"{self.spp} samples per pixel in {self.batches} batches")

    def figures(self) -> dict[str, Any]:
        """The outcome without its images: numbers and strings that a file can hold."""
        comparison = self.comparison
        projections = [projection._asdict() | {"z": projection.z, "relative_error": projection.relative_error}
                       for projection in comparison.projections]
        return {"parameter": self.name, "verdict": self.verdict, "explanation": self.explanation, "step": self.step,
                "sides": self.sides, "spp": self.spp, "batches": self.batches, "seed": self.seed,
                "detectable": self.detectable, "not_finite": comparison.not_finite, "pixels": comparison.pixels._asdict(),
                "tiles": comparison.tiles._asdict(), "projections": projections}

    def __str__(self) -> str:
        widths = [max(map(len, column)) for column in zip(*self.rows())]
        lines = [self.title, *("  ".join(map(str.rjust, row, widths)) for row in self.rows())]
        lines += [f"{label}: {value}" for label, value in self.summary()]
        return "\n".join([*lines, f"{self.verdict}: {self.explanation}"])

    def _repr_html_(self) -> str:
        headings, *rows = self.rows()
        return html_table(self.title, headings, [*rows, *self.summary()], f"{self.verdict}: {self.explanation}")

    def rows(self) -> list[tuple[str, ...]]:
        """The table of projections as text, headings first; "off by" and "VJP-JVP" are relative errors."""
        body = [(p.name, f"{p.difference:.5g}", f"{p.jvp:.5g}", f"{p.standard_error:.2g}", f"{p.z:+.2f}",
                 f"{p.relative_error:+.2%}", f"{p.backward_error:.1e}") for p in self.comparison.projections]
        return [("projected on", "differences", "JVP", "std error", "z", "off by", "VJP-JVP"), *body]

    def summary(self) -> list[tuple[str, str]]:
        """The figures of pixels and tiles as text: label and value."""
        pixels, tiles = self.comparison.pixels, self.comparison.tiles
        bias = f"{tiles.relative_bias:.2%}" if tiles.mean_square_z > tiles.limit else "no more than chance explains"
        return [("pixels: mean square z", f"{pixels.mean_square_z:.2f}"),
                ("pixels: |z| above 3", f"{pixels.share_above_3:.2%}"),
                ("pixels: largest |z|", f"{pixels.max_z:.1f}"),
                ("pixels: mean relative error, with noise", f"{pixels.mean_relative_error:.2%}"),
                ("pixels that hold half of the squared error", f"{pixels.concentration:.1%}"),
                ("tiles: mean square z", f"{tiles.mean_square_z:.2f} (by chance up to {tiles.limit:.2f})"),
                ("tiles: relative error, without noise", bias),
                ("smallest error of the derivative that would show", f"{self.detectable:.1%}")]


def judge(question_asked: Question, comparison: Comparison) -> GradientCheck:
    """Decides the verdict on a comparison of derivatives.

    A derivative is biased if a projection of it is off by more than 4 standard errors and by more than 1% of its scale, or
    if its tiles are off by more than chance allows and by more than 1%; the 1% is allowed for the step of the finite
    differences, and what they bend by. It is biased, too, if it is not finite, or if forward mode and the backward pass
    disagree. Silhouettes are named if the renderer has said that it leaves some out. It is too noisy if an error of 5% could
    have gone undetected. `said_of_step` finds out whether the finite step is what makes it biased.
    """
    informative = comparison.projections[1]
    surest = min(comparison.projections if informative.bend else [informative], key=hidden)
    verdict, explanation = verdict_on(comparison, question_asked, surest)
    *question, _, _ = question_asked
    return GradientCheck(*question, comparison, verdict, explanation, hidden(surest))


def said_of_step(question: Question, result: GradientCheck, halved: Comparison, change: Comparison) -> GradientCheck:
    """Revises a biased verdict, if the error shrinks with the step: then the step is too large.

    Args:
        question: what led to it.
        result: of differences by the whole step.
        halved: of differences by half of the step, from the same samples.
        change: of the differences, compared with none.
    """
    changes = is_off(change) or any(abs(projection.z) > MOST_Z for projection in change.projections)
    before, after = largest_error(result.comparison, result.comparison), largest_error(result.comparison, halved)
    if not changes or not abs(after) < SHRINKS * abs(before):
        return result
    return replace(result, verdict=TOO_LARGE, explanation=(
        f"differences by this step are off by {before:+.1%}, and by half of it {after:+.1%}, so that they make the error, "
        f"not the derivative; use a smaller step (step={question.step / 8:.2g})"))


def said_of_floor(result: GradientCheck, floor: float) -> GradientCheck:
    """Revises a biased verdict on a parameter that lies below the value to which its plugin clamps it."""
    return replace(result, verdict=AT_FLOOR, explanation=(
        f"values below {floor:.3g} may count as larger ones, with the derivatives that these have, so that optimizers can "
        f"leave the end of the range again; differences do not show that. Check the derivative at {floor:.3g} or more"))


def is_off(comparison: Comparison) -> bool:
    """True if tiles of the derivative image differ by more than chance allows."""
    return comparison.tiles.mean_square_z > comparison.tiles.limit


def largest_error(by: Comparison, of: Comparison) -> float:
    """The relative error in `by` of the projection that is worst in `of`; that of tiles if no projection is off."""
    off = off_projections(by)
    worst = by.projections.index(max(off, key=lambda projection: abs(projection.z))) if off else None
    return of.tiles.relative_bias if worst is None else of.projections[worst].relative_error


def off_projections(comparison: Comparison) -> list[Projection]:
    """The projections of the derivative image whose error exceeds what chance and the finite step explain."""
    return [p for p in comparison.projections if abs(p.z) > MOST_Z and abs(p.relative_error) > STEP_ERROR]


def hidden(projection: Projection) -> float:
    """The relative error of a derivative that noise and step could hide in a projection; infinite for a zero projection."""
    size = projection.size
    return max(MOST_Z * uncertainty(projection), projection.bend / size) if size > 0 else math.inf


def uncertainty(projection: Projection) -> float:
    """The standard error relative to the size of a projection; infinite for a zero projection."""
    return projection.standard_error / projection.size if projection.size > 0 else math.inf


def verdict_on(comparison: Comparison, question: Question, surest: Projection) -> tuple[str, str]:
    """The verdict on a derivative, and the sentence that explains it."""
    if comparison.not_finite:
        return BIASED, f"the derivative by forward mode has {comparison.not_finite} values that are NaN or infinite"
    apart = max(comparison.projections, key=lambda projection: projection.backward_error)
    if apart.backward_error > MOST_ROUNDINGS * comparison.eps:
        return BIASED, (f"forward mode and the backward pass differ by {apart.backward_error:.2g}, relative, on the same "
                        f"samples ({apart.name}): one of them is wrong")
    if not comparison.difference.any() and not comparison.jvp.any():
        return TOO_NOISY, ("both derivatives are zero everywhere, so that nothing is compared: what this sensor sees does "
                           "not depend on the parameter; choose another direction, sensor or max_depth")
    off, tiles = off_projections(comparison), comparison.tiles
    if off or (is_off(comparison) and tiles.relative_bias > STEP_ERROR):
        worst = max(off, key=lambda projection: abs(projection.z)) if off else None
        where = (f"off by {worst.relative_error:+.1%} ({worst.z:+.1f} standard errors) on {worst.name}" if worst
                 else f"off by {tiles.relative_bias:.1%} in tiles of the image, though not in sum")
        held = f"half of the squared error lies in {comparison.pixels.concentration:.1%} of the pixels"
        if question.left_out:
            return SILHOUETTES, f"{where}; {held}. The renderer leaves out a part: {'; '.join(question.left_out)}"
        step = "By half of the step the differences are off as well"
        if question.moves:
            return BIASED, (f"{where}; {held}. The renderer does not know of anything that it leaves out; without a warning "
                            f"it leaves out edges that surfaces see by reflection, and shadows of a mask's holes. {step}")
        return BIASED, f"{where}; {held}. {step}"
    detectable = hidden(surest)
    if math.isinf(detectable):
        return TOO_NOISY, ("the sum of both estimates is zero, so that nothing is compared; choose another direction, "
                           "sensor, step or max_depth")
    if detectable > DETECT and surest.bend > MOST_Z * surest.standard_error:
        return TOO_NOISY, (f"an error below {detectable:.1%} would go undetected, since differences to one side are so far "
                           f"off those to both, as where edges move over the borders of pixels; use a smaller step "
                           f"(step={question.step / 8:.2g}) and 8 times the samples (spp={8 * question.spp}), or another "
                           f"direction")
    if detectable > DETECT:
        more = math.ceil(min((detectable / DETECT) ** 2, 1e9))
        return TOO_NOISY, (f"an error below {detectable:.1%} would go undetected; use {more} times the samples "
                           f"(spp={more * question.spp}){', or a larger step' if question.moves else ''}")
    return AGREES, f"an error of {max(detectable, STEP_ERROR):.1%} of the derivative would have been detected"
