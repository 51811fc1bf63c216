"""`check_bsdf`: tests whether a material's samples, densities and weights agree with its BSDF.

Rendering and its derivatives both believe what a material says of itself: one that states half of its density is too bright,
and the derivative of the wrong image agrees with differences of the wrong image. Here it is held to its word alone, without
a scene.
"""

from __future__ import annotations

import math
from itertools import chain
from typing import Any

import torch

from torch_radbp.bsdf.contract import checked_kind, material_name
from torch_radbp.check.balance import balances, claims, energy, reciprocity
from torch_radbp.check.ends import at_ends, standing_alone, white
from torch_radbp.check.finite import (
    COSINE,
    differentiable_copy,
    random_corners,
    troubles_of_evaluation,
    troubles_of_samples,
    viewers,
)
from torch_radbp.check.lanes import directions, random_numbers, sampled, values_at
from torch_radbp.check.report import Finding, PluginCheck, worst
from torch_radbp.check.scattering import LENGTH, Subject, methods_off, scattering_findings
from torch_radbp.io.build import build_plugin
from torch_radbp.plugin import BSDF, integer
from torch_radbp.public_call import public_call
from torch_radbp.rendering.settings import checked_seed
from torch_radbp.tensors.vec import Vec3

PLACE = (0.37, 0.61, 0.23)  # u and v, and for textures of positions x, y and z
FEWEST_SAMPLES = 10_000
PAIRS = 20_000  # of directions
TURN = 1.1  # radians about the normal


@public_call
def check_bsdf(bsdf: BSDF | dict[str, Any], *, samples: int = 50_000, seed: int = 0) -> PluginCheck:
    """Tests whether a material's samples, densities and weights agree with its BSDF.

        print(rb.check_bsdf({"type": "minnaert", "exponent": 1.3}))

    Checked are, for viewers from above to grazing and from behind: `density` integrates to the share of samples that it is
    the density of; `samples` follow it (chi-square); `weight`, the mean of eval / pdf over samples is the integral of eval;
    `lobes` are chosen as often as their probability says; `methods` agree with each other; `statements` (`transmits`,
    `oriented`, `steering`) hold; `reciprocity`, and `energy`: no more light leaves than arrives, also if all reflectances
    are 1 (both up to 2%, and unless the kind says `reciprocal = False` or `conserves = False`); and everything is `finite`,
    derivatives included, at grazing angles and at the ends of random numbers and of the parameters' ranges, in float32 and
    float64.

    Textures are read in one place; an attribute of a mesh is 0.5 there, and a surface flat.

    Args:
        bsdf: a material, such as `scene.ball.bsdf`, or its description; left as it is.
        samples: of each viewer; with more, smaller errors show. At least 10,000.
        seed: of the random numbers; the same seed gives the same outcome.

    Returns:
        The findings, with figures; its `str()` is a table.

    Raises:
        TypeError: if a method of the material fails or returns another type than it should; the message names it. Or if
            `bsdf` is no material.
        ValueError: likewise of a wrong shape; or if an argument makes no sense.
    """
    if isinstance(bsdf, dict):
        bsdf = build_plugin(bsdf, "bsdf")
    if not isinstance(bsdf, BSDF):
        raise TypeError(f"bsdf must be a material or a dict that describes one, got a {type(bsdf).__name__}")
    samples, seed = integer("samples", samples, FEWEST_SAMPLES), checked_seed("seed", seed)
    bsdf = standing_alone(bsdf)
    subject = subject_of(bsdf)
    with torch.no_grad():
        findings = [*scattering_findings(subject, samples, seed), worst("methods", [methods_off(subject, PAIRS, seed)], "")]
        light = balances(subject, PAIRS, seed)
        findings += [reciprocity(light, claims(subject.kind, "reciprocal")),
                     energy({"as given": subject, "with white reflectances": subject_of(white(bsdf))}, light,
                            claims(subject.kind, "conserves"), samples, seed)]
    with torch.enable_grad():
        findings += [statements(subject, seed), _finite_everywhere(bsdf)]
    return PluginCheck(f"bsdf {material_name(bsdf)}", tuple(findings))


def subject_of(bsdf: BSDF) -> Subject:
    """A material at one surface point, its functions wrapped in checks of their contract."""
    return Subject(checked_kind(bsdf), lambda like: values_at(bsdf, PLACE, like))


def statements(subject: Subject, seed: int) -> Finding:
    """Tests what a kind of BSDF says of itself, `transmits`, `oriented` and `steering`, by evaluating and sampling it."""
    kind, wi, wo, random = subject.kind, directions(PAIRS, seed), directions(PAIRS, seed + 1), random_numbers(PAIRS, seed)
    values = tuple(differentiable_copy(value) for value in subject.values(wi.z))
    wrong = []
    choice, sample = sampled(kind, values, wi, random)
    value, pdf = kind.eval_pdf(values, wi, wo)
    crosses = (wi.z * wo.z < 0) & (value.stack() > 0).any(1)
    if kind.smooth and not kind.transmits and bool(crosses.any()):
        wrong.append("transmits is False, but eval is above 0 for directions on both sides")
    if kind.smooth and not kind.oriented:
        turned, turned_pdf = kind.eval_pdf(values, turn(wi), turn(wo))
        if not all(torch.allclose(a, b, rtol=1e-6, atol=1e-9, equal_nan=True)
                   for a, b in zip((*value, pdf), (*turned, turned_pdf))):
            wrong.append("oriented is False, but eval or pdf changes if both directions turn about the normal")
    leaves = [component for each in values for component in each]
    if leaves and any(component.requires_grad for component in sample):
        total = sum(weight * component.sum() for weight, component in zip((1.0, 0.7, 0.3), sample))
        slopes = torch.autograd.grad(total, leaves, allow_unused=True)
        steer = {k // 3 for k, slope in enumerate(slopes) if slope is not None and bool((slope != 0).any())}
        missing = sorted(steer - set(kind.steering))
        if missing:
            wrong.append(f"sample depends on values {missing}, which steering, {tuple(kind.steering)}, does not name")
    return Finding("statements", not wrong, "; ".join(wrong) or "transmits, oriented and steering are as stated")


def turn(w: Vec3) -> Vec3:
    """Rotates a direction about the normal."""
    c, s = math.cos(TURN), math.sin(TURN)
    return Vec3(c * w.x - s * w.y, s * w.x + c * w.y, w.z)


def _finite_everywhere(bsdf: BSDF) -> Finding:
    """The finding on finite values and derivatives at grazing angles and at the ends of parameters' ranges."""
    variants = {"as given": bsdf, **dict(at_ends(bsdf))}
    for words, variant in variants.items():
        for dtype in (torch.float32, torch.float64):
            alone = standing_alone(variant).to(dtype)
            kind, wi = checked_kind(alone), differentiable_copy(viewers(torch.tensor(COSINE, dtype=dtype)))
            values = tuple(differentiable_copy(value) for value in values_at(alone, PLACE, wi.z))
            trouble = next(chain(troubles_of_evaluation(kind, values, wi),
                                 troubles_of_samples(kind, values, wi, random_corners(kind), LENGTH)), None)
            if trouble is not None:
                return Finding("finite", False, f"{words}, in {str(dtype).removeprefix('torch.')}: {trouble}")
    return Finding("finite", True, f"values and derivatives, {len(COSINE)} cosines, {len(variants)} settings of parameters")
