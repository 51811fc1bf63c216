"""Losses: unbiased where they say so, and finite where a renderer puts zeros."""

import pytest
import torch

from torch_radbp.training.recipe_loss import L1, L2, SSIM, MultiScaleSSIM, TwoBufferL2
from torch_radbp.training.recovery.losses import TONE_MAPPINGS, Objective

THETA, TARGET, SAMPLES = 0.7, 0.4, 200_000


def one_sample_renderings(theta: torch.Tensor, seed: int) -> torch.Tensor:
    """Images theta * X with X exponential: E[X] = 1, E[X^2] = 2. Shape (SAMPLES, 3, 1, 1): independent pixels."""
    generator = torch.Generator().manual_seed(seed)
    noise = torch.empty(SAMPLES, 3, 1, 1, dtype=torch.float64).exponential_(generator=generator)
    return theta * noise


def mean_gradient(objective: Objective, images) -> tuple[float, float]:
    """Mean of the derivative by theta over independent pixels, and its standard error."""
    theta = torch.full((SAMPLES, 3, 1, 1), THETA, dtype=torch.float64, requires_grad=True)
    target = torch.full((SAMPLES, 3, 1, 1), TARGET, dtype=torch.float64)
    buffers = [one_sample_renderings(theta, seed) for seed in images]
    objective(buffers, target)[0].backward()
    per_pixel = theta.grad * theta.numel()  # the loss is a mean over pixels
    return per_pixel.mean().item(), per_pixel.std().item() / theta.numel() ** 0.5


def test_two_buffer_gradient_is_unbiased_at_one_sample():
    # d/dtheta (theta - T)^2 = 2 (theta - T), Azinovic et al. 2019.
    mean, error = mean_gradient(Objective([TwoBufferL2(name="two_buffer_l2")]), images=(1, 2))
    assert error < 0.02
    assert abs(mean - 2 * (THETA - TARGET)) < 4 * error


def test_gradients_of_other_losses_are_unbiased_too():
    mean, error = mean_gradient(Objective([L2(name="l2")]), images=(1, 2))
    assert error < 0.02
    assert abs(mean - 2 * (THETA - TARGET)) < 4 * error


def test_l2_of_one_image_is_biased_by_the_variance():
    # E[2 (theta X - T) X] = 2 (2 theta - T): it pulls theta to T / 2.
    mean, error = mean_gradient(Objective([L2(name="l2")]), images=(1, 1))
    assert abs(mean - 2 * (2 * THETA - TARGET)) < 4 * error
    assert abs(mean - 2 * (THETA - TARGET)) > 40 * error


def test_losses_of_one_image_are_means_over_the_buffers():
    target = torch.zeros(1, 3, 4, 4)
    buffers = torch.full_like(target, 1.0), torch.full_like(target, 3.0)
    losses = [TwoBufferL2(name="two_buffer_l2", weight=2.0), L1(name="l1", weight=0.5)]
    total, terms = Objective(losses)(buffers, target)
    assert terms["two_buffer_l2"].item() == pytest.approx(3.0)
    assert terms["l1"].item() == pytest.approx(2.0)
    assert total.item() == pytest.approx(2.0 * 3.0 + 0.5 * 2.0)


def test_losses_of_one_image_share_its_samples_among_the_buffers():
    assert Objective([L1(name="l1")]).spp_of_buffer(5) == 3
    assert Objective([L1(name="l1"), TwoBufferL2(name="two_buffer_l2")]).spp_of_buffer(5) == 5


@pytest.mark.parametrize("spec", [SSIM(name="ssim"), MultiScaleSSIM(name="ms_ssim")])
def test_similarity_is_zero_for_equal_images_and_not_for_others(spec):
    target = torch.rand(2, 3, 24, 24, generator=torch.Generator().manual_seed(0))
    objective = Objective([spec])
    assert objective((target, target), target)[0].item() == pytest.approx(0.0, abs=1e-5)
    other = (1 - target).requires_grad_()
    loss = objective((other, other), target)[0]
    loss.backward()
    assert loss.item() > 0.1
    assert other.grad.isfinite().all() and other.grad.abs().max() > 0


@pytest.mark.parametrize("name", TONE_MAPPINGS)
def test_tone_mapping_has_a_finite_gradient_at_black(name):
    image = torch.tensor([-1e-6, 0.0, 1e-4, 0.5, 20.0], requires_grad=True)
    TONE_MAPPINGS[name](image).sum().backward()
    assert image.grad.isfinite().all()
    assert (image.grad[2:] > 0).all()


def test_srgb_curve_is_the_standard_one():
    # IEC 61966-2-1: linear 0.5 encodes to 0.7354.
    encoded = TONE_MAPPINGS["srgb"](torch.tensor([0.0, 0.001, 0.5, 1.0]))
    torch.testing.assert_close(encoded, torch.tensor([0.0, 0.01292, 0.735357, 1.0]), atol=1e-5, rtol=0)
