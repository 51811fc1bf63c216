"""Sampled directions against their density (chi-square, Subr and Arvo 2007), and the two stages of sampling."""

import math

import numpy as np
import pytest
import torch

from tests.bsdf.lanes import (
    GLASS,
    KINDS,
    MIXED,
    ROUGH,
    SMOOTH,
    choices,
    direction,
    directions,
    material,
    random_numbers,
    sampled,
    values_of,
)
from tests.deep import deep_but_every
from tests.scenes.materials import MATERIALS
from torch_radbp.check.chi_square import SIGNIFICANCE, p_value
from torch_radbp.check.lanes import unit_length_error
from torch_radbp.check.scattering import VIEWERS, Subject, fit, viewed
from torch_radbp.tensors.vec import Vec3

COUNT = 100_000
FEW = 20_000  # where nothing is a mean


def subject_of(bsdf) -> Subject:
    return Subject(bsdf.kind(), lambda like: values_of(bsdf, like))


@pytest.mark.parametrize("name, angle", deep_but_every(4, [
    (name, angle) for name in SMOOTH for angle in VIEWERS if VIEWERS[angle] > 0 or KINDS[name].transmits]))
def test_directions_follow_their_density(name, angle):
    view = viewed(subject_of(material(MATERIALS[name])), angle, COUNT, 7)
    assert unit_length_error(view.wo) < 1e-9
    total = view.density.value.sum().item()
    if not view.keep.any():
        assert total == 0  # a mask that is black from behind, but for its holes
        return
    # The density adds up to what is not lost between microfacets, nor to delta lobes.
    lost = 1 - view.keep.double().mean().item()
    assert abs(total - (1 - lost)) < 5 * math.sqrt(lost * (1 - lost) / COUNT) + 2e-3
    assert fit(view) > SIGNIFICANCE


@pytest.mark.parametrize("name", ["metal beckmann", "glass ggx", "glass beckmann"])
def test_single_precision_follows_the_same_density(name):
    bsdf = material(MATERIALS[name])
    kind, wi = bsdf.kind(), direction(0.5, 0.7, COUNT, torch.float32)
    values = values_of(bsdf.float(), wi.z)
    _, wo = sampled(kind, values, wi, random_numbers(COUNT, dtype=torch.float32))
    assert wo.x.dtype == torch.float32
    keep = kind.pdf(values, wi, wo).detach() > 0
    wo = wo.map(lambda component: component.detach().double())
    view = viewed(subject_of(bsdf.double()), "oblique", COUNT, 8)._replace(keep=keep, wo=wo)
    assert fit(view) > SIGNIFICANCE


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
@pytest.mark.parametrize("alpha", [1e-3, 1e-2, 0.1])
@pytest.mark.parametrize("distribution", ["beckmann", "ggx"])
@pytest.mark.parametrize("kind_type", ["roughconductor", "roughdielectric"])
def test_sharp_lobes_follow_their_density(kind_type, distribution, alpha, dtype):
    """In a window around the mirror direction and one around the refracted direction, in units of the lobe's width."""
    bsdf = material({"type": kind_type, "distribution": distribution, "alpha": alpha}).to(dtype)
    kind, wi = bsdf.kind(), direction(0.8, 0.3, COUNT, dtype)
    values = values_of(bsdf, wi.z)
    _, wo = sampled(kind, values, wi, random_numbers(COUNT, dtype=dtype))
    wo = wo.map(lambda c: c.detach().double())
    eta = values[-3].x[0].item()
    windows = [(1, -1.0, 6 * alpha)]  # side, wo.xy over wi.xy, half width
    if kind_type == "roughdielectric":
        windows.append((-1, -1.0 / eta, 3 * alpha))
    cells, fine = 12, 16
    for side, ratio, half in windows:
        middle = ratio * wi.x[0].item(), ratio * wi.y[0].item()
        inside = (np.arange(cells * fine) + 0.5) / (cells * fine) * 2 * half - half
        x, y = (torch.from_numpy(a).reshape(-1) for a in np.meshgrid(inside + middle[0], inside + middle[1], indexing="ij"))
        fits = x * x + y * y < 1
        z = side * torch.sqrt((1 - x * x - y * y).clamp_min(1e-12))
        wide = Vec3(*(c[:1].double().expand(len(x)) for c in wi))
        density = kind.pdf(values_of(bsdf.double(), x), wide, Vec3(x, y, z)).detach() / z.abs() * fits
        expected = COUNT * (2 * half / (cells * fine))**2 * density.reshape(cells, fine, cells, fine).sum((1, 3)).numpy()
        keep = wo.z * side > 0
        limits = [(middle[0] - half, middle[0] + half), (middle[1] - half, middle[1] + half)]
        observed = np.histogram2d(wo.x[keep].numpy(), wo.y[keep].numpy(), cells, limits)[0]
        assert observed.sum() > 0.02 * COUNT
        assert p_value(observed, expected, constraints=0) > SIGNIFICANCE


def test_the_test_notices_a_wrong_roughness():
    view, wrong = (viewed(subject_of(material({"type": "roughconductor", "alpha": alpha})), "steep", COUNT, 7)
                   for alpha in (0.3, 0.31))
    assert fit(wrong._replace(wo=view.wo, keep=view.keep)) < SIGNIFICANCE < min(fit(view), fit(wrong))


@pytest.mark.parametrize("name", MATERIALS)
def test_a_choice_is_made_with_its_probability(name):
    bsdf = material(MATERIALS[name]).requires_grad_()
    kind, wi, random = bsdf.kind(), directions(FEW), random_numbers(FEW)
    choice, _ = sampled(kind, values_of(bsdf, wi.z), wi, random)
    assert not choice.probability.requires_grad and not choice.lobe.requires_grad
    assert (choice.probability > 0).all() and (choice.probability <= 1).all()
    if choice.parts:
        return  # of kinds that hold others see below
    if kind.discrete:
        found = choices(kind, values_of(bsdf, wi.z), wi, random)
        assert len(found) > 1
        last = torch.zeros_like(wi.z)
        for each in found:
            picked = (last <= random.choice) & (random.choice < last + each.probability)
            assert torch.equal(choice.lobe[picked], each.lobe[picked])
            assert torch.equal(choice.probability[picked], each.probability[picked])
            assert 0.001 < picked.double().mean() < 0.99
            last = last + each.probability
        torch.testing.assert_close(last, torch.ones_like(last), rtol=0, atol=1e-9)
    else:
        assert (choice.probability == 1).all() and (choice.lobe == 0).all()


@pytest.mark.parametrize("weight", [0.0, 0.3, 1.0])
def test_a_blend_chooses_by_its_weight_but_neither_part_never(weight):
    bsdf = material({**MATERIALS["nested blend"], "weight": weight}).requires_grad_()  # see test_cut_outs.py for others
    kind, wi = bsdf.kind(), directions(COUNT)
    choice, _ = sampled(kind, values_of(bsdf, wi.z), wi, random_numbers(COUNT))
    expected = min(max(weight, 0.02), 0.98)
    assert abs(choice.lobe.mean() - expected) < 5 * 0.5 / math.sqrt(COUNT)
    glass, inner = choice.parts
    second = torch.where(inner.lobe > 0, 0.4 * inner.parts[1].probability, 0.6 * inner.parts[0].probability)
    torch.testing.assert_close(choice.probability, torch.where(choice.lobe > 0, expected * second,
                                                               (1 - expected) * glass.probability), rtol=1e-6, atol=0)
    # The number that has chosen a part is as good as new for the part.
    chosen = inner.lobe[choice.lobe > 0]
    assert abs(chosen.mean() - 0.4) < 5 * 0.5 / math.sqrt(len(chosen))


@pytest.mark.parametrize("name", MIXED)
def test_delta_lobes_take_what_the_density_of_the_smooth_ones_leaves(name):
    bsdf, kind = material(MATERIALS[name]), KINDS[name]
    for where in ("steep", "oblique"):
        wi = direction(VIEWERS[where], 0.7, COUNT)
        values = values_of(bsdf, wi.z)
        choice, _ = sampled(kind, values, wi, random_numbers(COUNT))
        assert choice.delta.dtype == torch.bool and 0.01 < choice.delta.double().mean() < 0.99
        assert (kind.specular(values, wi, choice).stack()[choice.delta] > 0).all()
        view = viewed(subject_of(bsdf), where, COUNT, 7)
        assert abs(view.density.value.sum() - view.keep.double().mean()) < 5 * 0.5 / math.sqrt(COUNT)


@pytest.mark.parametrize("name", ROUGH)
def test_the_density_with_fixed_lobes_has_another_derivative_only_where_lobes_are_chosen(name):
    bsdf = material(MATERIALS[name]).requires_grad_()
    kind, wi = bsdf.kind(), Vec3(*(component.requires_grad_() for component in directions(FEW)))
    values = values_of(bsdf, wi.z)
    wo = sampled(kind, values, wi, random_numbers(FEW)).wo.detach()
    pdf, fixed = (kind.eval_pdf(values, wi, wo, fixed_lobes)[1] for fixed_lobes in (False, True))
    assert (pdf > 0).double().mean() > 0.3 and torch.equal(pdf, fixed)
    moved = [wi.z, *bsdf.parameters()]
    slopes = [torch.autograd.grad(density.sum() + sum(0 * parameter.sum() for parameter in moved), moved, retain_graph=True)
              for density in (pdf, fixed)]
    assert all(map(torch.equal, *slopes)) != kind.discrete


@pytest.mark.parametrize("name", GLASS)
def test_a_choice_is_kept_by_its_sample(name):
    """Reflected directions stay on the viewer's side, refracted ones cross, and what can do neither is black."""
    bsdf = material(MATERIALS[name])
    kind, wi = bsdf.kind(), directions(COUNT)
    values = values_of(bsdf, wi.z)
    choice, wo = sampled(kind, values, wi, random_numbers(COUNT))
    crossed = wo.z * wi.z < 0
    level = wo.z == 0
    assert (crossed == (choice.lobe > 0))[~level].all()
    assert 0 < level.double().mean() < 0.2
    assert (kind.pdf(values, wi, wo)[level] == 0).all() and (kind.eval(values, wi, wo).stack()[level] == 0).all()


@pytest.mark.parametrize("name", ROUGH)
def test_eval_is_zero_exactly_where_the_density_is(name):
    bsdf = material(MATERIALS[name])
    wi, wo = directions(COUNT, 1), directions(COUNT, 2)
    values = values_of(bsdf, wi.z)
    eval_, pdf = bsdf.kind().eval(values, wi, wo).stack().amax(1), bsdf.kind().pdf(values, wi, wo)
    assert ((eval_ > 0) == (pdf > 0)).double().mean() > 0.9999  # but for underflow
    assert (eval_ > 0).any() and (eval_ >= 0).all()
