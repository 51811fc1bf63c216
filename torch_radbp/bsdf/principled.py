"""Burley's "principled" material for artists."""

from __future__ import annotations

import torch

from torch_radbp.bsdf.burley import ROUGHNESS, check_rates
from torch_radbp.bsdf.features import features_of
from torch_radbp.bsdf.number import NumberOf, OwnNumber
from torch_radbp.bsdf.principled_lobes import PrincipledKind
from torch_radbp.plugin import BSDF, Texture, register
from torch_radbp.plugin.domain import FRACTION, NUMBER, REFLECTANCE, Domain
from torch_radbp.texture.rgb import as_texture

# Parameters that cost nothing while they are zero, in the order of their values.
FEATURES = ("anisotropic", "metallic", "spec_trans", "spec_tint", "sheen", "sheen_tint", "clearcoat", "clearcoat_gloss",
            "flatness")
MOST_SPECULAR = 4.0  # an index of refraction of 3.6, more than what is transparent has
PART_OF = {"sheen_tint": "sheen", "clearcoat_gloss": "clearcoat"}  # without which they do not matter


@register("bsdf", "principled")
class Principled(BSDF):
    """A material by parameters for artists, most of them between 0 and 1, after Burley.

    Parameters: textures, but for `eta` or `specular`, a number. Derivatives: with respect to all parameters, also where one
    is zero; below a roughness of 0.032 reflections have the derivatives that they have there. As in Mitsuba, a white base
    reflects a few per cent more light than it receives, and more with sheen; metal and glass do not.

    What is not given, or is zero and does not require a gradient, costs nothing. Each lobe is sampled with the probability
    that Mitsuba has, but as if its weight were at least 0.02.

    Args:
        base_color: of the diffuse base and of metal; above 1, where it makes light, it is warned of.
        roughness: its square is the roughness of the microfacets.
        anisotropic: how much the reflections are stretched along the coordinate u.
        metallic: 1 is a metal, 0 plastic or glass.
        spec_trans: 1 is glass, 0 opaque; it makes a material that is not black from behind.
        eta: index of refraction inside over the one outside.
        specular: instead of eta, 12.5 times the reflectance of the boundary from straight above; 0.5 by default. Up to 4, as
            some exporters write it: 1 is an index of refraction of 1.79, 2 of 2.33.
        spec_tint: by how much reflections of what is no metal have the tint of `base_color`.
        sheen: reflection at grazing angles, as of cloth.
        sheen_tint: by how much it has the tint of `base_color`.
        clearcoat: a second, sharp reflection.
        clearcoat_gloss: how sharp.
        flatness: by how much the base is like one in which light is scattered below the surface.
        diffuse_reflectance_sampling_rate, main_specular_sampling_rate, clearcoat_sampling_rate: how often these are
            sampled, relative to each other.

    Raises:
        ValueError: if eta and specular are both given, or a value is out of range.
    """

    def __init__(self, *, base_color: Texture | float = 0.5, roughness: Texture | float = 0.5,
                 anisotropic: Texture | float = 0.0, metallic: Texture | float = 0.0, spec_trans: Texture | float = 0.0,
                 eta: float | None = None, specular: float | None = None, spec_tint: Texture | float = 0.0,
                 sheen: Texture | float = 0.0, sheen_tint: Texture | float = 0.0, clearcoat: Texture | float = 0.0,
                 clearcoat_gloss: Texture | float = 0.0, flatness: Texture | float = 0.0,
                 diffuse_reflectance_sampling_rate: float = 1.0, main_specular_sampling_rate: float = 1.0,
                 clearcoat_sampling_rate: float = 1.0):
        super().__init__()
        if eta is not None and specular is not None:
            raise ValueError(f"give either eta or specular, which is another measure of it, got {eta} and {specular}")
        given = {"anisotropic": anisotropic, "metallic": metallic, "spec_trans": spec_trans, "spec_tint": spec_tint,
                 "sheen": sheen, "sheen_tint": sheen_tint, "clearcoat": clearcoat, "clearcoat_gloss": clearcoat_gloss,
                 "flatness": flatness}
        for name, value in {"base_color": base_color, "roughness": roughness, **given}.items():
            setattr(self, name, as_texture(self, name, value))
        if eta is None:
            self.eta = None
            self.freeze("specular", torch.tensor(0.5 if specular is None else float(specular)))
        else:
            self.specular = None
            self.freeze("eta", torch.tensor(float(eta)))
        self.views = tuple(NumberOf(self, name) for name in ("roughness", *FEATURES))  # no submodules
        self.index_texture = (OwnNumber(self, "specular" if eta is None else "eta"),)
        self.diffuse_reflectance_sampling_rate = float(diffuse_reflectance_sampling_rate)
        self.main_specular_sampling_rate = float(main_specular_sampling_rate)
        self.clearcoat_sampling_rate = float(clearcoat_sampling_rate)
        check_rates(self.rates(), "main_specular_sampling_rate")

    def domains(self) -> dict[str, Domain]:
        return {"base_color": REFLECTANCE, "roughness": ROUGHNESS, **{name: FRACTION for name in FEATURES},
                "eta": NUMBER._replace(low=0.0, low_is_in=False), "specular": NUMBER._replace(low=0.0, high=MOST_SPECULAR)}

    def rates(self) -> dict[str, float]:
        """The sampling rates of the diffuse base, the main boundary and the clearcoat, by attribute."""
        names = "diffuse_reflectance_sampling_rate", "main_specular_sampling_rate", "clearcoat_sampling_rate"
        return {name: getattr(self, name) for name in names}

    @property
    def numbers(self) -> dict[str, NumberOf]:
        """The textures that are read as scalars, by attribute."""
        return dict(zip(("roughness", *FEATURES), self.views))

    def features(self) -> tuple[str, ...]:
        """The names of the optional parameters that have an effect now, in order."""
        return features_of(self, FEATURES, PART_OF)

    def kind(self) -> PrincipledKind:
        """The functions that evaluate and sample this BSDF."""
        return PrincipledKind(self.features(), self.eta is None, tuple(self.rates().values()))

    def textures(self) -> tuple[Texture, ...]:
        """The textures of this BSDF's parameters, in the order in which its functions take them."""
        numbers = self.numbers
        return self.base_color, numbers["roughness"], *self.index_texture, *(numbers[name] for name in self.features())
