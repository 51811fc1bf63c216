"""A smooth dielectric coat on a diffuse base, and what a rough one shares with it.

Light that enters the coat is reflected by the base and again, by the fraction R, by the inside of the coat, until it leaves:
with the fractions T_i and T_o that pass the coat on the way in and out, the base contributes

    rho / (1 - r R) T_i T_o cos / (pi eta^2),      r = rho if `nonlinear`, which shifts colours, else 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from torch_radbp.bsdf.fresnel import dielectric_reflectance
from torch_radbp.bsdf.ior import index_of_refraction
from torch_radbp.bsdf.number import OwnNumber
from torch_radbp.interface.bsdf import Kind, LobeChoice, Values, chance_of_lobe, reflects
from torch_radbp.plugin import BSDF, Texture, boolean, register
from torch_radbp.plugin.domain import NUMBER, REFLECTANCE, Domain
from torch_radbp.sampling.warp import cosine_hemisphere_pdf, square_to_cosine_hemisphere
from torch_radbp.tensors.vec import Vec3, where
from torch_radbp.texture.rgb import as_texture

LEAST_SHARE = 0.02  # of a reflectance when lobes are chosen: a black one is still sampled, and has a derivative
# Of both lobes of smooth plastic. The coat alone finds lamps in it, which are far brighter than the base; and towards the
# rim, where it reflects all, what the base loses has a large derivative.
LEAST_CHANCE = 0.2
LEAST_ESCAPE = 1e-3  # of 1 - r R; reached at indices beyond 3.9, where the fit of R is too large


def diffuse_fresnel_reflectance(eta: Tensor) -> Tensor:
    """The fraction of diffuse light that a smooth boundary reflects back inside; `eta`: index inside over outside.

    By the two fits that Mitsuba uses, the first for eta > 1: right to 0.1 per cent up to 1.5, 0.6 up to 2, 9.5 up to 5. At
    eta = 1, where both should vanish, they differ by 0.0015.

    Reference: Egan and Hilgeman 1973, "Spectral Reflectance of Particulate Materials"; d'Eon and Irving 2011, "A Quantized-
    Diffusion Model for Rendering Translucent Materials".
    """
    inverse = 1.0 / eta
    denser_inside = 0.0636 * eta + 0.6681 + inverse * (0.7099 - 1.4399 * inverse)
    thin = eta.clamp_max(1.0)
    denser_outside = 0.919317 + thin * (-3.4793 + thin * (6.75335 + thin * (-7.80989 + thin * (4.98554 - 1.36881 * thin))))
    return torch.where(eta > 1.0, denser_inside, denser_outside)


def coated(reflectance: Vec3, internal: Tensor, nonlinear: bool) -> Vec3:
    """The reflectance of a base under a coat that reflects the fraction `internal` back inside: rho / (1 - r R)."""
    return reflectance.map(lambda rho: rho / (1.0 - (rho * internal if nonlinear else internal)).clamp_min(LEAST_ESCAPE))


def specular_chance(reflected: Tensor, diffuse: Vec3, specular: Vec3) -> Tensor:
    """The probability of sampling the coat rather than the base.

    Args:
        reflected: (N,) the fraction of the light that the coat reflects, in [0, 1].
        diffuse, specular: reflectances; their means steer the choice.
    """
    of_coat = reflected * share(specular)
    return of_coat / (of_coat + (1.0 - reflected) * share(diffuse))


def share(reflectance: Vec3) -> Tensor:
    """The mean of a reflectance's channels, kept above `LEAST_SHARE`."""
    return ((reflectance.x + reflectance.y + reflectance.z) * (1.0 / 3.0)).clamp_min(LEAST_SHARE)


def coat_or_base(chance: Tensor, number: Tensor) -> LobeChoice:
    """Chooses lobe 0, the coat, with the probability `chance`, else lobe 1, the base."""
    coat = number < chance
    return LobeChoice((~coat).to(chance.dtype), torch.where(coat, chance, 1.0 - chance))


@dataclass(frozen=True)
class PlasticKind(Kind):
    """The BSDF of smooth plastic. Parameter values: eta (a scalar), diffuse_reflectance, specular_reflectance.

    Lobe 0 is the mirror, lobe 1 the base."""

    nonlinear: bool

    delta: ClassVar[bool] = True
    discrete: ClassVar[bool] = True

    @property
    def slots(self) -> int:
        return 3

    def chance(self, values: Values, wi: Vec3) -> tuple[Tensor, Tensor]:
        """The probability of choosing the mirror lobe, and the fraction of light that passes the coat."""
        eta, diffuse, specular = values
        reflected, _ = dielectric_reflectance(wi.z.abs(), eta.x)
        return LEAST_CHANCE + (1.0 - 2.0 * LEAST_CHANCE) * specular_chance(reflected, diffuse, specular), 1.0 - reflected

    def diffuse_reflectance(self, values: Values, wi: Vec3) -> Vec3:
        return values[1]

    def eval_pdf(self, values: Values, wi: Vec3, wo: Vec3, fixed_lobes: bool = False) -> tuple[Vec3, Tensor]:
        eta, diffuse, _ = values
        chance, passes_in = self.chance(values, wi)
        reflected, _ = dielectric_reflectance(wo.z.abs(), eta.x)
        density = cosine_hemisphere_pdf(wo) * reflects(wi, wo)
        base = coated(diffuse, diffuse_fresnel_reflectance(eta.x), self.nonlinear)
        scale = density * passes_in * (1.0 - reflected) / (eta.x * eta.x)
        return base * scale, density * (1.0 - chance_of_lobe(chance, fixed_lobes))

    def choose(self, values: Values, wi: Vec3, choice: Tensor, u: Tensor, v: Tensor) -> LobeChoice:
        picked = coat_or_base(self.chance_of_delta(values, wi), choice)
        return picked._replace(delta=picked.lobe == 0)

    def chance_of_delta(self, values: Values, wi: Vec3) -> Tensor | None:
        return self.chance(tuple(value.detach() for value in values), wi.detach())[0]

    def sample(self, values: Values, wi: Vec3, choice: LobeChoice, u: Tensor, v: Tensor) -> Vec3:
        return where(choice.delta, Vec3(-wi.x, -wi.y, wi.z), square_to_cosine_hemisphere(u, v))

    def specular(self, values: Values, wi: Vec3, choice: LobeChoice) -> Vec3:
        eta, _, reflectance = values
        reflected, _ = dielectric_reflectance(wi.z.abs(), eta.x)
        return reflectance * (reflected * reflects(wi, wi))


@register("bsdf", "plastic")
class Plastic(BSDF):
    """A smooth plastic, black from behind: a diffuse base under a smooth dielectric coat.

    Parameters: `eta`, a number; `diffuse_reflectance`, `specular_reflectance`, textures. Derivatives: with respect to all of
    them.

    The coat is sampled with 0.2 plus 0.6 times the probability that Mitsuba has: with that alone derivatives of what moves
    have a variance without bound at rims, and edges of lamps in the coat are hardly found. Reflectances are those at the
    point and not their means over the surface, and count as at least 0.02.

    Attributes:
        eta: index of refraction inside over the one outside; `int_ior` over `ext_ior` at first.

    Args:
        diffuse_reflectance: of the base; above 1, where it makes light, it is warned of.
        nonlinear: account for the shift of colours by light that is reflected inside several times.
        int_ior: index of refraction of the coat, a number or a material of `ior.DIELECTRICS`.
        ext_ior: the same outside.
        specular_reflectance: a factor on the light that the coat reflects; physical surfaces have 1, more is warned of.

    Raises:
        ValueError: if a material is unknown, or a value is out of range.
    """

    def __init__(self, *, diffuse_reflectance: Texture | float = 0.5, nonlinear: bool = False,
                 int_ior: float | str = "polypropylene", ext_ior: float | str = "air",
                 specular_reflectance: Texture | float = 1.0):
        super().__init__()
        self.ext_ior = index_of_refraction("ext_ior", ext_ior)
        self.freeze("eta", torch.tensor(index_of_refraction("int_ior", int_ior) / self.ext_ior))
        self.eta_texture = (OwnNumber(self, "eta"),)  # a tuple, so that it is no submodule
        self.nonlinear = boolean("nonlinear", nonlinear)
        self.diffuse_reflectance = as_texture(self, "diffuse_reflectance", diffuse_reflectance)
        self.specular_reflectance = as_texture(self, "specular_reflectance", specular_reflectance)

    def domains(self) -> dict[str, Domain]:
        return {"eta": NUMBER._replace(low=0.0, low_is_in=False), "diffuse_reflectance": REFLECTANCE,
                "specular_reflectance": REFLECTANCE}

    @property
    def int_ior(self) -> float:
        """Index of refraction inside, from the current `eta`."""
        return float(self.eta.detach()) * self.ext_ior

    def kind(self) -> Kind:
        """The functions that evaluate and sample this BSDF."""
        return PlasticKind(self.nonlinear)

    def textures(self) -> tuple[Texture, ...]:
        """The textures of this BSDF's parameters, in the order in which its functions take them."""
        return *self.eta_texture, self.diffuse_reflectance, self.specular_reflectance
