"""Tests whether a material's samples follow its density, and whether their weights agree with its BSDF.

For each of several viewers, with densities and BSDFs integrated over cells of the sphere (`sphere.py`):

    density   the integral of `pdf` is the share of samples that reach a smooth lobe; the others went to delta lobes, or lost
    samples   they fall into the cells as often as `pdf` says (chi-square; Subr and Arvo 2007)
    weight    the mean of eval / pdf over the samples is the integral of `eval`
    lobes     a lobe is chosen as often as its `probability` says
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.bsdf.contract import CheckedKind
from torch_radbp.check.chi_square import SIGNIFICANCE, p_value
from torch_radbp.check.lanes import direction, directions, random_numbers, sampled, unit_length_error, weight_of
from torch_radbp.check.report import Finding, worst
from torch_radbp.check.sphere import AZIMUTH, Cells, Integral
from torch_radbp.interface.bsdf import Kind, LobeChoice, Values
from torch_radbp.tensors.vec import Vec3, rows

VIEWERS = {"normal": 1.0, "steep": 0.9, "oblique": 0.5, "grazing": 0.08, "behind": -0.6, "grazing behind": -0.1}
SIGMAS = 5.0  # of chance that are allowed; by chance in one of two million
QUADRATURE = 2e-3  # that integrals may be off beyond their estimated error, where densities jump
SHARE = 200  # samples are this many times those that a cell may have before it is halved
TRIES = 16  # pairs of random numbers with which lobes are chosen
LENGTH = 1e-6  # that a squared length may be off


class Subject(NamedTuple):
    """The scattering functions of a material, and their parameters at one surface point."""

    kind: CheckedKind | Kind
    values: Callable[[Tensor], Values]  # of its parameters, on as many lanes as the argument has


class ViewerSamples(NamedTuple):
    """BSDF samples for one viewer, and integrals over the sphere; float64."""

    where: str
    wo: Vec3  # (N,)
    keep: Tensor  # (N,) bool: samples that reach a smooth lobe
    weight: Tensor  # (N, 3) of all samples
    delta: Tensor  # (N,) bool
    cells: Cells | None  # None: there are no smooth lobes
    density: Integral | None
    scattered: list[Integral]  # of each channel


def viewed(subject: Subject, where: str, count: int, seed: int) -> ViewerSamples:
    """Samples a material for one of `VIEWERS`, and integrates its density and BSDF."""
    kind, wi, random = subject.kind, direction(VIEWERS[where], AZIMUTH, count), random_numbers(count, seed)
    values = subject.values(wi.z)
    sample = sampled(kind, values, wi, random)
    delta = sample.choice.is_delta(kind)
    weight = weight_of(kind, values, wi, sample).stack().detach()
    wo, cells, density, scattered = sample.wo.detach(), None, None, []
    keep = torch.zeros_like(delta)
    if kind.smooth:
        keep = (kind.eval_pdf(values, wi, wo)[1].detach() > 0) & ~delta

        def functions(w: Vec3) -> tuple[Tensor, ...]:
            value, pdf = kind.eval_pdf(subject.values(w.z), direction(VIEWERS[where], AZIMUTH, len(w.z)), w)
            return pdf.expand_as(w.z), *(channel.expand_as(w.z) for channel in value)

        cells = Cells.around(rows(wo, keep[:count // 2].nonzero()[:, 0]), max(count // SHARE, 1))
        density, *scattered = cells.integrals(functions)
    return ViewerSamples(where, wo, keep, weight, delta, cells, density, scattered)


def density_off(view: ViewerSamples) -> tuple[float, str]:
    """The error of the integral of the density, in units of what is allowed, and the figures in words."""
    share, total = view.keep.double().mean().item(), view.density.value.sum().item()
    allowed = SIGMAS * math.sqrt(share * (1 - share) / len(view.keep)) + view.density.error.sum().item() + QUADRATURE
    return abs(total - share) / allowed, f"{view.where}: pdf integrates to {total:.4f}, of the samples {share:.4f} have one"


def fit(view: ViewerSamples) -> float:
    """The p-value of the chi-square test of samples against the density; 1 without samples.

    0 if the density is not finite.
    """
    half = len(view.keep) // 2  # those that have not made the cells
    smooth = view.keep[half:].nonzero()[:, 0] + half
    if not len(smooth):
        return 1.0
    if not bool(torch.isfinite(view.density.value).all()):
        return 0.0
    number = len(view.keep) - half
    return p_value(view.cells.counts(rows(view.wo, smooth)), number * view.density.value, 0, number * view.density.error)


def _samples_off(view: ViewerSamples) -> tuple[float, str]:
    """The misfit of sampled directions to their density, in units of what is allowed, and the figures in words."""
    p, length = fit(view), unit_length_error(rows(view.wo, (view.keep | view.delta).nonzero()[:, 0]))
    if not length <= LENGTH:
        return math.inf, f"{view.where}: squared lengths of samples are off 1 by up to {length:.2g}"
    return (1.0 if p >= SIGNIFICANCE else math.inf), f"{view.where}: chi-square, p = {p:.2g} (fails below {SIGNIFICANCE:g})"


def weight_off(view: ViewerSamples) -> tuple[float, str]:
    """The error of the mean of eval / pdf against the integral of eval in the worst channel, in units of what is allowed."""
    smooth = view.weight * (~view.delta).double()[:, None]
    means, errors = smooth.mean(0), smooth.std(0) / len(smooth) ** 0.5
    cases = []
    for mean, error, scattered in zip(means.tolist(), errors.tolist(), view.scattered):
        total = scattered.value.sum().item()
        allowed = SIGMAS * error + scattered.error.sum().item() + QUADRATURE * max(abs(total), abs(mean))
        cases.append((abs(mean - total) / max(allowed, 1e-12),
                      f"{view.where}: samples reflect {mean:.4f} by eval / pdf, eval integrates to {total:.4f}"))
    return max(cases)


def lobes_off(subject: Subject, where: str, seed: int, count: int = 4096) -> tuple[float, str]:
    """The error of lobes' frequencies against their probabilities, in units of what is allowed; u and v are held."""
    kind, off = subject.kind, 0.0
    wi, choice = direction(VIEWERS[where], AZIMUTH, count), (torch.arange(count, dtype=torch.float64) + 0.5) / count
    for pair in torch.rand(TRIES, 2, generator=torch.Generator().manual_seed(seed), dtype=torch.float64):
        u, v = (number.expand(count).clone() for number in pair)
        lobe_choice = kind.choose(subject.values(wi.z), wi, choice, u, v)
        lobes, number = numbered(chosen_lobes(lobe_choice), count), lobe_choice.probability.expand(count)
        frequency = torch.bincount(lobes).double() / count
        off = max(off, float((frequency[lobes] - number).abs().max()))
    # Of a lobe that others stand between, each border is counted half a step too far or too near.
    return off * count / 4, f"{where}: lobes are chosen off their probability by up to {off:.2g}"


def chosen_lobes(choice: LobeChoice) -> list[Tensor]:
    """Tensors that distinguish chosen lobes: numbers of all nested choices, and probabilities."""
    return [choice.lobe, choice.probability, *(lobe for part in choice.parts for lobe in (part.lobe, part.probability))]


def numbered(parts: list[Tensor], count: int) -> Tensor:
    """(count,) int64 numbers of lanes, from 0 on: the same where all parts are the same."""
    number = torch.zeros(count, dtype=torch.int64)
    for part in parts:  # one by one, which is quicker than to compare rows
        of_part = part.expand(count).unique(return_inverse=True)[1]
        number = (number * count + of_part).unique(return_inverse=True)[1]
    return number


def scattering_findings(subject: Subject, count: int, seed: int) -> list[Finding]:
    """The findings on density, samples, weights and lobes."""
    views = [viewed(subject, where, count, seed + number) for number, where in enumerate(VIEWERS)]
    smooth = [view for view in views if view.density is not None]
    ideal = "only delta lobes, whose pdf is 0"
    findings = [worst("density", [density_off(view) for view in smooth], ideal),
                worst("samples", [_samples_off(view) for view in smooth], ideal),
                worst("weight", [weight_off(view) for view in smooth], ideal)]
    return [*findings, worst("lobes", [lobes_off(subject, where, seed) for where in VIEWERS], "")]


def methods_off(subject: Subject, count: int, seed: int) -> tuple[float, str]:
    """The disagreement of `eval`, `pdf` and `eval_pdf`, or negative values, in units of what is allowed, and the figures."""
    kind, wi, wo = subject.kind, directions(count, seed), directions(count, seed + 1)
    values = subject.values(wi.z)
    value, pdf = kind.eval_pdf(values, wi, wo)
    others = {"eval": (kind.eval(values, wi, wo), value), "pdf": (kind.pdf(values, wi, wo), pdf)}
    others |= dict(zip(("eval_pdf with fixed_lobes, the BSDF", "eval_pdf with fixed_lobes, the density"),
                       zip(kind.eval_pdf(values, wi, wo, True), (value, pdf))))
    for name, pair in others.items():
        other, expected = (each.stack().detach() if isinstance(each, Vec3) else each.detach() for each in pair)
        if not torch.allclose(other, expected, rtol=1e-9, atol=0, equal_nan=True):
            return math.inf, f"{name} differs from eval_pdf by up to {float((other - expected).abs().max()):.2g}"
    least = min(float(value.stack().min()), float(pdf.min()))
    return (math.inf if least < 0 else 0.0), (f"eval or pdf is negative, {least:.2g}" if least < 0 else
                                              "eval, pdf and eval_pdf say the same")
