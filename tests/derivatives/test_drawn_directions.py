"""Random numbers for which materials draw given directions: they lead there, and to all that a material draws."""

from __future__ import annotations

import math

import pytest
import torch

from tests.scenes import load
from torch_radbp.boundary.eye.drawn_directions import drawn_direction, inverted_sampling
from torch_radbp.tensors.vec import Vec3, dot, normalize
from torch_radbp.vertex.material import Material, sample

COUNT, CHOICES = 1024, 6
METAL = {"type": "roughconductor", "alpha": 0.3}
# How many shares, in the mean, may be missing: numbers from which Newton's method does not get there.
KINDS = {"diffuse": ({"type": "diffuse"}, 0.0), "metal": (METAL, 0.0),
         "nearly a mirror": (METAL | {"alpha": 0.02}, 0.0),
         "plastic": ({"type": "roughplastic"}, 0.01),
         "glass": ({"type": "roughdielectric", "alpha": 0.1}, 0.04),
         "blend": ({"type": "blendbsdf", "weight": 0.4, "one": {"type": "diffuse"}, "two": METAL}, 0.01)}


def material_of(bsdf: dict) -> Material:
    """The material at `COUNT` points."""
    plugin = load(sensor={"type": "perspective"}, sky={"type": "constant"}, plate={"type": "rectangle", "bsdf": bsdf}
                  ).shapes[0].bsdf
    values = [Vec3(*(part.detach().expand(COUNT) for part in texture.texels()[0, 0])) for texture in plugin.textures()]
    return Material(plugin.kind(), tuple(values))


@pytest.mark.parametrize("name", KINDS)
def test_numbers_lead_to_the_directions_and_their_shares_add_up_to_one(name):
    """The density of a lobe over that of all is 1 in the mean over lobes, which are picked as the material picks them."""
    (bsdf, missing), random = KINDS[name], torch.Generator().manual_seed(3)
    material = material_of(bsdf)
    wi = normalize(Vec3(*(0.6 * torch.randn(2, COUNT, generator=random)), torch.ones(COUNT)))
    drawn = sample(material, wi, *torch.rand(3, COUNT, generator=random), "detached")
    counts = torch.isfinite(drawn.pdf) & (drawn.pdf > 0)
    assert int(counts.sum()) > COUNT // 2
    shares = []
    for choice in torch.rand(CHOICES, COUNT, generator=random):
        numbers, density = inverted_sampling(material, wi, drawn.wo, choice)
        found = counts & (density > 0)
        again, delta = drawn_direction(material, wi, *numbers)
        assert not delta[found].any() and float(dot(again, drawn.wo)[found].min()) > 1 - 1e-6
        shares.append((density / torch.where(counts, drawn.pdf, 1.0))[counts])
    share = torch.stack(shares).mean(0)
    error = float(share.std()) / math.sqrt(len(share))
    assert -missing - 4 * error - 1e-4 <= float(share.mean()) - 1 <= 4 * error + 1e-4
