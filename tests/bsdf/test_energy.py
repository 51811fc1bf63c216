"""Reciprocity and conservation of energy (white furnace)."""

import pytest
import torch

from tests.bsdf.lanes import (
    IDEAL,
    KINDS,
    SIMPLE,
    SMOOTH,
    direction,
    directions,
    material,
    random_numbers,
    sampled,
    values_of,
)
from tests.scenes.materials import MATERIALS
from torch_radbp.bsdf.principled_lobes import PrincipledKind
from torch_radbp.bsdf.principledthin import PrincipledThinKind
from torch_radbp.tensors.vec import Vec3, where

COUNT = 50_000
# Beckmann's shadowing in `eval` is Walter's rational function, right to 0.35 per cent each way.
RATIONAL = 0.007
# Of a coat's inside, the share that is reflected is known to 0.6 per cent, and a third of it or less remains.
COATS = 0.02


def white(description: dict) -> dict:
    """The same material without absorption."""
    absorbing = ("material", "eta", "k", "specular_reflectance", "specular_transmittance")
    description = {name: value for name, value in description.items() if name not in absorbing}
    bases = {"diffuse": "reflectance", "principled": "base_color", "principledthin": "base_color",
             "plastic": "diffuse_reflectance",
             "roughplastic": "diffuse_reflectance"}
    return description | ({bases[description["type"]]: 1.0} if description["type"] in bases else {})


# Of which all light leaves again, but for shadowing, if nothing is absorbed; `test_check` asks all for energy.
LOSSLESS = [name for name in SIMPLE if MATERIALS[name]["type"] in (
    "conductor", "dielectric", "diffuse", "null", "plastic", "roughconductor", "roughdielectric", "roughplastic",
    "thindielectric")]


def squared_index(kind, values, w: Vec3) -> torch.Tensor:
    """Squared index of refraction on the side of w, that outside being 1."""
    index = kind.index(values) if isinstance(kind, PrincipledKind) else values[-3].x
    return torch.where(w.z > 0, torch.ones_like(w.z), index**2)


# A film loses light that its microfacets see from their own side, and not the same in both directions.
RECIPROCAL = [name for name in SMOOTH if (name in SIMPLE and name not in ("film", "sheet with all"))
              or name in ("blend", "mask", "leaf")]


@pytest.mark.parametrize("name", RECIPROCAL)
def test_scattering_is_reciprocal(name):
    """f(wi, wo) / n_i^2 = f(wo, wi) / n_o^2 (Veach 1997, equation 5.14, for radiance)."""
    bsdf = material({**MATERIALS[name]})
    kind, a, b = bsdf.kind(), directions(COUNT, 1), directions(COUNT, 2)
    values = values_of(bsdf, a.z)
    forwards, backwards = kind.eval(values, a, b) / b.z.abs(), kind.eval(values, b, a) / a.z.abs()
    if kind.transmits and name in SIMPLE and not isinstance(kind, PrincipledThinKind):
        forwards, backwards = forwards * squared_index(kind, values, b), backwards * squared_index(kind, values, a)
        crossing = a.z * b.z < 0
        assert (forwards.stack()[crossing] > 0).any()
    assert (forwards.stack() > 0).any()
    torch.testing.assert_close(forwards.stack(), backwards.stack(), rtol=1e-9, atol=1e-12)


def energy(description: dict, z: float) -> torch.Tensor:
    """(N,) power that one sample stands for, per power that arrives; its mean is the albedo."""
    bsdf = material(description)
    kind, wi = bsdf.kind(), direction(z, 0.4, COUNT)
    values = values_of(bsdf, wi.z)
    choice, wo = sampled(kind, values, wi, random_numbers(COUNT))
    weight = kind.eval(values, wi, wo) / kind.pdf(values, wi, wo).clamp_min(1e-30)
    if kind.delta:
        weight = where(choice.is_delta(kind), kind.specular(values, wi, choice) / choice.probability, weight)
    assert torch.equal(weight.x, weight.y)
    if description["type"] in ("dielectric", "roughdielectric", "principled") and kind.transmits:  # radiance to power
        change = squared_index(kind, values, wo) / squared_index(kind, values, wi)
        weight = weight * torch.where(wi.z * wo.z < 0, change, 1.0)
    return weight.x.detach()


@pytest.mark.parametrize("z", [1.0, 0.7, 0.1, -0.5, -0.9])
@pytest.mark.parametrize("name", LOSSLESS)
def test_no_energy_is_made(name, z):
    description = white(MATERIALS[name])
    power = energy(description, z)
    if z < 0 and not KINDS[name].transmits:
        assert (power == 0).all()
        return
    if "plastic" in description["type"]:  # several lobes, which only together conserve energy
        assert power.mean() <= 1 + COATS and power.std() < 0.5
    elif not description.get("sample_visible", True):  # the weight of a sample may be anything
        assert power.mean() <= 1 + RATIONAL + 4.5 * power.std() / COUNT**0.5
    else:
        # Sampling visible normals, each sample's weight is the shadowing of wo: at most 1.
        assert (power <= 1 + RATIONAL).all()
    if description["type"] in ("diffuse", "conductor", "dielectric", "thindielectric", "null"):
        torch.testing.assert_close(power, torch.ones_like(power), rtol=1e-12, atol=0)
    assert power.mean() > 0.5


@pytest.mark.parametrize("z", [1.0, 0.7, 0.1, -0.5])
@pytest.mark.parametrize("roughness", [0.05, 0.5, 1.0])
@pytest.mark.parametrize("what", [{"metallic": 1.0}, {"spec_trans": 1.0, "eta": 1.5}, {"spec_trans": 1.0, "eta": 0.7}],
                         ids=str)
def test_a_principled_metal_and_glass_make_no_energy(what, roughness, z):
    power = energy({"type": "principled", "base_color": 1.0, "roughness": roughness, **what}, z)
    if z < 0 and "metallic" in what:
        assert (power == 0).all()
        return
    error = power.std().item() / COUNT**0.5
    assert 0.3 < power.mean() <= 1 + 4 * error
    if roughness == 0.05:
        assert power.mean() > 0.99 - 4 * error


@pytest.mark.parametrize("z", [1.0, 0.7, 0.1, -0.5])
@pytest.mark.parametrize("what", [{"spec_trans": 1.0, "roughness": 0.5}, {"diff_trans": 2.0},
                                  {"spec_trans": 0.5, "diff_trans": 2.0, "eta": 1.3}], ids=str)
def test_a_film_and_a_sheet_that_transmits_make_no_energy(what, z):
    power = energy({"type": "principledthin", "base_color": 1.0, **what}, z)
    error = power.std().item() / COUNT**0.5
    assert 0.4 < power.mean() <= 1 + 4 * error
    if what == {"diff_trans": 2.0}:
        assert power.mean() > 1 - 4 * error


@pytest.mark.parametrize("z", [1.0, 0.7, 0.3])
def test_a_principled_base_makes_as_much_energy_as_its_model_says(z):
    """A white base under a boundary is not balanced: Burley 2012, section 5.3, has it reflect a little more than all."""
    power = energy({"type": "principled", "base_color": 1.0, "roughness": 0.5}, z)
    assert 1.0 < power.mean() < 1.13


@pytest.mark.parametrize("distribution", ["beckmann", "ggx"])
@pytest.mark.parametrize("kind_type", ["roughconductor", "roughdielectric"])
@pytest.mark.parametrize("z", [1.0, 0.6, -0.8])
def test_a_nearly_smooth_surface_keeps_all_energy(kind_type, distribution, z):
    if z < 0 and kind_type == "roughconductor":
        pytest.skip("black from behind")
    power = energy({"type": kind_type, "distribution": distribution, "alpha": 1e-3}, z)
    assert abs(power.mean() - 1) < 1e-4


@pytest.mark.parametrize("distribution", ["beckmann", "ggx"])
def test_roughness_loses_energy_between_microfacets(distribution):
    """Single scattering: a rough white metal is grey, the more the rougher (Heitz et al. 2016, figure 1)."""
    loss = [1 - energy({"type": "roughconductor", "distribution": distribution, "alpha": a}, 0.3).mean()
            for a in (0.1, 0.5, 1.0)]
    assert 0 <= loss[0] + RATIONAL and loss[0] < loss[1] < loss[2]
    assert 0.1 < loss[2] < 0.6


@pytest.mark.parametrize("name", IDEAL)
def test_what_a_smooth_surface_does_is_not_found_otherwise(name):
    bsdf = material(MATERIALS[name])
    kind, wi = bsdf.kind(), directions(100)
    values = values_of(bsdf, wi.z)
    choice, wo = sampled(kind, values, wi, random_numbers(100))
    assert (kind.eval(values, wi, wo).stack() == 0).all() and (kind.pdf(values, wi, wo) == 0).all()


def test_kinds_that_scatter_into_all_directions_have_no_specular_weight():
    bsdf = material(MATERIALS["diffuse"])
    wi = directions(3)
    choice, _ = sampled(bsdf.kind(), values_of(bsdf, wi.z), wi, random_numbers(3))
    with pytest.raises(TypeError, match="DiffuseKind .* use eval"):
        bsdf.kind().specular(values_of(bsdf, wi.z), wi, choice)


def test_a_smooth_dielectric_refracts_by_snell():
    bsdf = material({"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0})
    kind, wi, random = bsdf.kind(), directions(1000), random_numbers(1000)
    values = values_of(bsdf, wi.z)
    choice, wo = sampled(kind, values, wi, random)
    crossed = choice.lobe > 0
    assert 0 < crossed.double().mean() < 1
    ratio = torch.hypot(wo.x, wo.y) / torch.hypot(wi.x, wi.y)
    expected = torch.where(crossed, 1.5 ** -torch.sign(wi.z), 1.0)
    torch.testing.assert_close(ratio, expected, rtol=1e-12, atol=0)
    assert (wo.z * wi.z < 0).equal(crossed)
    assert ((wo.x * wi.x) <= 0).all()
    torch.testing.assert_close(wo.x**2 + wo.y**2 + wo.z**2, torch.ones_like(wo.z), rtol=1e-12, atol=0)
    total = (wi.z < 0) & (torch.hypot(wi.x, wi.y) > 1 / 1.5)
    assert total.any() and not crossed[total].any() and (choice.probability[total] == 1).all()
