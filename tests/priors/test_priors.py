"""Priors: closed forms, and derivatives."""

import kornia
import pytest
import torch

import torch_radbp as rb


def test_total_variation_of_a_step_is_its_height_along_its_length():
    values = torch.zeros(4, 6, 3, dtype=torch.float64)
    values[:, 3:] = torch.tensor([0.3, 0.0, 0.4], dtype=torch.float64)
    assert float(rb.priors.total_variation(values, epsilon=1e-9)) == pytest.approx(0.5 * 4 / 24, rel=1e-6)
    assert float(rb.priors.total_variation(values, epsilon=1e-9, wrap_columns=True)) == pytest.approx(1.0 * 4 / 24, rel=1e-6)
    assert float(rb.priors.total_variation(values, epsilon=1e-9, wrap_rows=True)) == pytest.approx(0.5 * 4 / 24, rel=1e-6)
    assert rb.priors.total_variation(torch.full_like(values, 0.7)) == 0


def test_total_variation_is_that_of_kornia_for_one_channel_in_one_direction():
    rows = torch.rand(1, 9, 1, dtype=torch.float64)
    reference = kornia.losses.total_variation(rows.movedim(-1, 0)).sum()
    assert reference > 0.1
    torch.testing.assert_close(9 * rb.priors.total_variation(rows, epsilon=1e-12), reference, rtol=1e-8, atol=0)


def test_smoothness_of_a_ramp_is_its_squared_slope():
    ramp = torch.arange(6, dtype=torch.float64)[None, :, None].expand(4, 6, 2) * 0.5
    assert float(rb.priors.smoothness(ramp)) == pytest.approx(2 * 0.25 * 5 / 6)
    assert float(rb.priors.smoothness(ramp, wrap_columns=True)) == pytest.approx(2 * (0.25 * 5 + 2.5**2) / 6)
    assert rb.priors.smoothness(torch.ones(3, 3, 1)) == 0


def test_bending_of_a_ramp_is_zero_and_of_a_paraboloid_its_hessian():
    z, y, x = torch.meshgrid(*[torch.arange(size, dtype=torch.float64) for size in (4, 5, 6)], indexing="ij")
    ramp = (0.3 * x - 0.2 * y + 0.7 * z)[..., None]
    assert float(rb.priors.bending(ramp)) == pytest.approx(0, abs=1e-12)
    # The Hessian has 2 * 0.5 and 2 * 0.25 on its diagonal, and 0.125 beside it.
    bowl = (0.5 * x**2 + 0.25 * z**2 + 0.125 * x * y)[..., None]
    expected = (1.0 + 0.25 + 2 * 0.125**2)**0.5
    assert float(rb.priors.bending(bowl, epsilon=1e-9)) == pytest.approx(expected, rel=1e-8)
    assert float(rb.priors.bending(bowl[0].expand(5, 6, 2), epsilon=1e-9)) == pytest.approx(
        (2 * (1.0 + 2 * 0.125**2))**0.5, rel=1e-8)


def test_bending_of_a_kink_is_its_change_of_slope_along_its_length():
    row = (torch.arange(9, dtype=torch.float64) - 4).abs()
    kink = row[None, :, None].expand(5, 9, 1)
    assert float(rb.priors.bending(kink, epsilon=1e-9)) == pytest.approx(2 / 7, rel=1e-6)


def test_white_balance_is_the_variance_of_the_logarithm_of_the_mean_colour():
    logarithms = torch.tensor([0.1, -0.2, 0.1], dtype=torch.float64)
    assert float(rb.priors.white_balance(3 * logarithms.exp())) == pytest.approx(0.02)
    pair = torch.tensor([[0.5, 1.0, 1.5], [1.5, 1.0, 0.5]])
    assert float(rb.priors.white_balance(pair)) == pytest.approx(0, abs=1e-12)
    assert rb.priors.white_balance(rb.Exposure(4).gains) == 0


@pytest.mark.parametrize("prior", [rb.priors.total_variation, rb.priors.bending, rb.priors.smoothness,
                                   rb.priors.white_balance,
                                   lambda values: rb.priors.total_variation(values, wrap_rows=True, wrap_columns=True)])
def test_derivatives_are_those_of_differences(prior):
    values = torch.rand(4, 5, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0)).requires_grad_()
    assert torch.autograd.grad(prior(values), values)[0].abs().max() > 1e-3
    assert torch.autograd.gradcheck(prior, (values,))


def test_the_derivative_of_flat_maps_is_finite():
    flat = torch.ones(3, 3, 3, requires_grad=True)
    (rb.priors.total_variation(flat) + rb.priors.bending(flat) + rb.priors.smoothness(flat)).backward()
    assert (flat.grad == 0).all()


def test_bad_arguments_are_named():
    for prior in (rb.priors.total_variation, rb.priors.smoothness):
        with pytest.raises(ValueError, match=r"floats of shape \(H, W, C\), got torch.float32 of \(1, 3, 4, 4\)"):
            prior(torch.rand(1, 3, 4, 4))
    with pytest.raises(ValueError, match=r"at least 3 along each axis but the last, got torch.float32 of \(2, 4, 4, 1\)"):
        rb.priors.bending(torch.rand(2, 4, 4, 1))
    with pytest.raises(ValueError, match=r"got torch.int64 of \(4, 4, 1\)"):
        rb.priors.bending(torch.ones(4, 4, 1, dtype=torch.int64))
    with pytest.raises(ValueError, match="epsilon must be greater than 0"):
        rb.priors.total_variation(torch.rand(3, 3, 1), epsilon=0)
    with pytest.raises(ValueError, match=r"colours must have shape \(..., 3\), got \(4,\)"):
        rb.priors.white_balance(torch.ones(4))
    with pytest.raises(ValueError, match="the mean of colours must be above 0 in every channel"):
        rb.priors.white_balance(torch.tensor([1.0, 0.0, 1.0]))
