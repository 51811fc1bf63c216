"""Materials that hold others: sums of what they hold, whatever the weight."""

import itertools

import pytest
import torch

from tests.bsdf.lanes import MATERIALS, Numbers, direction, material, numbers, sampled, values_of
from tests.bsdf.test_both_orders import light
from tests.bsdf.test_finite import assert_finite
from torch_radbp.vec import Vec3

COUNT = 80_000
DIFFUSE = {"type": "diffuse", "reflectance": [0.2, 0.8, 0.3]}
HOLDERS = {
    "blend of diffuse and mirror": {"type": "blendbsdf", "bsdf": [DIFFUSE, MATERIALS["conductor"]]},
    "blend of glass and plastic": {"type": "blendbsdf", "bsdf": [MATERIALS["glass ggx"], MATERIALS["plastic"]]},
    "blend of plastics": {"type": "blendbsdf", "bsdf": [MATERIALS["plastic"], MATERIALS["rough plastic beckmann"]]},
}


def holder(name: str, weight: float):
    return material(HOLDERS[name] | {"weight": weight})


def reflected(kind, values, wi: Vec3, random: Numbers) -> torch.Tensor:
    """(N,) estimates of the light that a material scatters towards wi, by its own samples, attached to the values."""
    fixed = tuple(value.detach() for value in values)
    choice, wo = sampled(kind, fixed, wi, random)
    value, pdf = kind.eval_pdf(values, wi, wo)
    pdf = pdf.detach()
    estimate = value.y / torch.where(pdf > 0, pdf, 1.0) * (pdf > 0)
    if kind.delta:
        estimate = torch.where(choice.is_delta(kind), kind.specular(values, wi, choice).y / choice.probability, estimate)
    return estimate * light(wo)


@pytest.mark.parametrize("z", [0.8, 0.5])
@pytest.mark.parametrize("weight", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("name", HOLDERS)
def test_the_derivative_by_the_weight_is_the_difference_of_the_parts(name, weight, z):
    """What is scattered is linear in the weight, so that the difference of its ends is the derivative everywhere."""
    wi, random = direction(z, 0.4, COUNT), numbers(COUNT)
    ends = []
    for end in (0.0, 1.0):
        bsdf = holder(name, end)
        ends.append(reflected(bsdf.kind(), values_of(bsdf, wi.z), wi, random).detach())
    bsdf = holder(name, weight)
    values = list(values_of(bsdf, wi.z))
    moved = values[0].x.detach().requires_grad_()
    values[0] = values[0]._replace(x=moved)
    estimate = reflected(bsdf.kind(), tuple(values), wi, random)
    slope, = torch.autograd.grad(estimate.sum(), moved)
    expected = ends[1].mean() - ends[0].mean()
    error = sum(part.var() / COUNT for part in (*ends, slope)).sqrt()
    assert abs(slope.mean() - expected) < 4.5 * error and abs(expected) > 6 * error
    mixed = (1 - weight) * ends[0].mean() + weight * ends[1].mean()
    assert abs(estimate.mean() - mixed) < 4.5 * sum(part.var() / COUNT for part in (*ends, estimate.detach())).sqrt()


COSINES = (1.0, 0.6, 1e-3, 1e-7, 0.0, -1e-7, -0.5, -1.0)
EXTREMES = {
    **{f"{name}, {weight}": lambda name=name, weight=weight: holder(name, weight)
       for name in HOLDERS for weight in (0.0, 0.5, 1.0)},
}


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
@pytest.mark.parametrize("name", EXTREMES)
def test_values_and_derivatives_stay_finite(name, dtype):
    bsdf = EXTREMES[name]().to(dtype)
    kind = bsdf.kind()
    z = torch.tensor(COSINES, dtype=dtype).repeat_interleave(len(COSINES))
    r = torch.sqrt(1 - z * z)
    wi = Vec3(0.6 * r, 0.8 * r, z).map(lambda c: c.clone().requires_grad_())
    values = tuple(value.map(lambda c: c.detach().clone().requires_grad_()) for value in values_of(bsdf, z))
    other = torch.tensor(COSINES, dtype=dtype).repeat(len(COSINES))
    wo = Vec3(-torch.sqrt(1 - other * other), torch.zeros_like(other), other).map(lambda c: c.clone().requires_grad_())
    for result in kind.eval_pdf(values, wi, wo):
        assert_finite("evaluation", result, values, wi, wo)
    for number in itertools.product((0.0, 0.019, 0.5, 1 - 2.0**-24), (0.0, 0.7), (0.3,)):
        random = Numbers(*(torch.full_like(z, x) for x in number))
        choice = kind.choose(values, wi, *random)
        assert (choice.probability > 0).all() and (choice.probability <= 1).all()
        wo = kind.sample(values, wi, choice, random.u, random.v)
        assert ((wo.x**2 + wo.y**2 + wo.z**2) - 1).abs().max() < 300 * torch.finfo(dtype).eps
        assert_finite("sample", wo, values, wi)
        for result in kind.eval_pdf(values, wi, wo):
            assert_finite("evaluation at the sample", result, values, wi)
        if kind.delta:
            assert_finite("specular", kind.specular(values, wi, choice), values, wi)
