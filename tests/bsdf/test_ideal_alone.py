"""Where delta lobes alone are sampled, their numbers are told, and a sample weighs what the lobe reflects."""

import pytest
import torch

from tests.bsdf.lanes import directions, material, random_numbers, values_of
from tests.scenes.materials import MATERIALS
from torch_radbp.vertex.material import Material, sample

SIDES = [MATERIALS["plastic"], MATERIALS["nonlinear plastic"]]
COATED = {"plastic": MATERIALS["plastic"], "both sides": {"type": "twosided", "brdf": SIDES}}


@pytest.mark.parametrize("name", COATED)
def test_numbers_below_the_chance_of_delta_lobes_choose_these_and_no_others(name):
    bsdf = material(COATED[name])
    kind, wi, numbers = bsdf.kind(), directions(2000, 1), random_numbers(2000, 2)
    values = values_of(bsdf, wi.z)
    chance = kind.chance_of_delta(values, wi)
    picked = kind.choose(values, wi, numbers.choice, numbers.u, numbers.v)
    assert 0.2 < float(picked.is_delta(kind).float().mean()) < 0.8
    assert torch.equal(picked.is_delta(kind), numbers.choice < chance)
    assert torch.allclose(picked.probability[numbers.choice < chance], chance[numbers.choice < chance])


@pytest.mark.parametrize("name", COATED)
def test_samples_of_the_coat_alone_weigh_what_it_reflects(name):
    bsdf = material(COATED[name])
    kind, wi, numbers = bsdf.kind(), directions(500, 3), random_numbers(500, 4)
    values = values_of(bsdf, wi.z)
    found = sample(Material(kind, values), wi, numbers.choice, numbers.u, numbers.v, "hybrid", ideal=True)
    both = [sample(Material(kind, values), wi, torch.full_like(wi.z, number), numbers.u, numbers.v, "hybrid")
            for number in (0.0, 0.999)]
    assert bool(torch.isinf(found.pdf).all())
    coat = kind.specular(values, wi, kind.choose(values, wi, torch.zeros_like(wi.z), numbers.u, numbers.v))
    assert torch.allclose(torch.stack(tuple(found.weight)), torch.stack(tuple(coat)), rtol=1e-5)
    assert torch.equal(torch.stack(tuple(found.wo)), torch.stack(tuple(both[0].wo))) and not torch.isinf(both[1].pdf).any()


def test_kinds_that_cannot_tell_are_sampled_as_ever():
    for name in ("glass ggx", "conductor", "rough plastic beckmann"):
        bsdf, wi = material(MATERIALS[name]), directions(4)
        assert bsdf.kind().chance_of_delta(values_of(bsdf, wi.z), wi) is None
