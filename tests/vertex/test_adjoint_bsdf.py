"""Scattering of power that comes from lamps is the adjoint of scattering of radiance, material by material.

For smooth G and H the integral of G(wi) |cos wi| f(wi, wo) H(wo) |cos wo| over both directions is estimated from either
side: by directions towards the camera, with samples of the BSDF, and by directions towards the lamp, with samples of its
adjoint.

Reference: Veach 1997, "Robust Monte Carlo Methods for Light Transport Simulation", sections 3.7 and 5.2.
"""

import math
from typing import Any

import pytest
import torch
from torch import Tensor

from tests.bsdf.lanes import light, material, values_of
from tests.deep import deep_but_every
from tests.scenes.materials import MATERIALS
from torch_radbp.tensors.vec import Vec3, dot
from torch_radbp.vertex.material import Material, sample

LANES = 1 << 17
BRUSHED = {"type": "roughconductor", "alpha": 0.3}
TILTED, STEEP = [0.7, 0.55, 0.85], [0.9, 0.4, 0.75]  # normals, as colours


def with_normal(colour: list[float], bsdf: dict[str, Any], **attributes: Any) -> dict[str, Any]:
    return {"type": "normalmap", "normalmap": colour, "nested_bsdf": bsdf} | attributes


TURNED = {
    "diffuse": with_normal(STEEP, MATERIALS["diffuse"]),
    "brushed": with_normal(STEEP, BRUSHED),
    "brushed, black from behind": with_normal(STEEP, BRUSHED, flip_invalid_normals=False),
    "mirror": with_normal(TILTED, {"type": "conductor"}),
    "steep mirror": with_normal(STEEP, {"type": "conductor"}),
    "glass": with_normal(TILTED, {"type": "dielectric"}),
    "steep glass": with_normal(STEEP, {"type": "dielectric"}, use_shadowing_function=False),
    "plastic": with_normal(STEEP, {"type": "plastic"}),
    "two sides": {"type": "twosided", "brdf": [with_normal(STEEP, BRUSHED)]},
}


def seen(w: Vec3) -> Tensor:
    """What there is of directions towards the camera: smooth, and without symmetry."""
    return torch.exp(0.4 * w.y + 0.5 * w.x - 0.3 * w.z)


def estimates(description: dict[str, Any], bent: bool) -> tuple[Tensor, Tensor]:
    """Samples of the integral, (N, 3), by directions towards the camera and towards the lamp."""
    random = torch.Generator().manual_seed(5)
    numbers = torch.rand(2, 5, LANES, generator=random, dtype=torch.float64)
    bsdf = material(description)
    values = values_of(bsdf, numbers[0, 0])
    # The geometric normal may be another than the shading normal, around which directions are given.
    zero = torch.zeros_like(numbers[0, 0])
    normal = Vec3(zero + 0.3 * bent, zero - 0.1 * bent, zero + math.sqrt(1 - 0.1 * bent))
    found = []
    for (u, v, *own), adjoint in zip(numbers, (False, True)):
        z, phi = 2 * u - 1, 2 * math.pi * v
        level = (1 - z * z).sqrt()
        begin = Vec3(level * phi.cos(), level * phi.sin(), z)
        kind = bsdf.kind()
        scatters = Material(kind.adjoint(), values, normal) if adjoint else Material(kind, values)
        scattered = sample(scatters, begin, *own, "detached")
        wi, wo = (scattered.wo, begin) if adjoint else (begin, scattered.wo)
        there = scattered.pdf > 0
        found.append(torch.stack([torch.where(there, part, 0.0) for part in scattered.weight], 1)
                     * (seen(wi) * light(wo) * dot(normal, begin).abs())[:, None])
    return tuple(found)


def assert_adjoint(description: dict[str, Any], bent: bool) -> None:
    camera, lamp = estimates(description, bent)
    error = ((camera.var(0) + lamp.var(0)) / LANES).sqrt() + 1e-12
    assert camera.mean() > 1e-3
    assert (error / camera.mean(0)).max() < 0.015  # enough to tell a wrong one
    assert ((camera.mean(0) - lamp.mean(0)) / error).abs().max() < 4.5


@pytest.mark.parametrize("name", deep_but_every(4, MATERIALS))
def test_the_adjoint_of_each_material_is_sampled(name):
    assert_adjoint(MATERIALS[name], False)


@pytest.mark.parametrize("name", TURNED)
def test_the_adjoint_of_turned_normals_is_sampled(name):
    assert_adjoint(TURNED[name], False)


@pytest.mark.parametrize("name", ["diffuse", "conductor", "dielectric", "metal ggx", "glass beckmann"])
def test_shading_normals_other_than_the_geometric_ones_count(name):
    assert_adjoint(MATERIALS[name], True)
