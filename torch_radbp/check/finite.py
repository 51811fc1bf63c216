"""Tests whether values and derivatives are finite at grazing angles, at extreme random numbers, and in between."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.bsdf.contract import CheckedKind
from torch_radbp.check.lanes import LaneNumbers
from torch_radbp.interface.bsdf import Kind, Values
from torch_radbp.tensors.vec import Vec3

COSINE = (1.0, 1 - 1e-7, 0.75**0.5, 0.5, 1e-3, 1e-7, 0.0, -1e-7, -1e-3, -0.5, -1.0)
NUMBER = (0.0, 2.0**-24, 0.3, 0.75, 1 - 2.0**-24)
CHOICE = (0.0, 0.5, 1 - 2.0**-24)
ACROSS = (math.cos(0.9), math.sin(0.9))  # azimuth of wi
ROUNDINGS = 200  # of the squared length of a sampled direction


def differentiable_copy(vector: Vec3) -> Vec3:
    """A copy of a vector whose components require gradients."""
    return vector.map(lambda c: c.detach().clone().requires_grad_())


def viewers(cosine: Tensor) -> Vec3:
    """Unit vectors with the given cosines, all in one plane."""
    level = torch.sqrt((1 - cosine.double() ** 2).clamp_min(0)).to(cosine.dtype)
    return Vec3(level * ACROSS[0], level * ACROSS[1], cosine.clone())


def partners(wi: Vec3) -> list[Vec3]:
    """The directions with which every `wi` is evaluated: itself, mirrored, across, and at all cosines."""
    full = [Vec3(*(torch.full_like(wi.z, c) for c in ((1 - z * z) ** 0.5, 0.0, z))) for z in COSINE]
    return [-wi, wi, Vec3(-wi.x, -wi.y, wi.z), Vec3(-wi.x, -wi.y, -wi.z.abs()), *full,
            Vec3(*(torch.full_like(wi.z, c) for c in (-ACROSS[1], ACROSS[0], 0.0)))]


class Lanes(NamedTuple):
    """The arguments of a material's functions, with names for messages; values and wi attached."""

    values: Values
    wi: Vec3
    other: Vec3 | LaneNumbers  # wo, attached, or random numbers, of every lane

    @staticmethod
    def of(values: Values, wi: Vec3, others: Sequence[Vec3 | LaneNumbers]) -> Lanes:
        """The arguments for all pairs of a lane (values and wi) with one of `others`."""
        def repeated(vector: Vec3) -> Vec3:
            return differentiable_copy(vector.map(lambda c: c.detach().repeat(len(others))))

        joined = type(others[0])(*(torch.cat(parts) for parts in zip(*others)))
        return Lanes(tuple(map(repeated, values)), repeated(wi),
                     differentiable_copy(joined) if isinstance(joined, Vec3) else joined)

    def named(self) -> dict[str, Tensor]:
        """All scalar arguments of the lanes, by name."""
        scalars = {f"values[{k}].{c}": part for k, value in enumerate(self.values) for c, part in zip("xyz", value)}
        scalars |= {f"wi.{c}": part for c, part in zip("xyz", self.wi)}
        names = ("wo.x", "wo.y", "wo.z") if isinstance(self.other, Vec3) else ("choice", "u", "v")
        return scalars | dict(zip(names, self.other))

    def at(self, bad: Tensor) -> str:
        """The first of the lanes in `bad`, (N,) bool, in words."""
        number = int(bad.nonzero()[0])
        return ", ".join(f"{name} = {part[number].item():.9g}" for name, part in self.named().items())

    def troubles(self, outputs: dict[str, Vec3 | Tensor]) -> Iterator[str]:
        """Yields what is not finite of some outputs and their derivatives, in words; nothing costs one backward pass."""
        tensors = [tensor for output in outputs.values() for tensor in (output if isinstance(output, Vec3) else [output])]
        total = torch.stack([tensor.sum() for tensor in tensors]).sum()
        leaves = [part for part in self.named().values() if part.requires_grad]
        slopes = torch.autograd.grad(total, leaves, allow_unused=True, retain_graph=True) if total.requires_grad else ()
        # Of sums, since what is not finite stays so in them; they may overflow, and then no output is to blame.
        if not all(slope is None or bool(torch.isfinite(slope).all()) for slope in (*tensors, *slopes)):
            yield from filter(None, (self.not_finite(what, output) for what, output in outputs.items()))

    def not_finite(self, what: str, output: Vec3 | Tensor) -> str | None:
        """The first value or derivative of an output that is not finite, in words; None: all are finite.

        A lane's cotangent is 1 in every component.
        """
        leaves = {name: part for name, part in self.named().items() if part.requires_grad}
        for tensor in output if isinstance(output, Vec3) else [output]:
            bad = ~torch.isfinite(tensor)
            if bool(bad.any()):
                return f"{what} is {tensor[bad][0].item()} at {self.at(bad)}"
            if not tensor.requires_grad:
                continue
            slopes = torch.autograd.grad(tensor.sum(), list(leaves.values()), allow_unused=True, retain_graph=True)
            for name, slope in zip(leaves, slopes):
                bad = torch.zeros_like(tensor, dtype=torch.bool) if slope is None else ~torch.isfinite(slope)
                if bool(bad.any()):
                    return f"the derivative of {what} by {name} is {slope[bad][0].item()} at {self.at(bad)}"
        return None


def random_corners(kind: Kind | CheckedKind) -> list[tuple[float, float, float]]:
    """The random numbers (choice, u, v) with which samples are tested: extremes and values in between."""
    corners = list(itertools.product(NUMBER, NUMBER)) if not getattr(kind, "anisotropic", False) else [(0.3, 0.75)]
    return [(c, u, v) for (u, v), c in itertools.product(corners, CHOICE)]


def troubles_of_samples(kind: Kind | CheckedKind, values: Values, wi: Vec3,
                        corners: Sequence[tuple[float, float, float]], length_error: float = 0.0) -> Iterator[str]:
    """Yields what is not finite in samples, and at sampled directions, for each wi with all `corners`.

    It also yields samples whose squared length is off 1 by more than `length_error`, and some rounding.
    """
    lanes = Lanes.of(values, wi, [LaneNumbers(*(torch.full_like(wi.z, number).detach() for number in corner))
                                  for corner in corners])
    values, wi, random = lanes.values, lanes.wi, lanes.other
    choice = kind.choose(values, wi, *random)
    wrong = ~((choice.probability > 0) & (choice.probability <= 1))
    if bool(wrong.any()):
        yield f"the probability of a lobe is {choice.probability[wrong][0].item()} at {lanes.at(wrong.expand_as(wi.z))}"
    wo = kind.sample(values, wi, choice, random.u, random.v)
    outputs = {"a sample": wo}
    if kind.delta:
        outputs["specular"] = kind.specular(values, wi, choice)
    if kind.smooth:
        # At the sampled direction, also with the derivative of that direction: what the tracer uses.
        value, pdf = kind.eval_pdf(values, wi, wo)
        outputs |= {"eval at a sample": value, "pdf at a sample": pdf}
        outputs["the density with fixed lobes at a sample"] = kind.eval_pdf(values, wi, wo, True)[1]
        settled = pdf.detach()
        outputs["the weight of a sample"] = value / settled.clamp_min(1e-30) * (settled > 0).to(settled.dtype)
    yield from lanes.troubles(outputs)
    length = wo.x**2 + wo.y**2 + wo.z**2
    long = (length - 1).abs() > max(ROUNDINGS * torch.finfo(wi.z.dtype).eps, length_error)
    if bool(long.any()):
        yield f"a sample has a squared length of {length[long][0].item():.9g} at {lanes.at(long)}"


def troubles_of_evaluation(kind: Kind | CheckedKind, values: Values, wi: Vec3) -> Iterator[str]:
    """Yields what is not finite, or negative, for each wi with all of its `partners`."""
    lanes = Lanes.of(values, wi, partners(wi.detach()))
    value, pdf = kind.eval_pdf(lanes.values, lanes.wi, lanes.other)
    yield from lanes.troubles({"eval": value, "pdf": pdf})
    negative = (value.stack() < 0).any(1) | (pdf < 0)
    if bool(negative.any()):
        yield f"eval or pdf is negative at {lanes.at(negative)}"
