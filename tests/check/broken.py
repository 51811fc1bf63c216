"""Materials that do not do what they say, each in one way; beside them one that does."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import torch

from torch_radbp.interface.bsdf import Kind, LobeChoice
from torch_radbp.plugin import BSDF, REGISTRY, Texture, register
from torch_radbp.plugin.domain import FRACTION, REFLECTANCE
from torch_radbp.tensors.vec import Vec3
from torch_radbp.texture.rgb import as_texture

NAME = "felt"


@dataclass(frozen=True)
class FeltKind(Kind):
    """Diffuse. Values: reflectance, and a number that does nothing."""

    @property
    def slots(self):
        return 2

    def eval_pdf(self, values, wi, wo, fixed_lobes=False):
        pdf = cosine(wi, wo)
        return values[0] * pdf, pdf

    def sample(self, values, wi, choice, u, v):
        return lifted(u.sqrt(), v)


def cosine(wi, wo):
    """The density of `lifted(u.sqrt(), v)`."""
    return wo.z.clamp_min(0) / math.pi * ((wi.z > 0) & (wo.z > 0)).to(wo.z.dtype)


def lifted(radius, v):
    """Unit vectors above a point of the unit disk."""
    angle = 2 * math.pi * v
    return Vec3(radius * angle.cos(), radius * angle.sin(), (1 - radius * radius).clamp_min(1e-12).sqrt())


class Felt(BSDF):
    """Parameters: `reflectance`, `pile`, textures."""

    changes: dict[str, Any] = {}

    def __init__(self, *, reflectance: Texture | float = 0.5, pile: Texture | float = 0.5):
        super().__init__()
        self.reflectance, self.pile = as_texture(self, "reflectance", reflectance), as_texture(self, "pile", pile)

    def domains(self):
        return {"reflectance": REFLECTANCE, "pile": FRACTION}

    def kind(self):
        return type("FeltKind", (FeltKind,), self.changes)()

    def textures(self):
        return self.reflectance, self.pile


@contextmanager
def felt(**changes):
    """The description of a registered material, with other attributes of its kind."""
    register("bsdf", NAME)(type("Felt", (Felt,), {"changes": changes, "__init__": Felt.__init__}))
    try:
        yield {"type": NAME}
    finally:
        del REGISTRY["bsdf"][NAME]


def scattering(factor: Callable, pdf: Callable = lambda values, wi, wo: 1.0) -> dict[str, Any]:
    """An `eval_pdf` that is right but for factors, functions of values, wi and wo."""
    def eval_pdf(self, values, wi, wo, fixed_lobes=False):
        right = cosine(wi, wo)
        return values[0] * (right * factor(values, wi, wo)), right * pdf(values, wi, wo)

    return {"eval_pdf": eval_pdf}


def sampling(function: Callable) -> dict[str, Any]:
    """A `sample` that is a function of values, wi, u and v."""
    return {"sample": lambda self, values, wi, choice, u, v: function(values, wi, u, v)}


def choosing(probability: float) -> dict[str, Any]:
    """Two lobes that are the same, the second of which is picked with probability 0.3 and claims another."""
    def choose(self, values, wi, choice, u, v):
        second = (choice < 0.3).to(u.dtype)
        return LobeChoice(second, probability * second + 0.7 * (1 - second))

    return {"discrete": True, "choose": choose}


def level(w):
    """sqrt(1 - z^2), whose derivative at z = 1 is infinite."""
    return (1 - w.z * w.z).clamp_min(0).sqrt()


# What is wrong, and the checks that must find it. Of paint eval / pdf is the same everywhere, so that wrong samples alone
# leave the mean weight right.
BROKEN: dict[str, tuple[dict[str, Any], set[str]]] = {
    "half of the density": (scattering(lambda *_: 1.0, lambda *_: 0.5), {"density", "samples", "weight", "energy"}),
    "a density of something else": (scattering(lambda *_: 1.0, lambda values, wi, wo: 1.5 * wo.z.abs()),
                                    {"samples", "weight", "energy"}),
    "uniform samples": (sampling(lambda values, wi, u, v: lifted((1 - u * u).sqrt(), v)), {"samples"}),
    "samples around wi": (sampling(lambda values, wi, u, v: lifted((0.9 * u).sqrt(), v)), {"samples"}),
    "samples that are too long": (sampling(lambda values, wi, u, v: lifted(u.sqrt(), v) * 1.01),
                                  {"samples", "finite"}),
    "an eval of its own": ({"eval": lambda self, values, wi, wo: values[0] * cosine(wi, wo) * 1.1}, {"methods"}),
    "fixed lobes of another density": ({"eval_pdf": lambda self, values, wi, wo, fixed_lobes=False: (
        values[0] * cosine(wi, wo), cosine(wi, wo) * (0.9 if fixed_lobes else 1.0))}, {"methods"}),
    "a lobe of another probability": (choosing(0.5), {"lobes"}),
    "a probability that is not one": ({"choose": lambda self, values, wi, choice, u, v: LobeChoice(
        torch.zeros_like(u), torch.full_like(u, 0.5))}, {"lobes"}),
    "light out of nothing": (scattering(lambda *_: 1.1), {"energy"}),
    "light that favours one direction": (scattering(lambda values, wi, wo: 0.5 + 0.5 * wi.z.abs()), {"reciprocity"}),
    "a quotient at grazing angles": (scattering(lambda values, wi, wo: wi.z / wi.z), {"finite"}),
    "a derivative at the zenith": (scattering(lambda values, wi, wo: 1 - 0.5 * level(wi) * level(wo)), {"finite"}),
    "a logarithm at the end of a parameter": (scattering(
        lambda values, wi, wo: (values[1].x.log() * 0.1 + 1).clamp(0.0, 1.0)), {"finite"}),
    "a negative density": (scattering(lambda *_: 1.0, lambda values, wi, wo: torch.where(wo.z > 1e-6, 1.0, -1.0)),
                           {"finite"}),
    "light behind": ({"eval_pdf": lambda self, values, wi, wo, fixed_lobes=False: (
        values[0] * (wo.z.abs() / (2 * math.pi)), wo.z.abs() / (2 * math.pi))} | sampling(
            lambda values, wi, u, v: mirrored(lifted(u.sqrt(), (2 * v).remainder(1.0)), v)), {"statements"}),
    "a grain": (scattering(lambda values, wi, wo: 1 - 0.5 * wi.x.abs() * wo.x.abs()), {"statements"}),
    "samples that a value steers": (sampling(lambda values, wi, u, v: turned(lifted(u.sqrt(), v), values[1].x)),
                                    {"statements"}),
}


def mirror(weight: Callable = lambda wi: 1.0, **changes) -> dict[str, Any]:
    """A kind with one delta lobe, of a weight that is a function of wi."""
    return {"delta": True, "smooth": False, "sample": lambda self, values, wi, choice, u, v: Vec3(-wi.x, -wi.y, wi.z),
            "eval_pdf": lambda self, values, wi, wo, fixed_lobes=False: (Vec3.full(wo.z, 0.0), torch.zeros_like(wo.z)),
            "specular": lambda self, values, wi, choice: values[0] * weight(wi), **changes}


def aslant(self, values, wi, choice, u, v):
    """Reflects at a normal that is turned, for viewers from above, and back with half of that."""
    angle = 0.1 + 0.1 * wi.x
    return Vec3(-(wi.x * angle.cos() + wi.y * angle.sin()), wi.x * angle.sin() - wi.y * angle.cos(), wi.z)


BROKEN |= {
    "a mirror that shines": (mirror(lambda wi: 1.1), {"energy"}),
    "a mirror whose way back is another": (mirror(sample=aslant), {"reciprocity"}),
    "a mirror that is chosen half the time": (mirror(choose=lambda self, values, wi, choice, u, v: LobeChoice(
        torch.zeros_like(u), torch.full_like(u, 0.5))), {"lobes", "energy"}),
    "a mirror that is never chosen": (mirror(choose=lambda self, values, wi, choice, u, v: LobeChoice(
        torch.zeros_like(u), torch.zeros_like(u))), {"lobes", "energy", "finite"}),
    "no numbers at all": (scattering(lambda values, wi, wo: wo.z * torch.nan, lambda values, wi, wo: wo.z * torch.nan),
                          {"density", "weight", "reciprocity", "energy", "finite"}),
    "samples that are no numbers": (sampling(lambda values, wi, u, v: lifted(u.sqrt(), v) * torch.nan),
                                    {"density", "weight", "energy", "finite"}),
    "a density without bound": (scattering(lambda *_: 1.0, lambda values, wi, wo: wo.z / 0.0),
                                {"density", "samples", "weight", "finite"}),
}


def mirrored(w, v):
    """`w`, below the surface where v is above a half."""
    return Vec3(w.x, w.y, w.z * torch.where(v > 0.5, -1.0, 1.0))


def turned(w, angle):
    """`w` turned about the normal."""
    return Vec3(angle.cos() * w.x - angle.sin() * w.y, angle.sin() * w.x + angle.cos() * w.y, w.z)
