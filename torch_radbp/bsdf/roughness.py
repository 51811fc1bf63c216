"""Attributes that rough materials share: the microfacet distribution, and the textures of roughness."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from torch_radbp.bsdf.microfacet import DISTRIBUTIONS, SMALLEST_ALPHA
from torch_radbp.bsdf.number import NumberOf
from torch_radbp.plugin import BSDF, Texture, boolean, nearest
from torch_radbp.plugin.domain import AMOUNT
from torch_radbp.texture.bitmap import reader_of
from torch_radbp.texture.rgb import as_texture

ROUGHNESS = dict.fromkeys(("alpha", "alpha_u", "alpha_v"), AMOUNT._replace(floor=SMALLEST_ALPHA))  # domains


def check_distribution(distribution: str) -> str:
    """Checks the name of a microfacet distribution and returns it.

    Raises:
        ValueError: if it is unknown.
    """
    if distribution not in DISTRIBUTIONS:
        raise ValueError(f"distribution {distribution!r} is not known; {nearest(distribution, DISTRIBUTIONS)}")
    return distribution


def make_rough(owner: BSDF, distribution: str, sample_visible: bool, alpha: Texture | float | None,
               alpha_u: Texture | float | None, alpha_v: Texture | float | None) -> None:
    """Sets the attributes of a rough surface on `owner`: its distribution, and the textures of its roughness.

    Raises:
        ValueError: if a name is unknown, attributes exclude each other, or a value is out of range.
    """
    owner.distribution = check_distribution(distribution)
    owner.sample_visible = boolean("sample_visible", sample_visible)
    rough = roughness(owner, alpha, alpha_u, alpha_v)
    owner.alpha, owner.alpha_u, owner.alpha_v = (rough.get(name) for name in ("alpha", "alpha_u", "alpha_v"))
    owner.rough_numbers = roughness_numbers(owner)


def roughness(owner: BSDF, alpha: Texture | float | None, alpha_u: Texture | float | None,
              alpha_v: Texture | float | None) -> dict[str, Texture]:
    """The roughness textures of `owner` by attribute: either alpha, or alpha_u and alpha_v.

    Raises:
        ValueError: if the two ways are mixed, or a value is negative.
    """
    if (alpha_u is None) != (alpha_v is None):
        raise ValueError("alpha_u and alpha_v must be given both or not at all; for equal roughness give alpha")
    if alpha_u is not None and alpha is not None:
        raise ValueError("give either alpha, or alpha_u and alpha_v, and not all three")
    if alpha_u is not None:
        given = {"alpha_u": alpha_u, "alpha_v": alpha_v}
    else:
        given = {"alpha": 0.1 if alpha is None else alpha}
    return {name: as_texture(owner, name, value) for name, value in given.items()}


def roughness_numbers(owner: BSDF) -> tuple[NumberOf, ...]:
    """The roughness textures of `owner` as scalars, even if they are in colour."""
    names = ("alpha",) if owner.alpha is not None else ("alpha_u", "alpha_v")
    return tuple(NumberOf(owner, name) for name in names)


def smallest_alpha(bsdf: BSDF) -> float:
    """The least mean roughness of a material and of those nested in it, detached; infinite if none has any."""
    found = [math.inf]
    for plugin in bsdf.modules():
        for name in (*ROUGHNESS, "roughness"):
            value = getattr(plugin, name, None) if isinstance(plugin, BSDF) else None
            if isinstance(value, Texture) and not reader_of(value).outside:
                value = torch.cat([source.flatten() for source in value.sources()])
            if isinstance(value, Tensor):
                mean = float(value.detach().mean())
                found.append(mean * mean if name == "roughness" else mean)
    return min(found)
