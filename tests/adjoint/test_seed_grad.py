"""Independent samples in the backward pass: unbiased gradients of losses that are not linear in the image.

With I an unbiased image, E[2 (I - T) dI] = 2 (E I - T) dE I + 2 Cov(I, dI); two independent draws remove the covariance
(Gkioulekas et al. 2016; Azinovic et al. 2019, section 4).
"""

import pytest
import torch

import torch_radbp as rb
from tests.adjoint.test_furnace import closed_form
from tests.gradients import image_and_gradients, relative_error, z_score
from tests.scenes import CASES, cornell, furnace, parameters

SETTINGS = {"spp": 2, "max_depth": 4}
TARGET = 2.0  # of the furnace, whose radiance is 0.7 to 1.4


@pytest.mark.parametrize("adjoint", [rb.MemoizedAdjoint(), rb.MemoizedAdjoint("log"), rb.QuadraticAdjoint(),
                                     rb.ReplayAdjoint()], ids=repr)
def test_the_backward_pass_is_that_of_the_other_seed(adjoint):
    case = CASES["cornell"]
    image, same = image_and_gradients(case.scene(), case.parameters, seed=1, adjoint=adjoint, **SETTINGS)
    adj_image = 2 * (image - 0.3) / image.numel()
    _, expected = image_and_gradients(case.scene(), case.parameters, seed=2, adj_image=adj_image, **SETTINGS)

    scene = case.scene()
    wanted = parameters(scene, case.parameters)
    rendered = rb.Renderer(scene, adjoint=adjoint, **SETTINGS)(seed=1, seed_grad=2)
    assert torch.equal(rendered.detach(), image)
    gradients = torch.autograd.grad(((rendered - 0.3) ** 2).mean(), wanted)
    for gradient, other in zip(gradients, expected):
        assert other.abs().max() > 0 and relative_error(gradient, other) < 1e-12
    assert all(relative_error(gradient, s) > 1e-3 for gradient, s in zip(gradients, same))


def test_zero_is_a_seed_like_any_other():
    scene = cornell()
    wanted = parameters(scene, ["white.reflectance.value"])
    renderer = rb.Renderer(scene, **SETTINGS)

    def gradient(**seeds):
        return torch.autograd.grad(renderer(**seeds).sum(), wanted)[0]

    assert relative_error(gradient(seed=5, seed_grad=0), gradient(seed=0)) < 1e-14
    assert relative_error(gradient(seed=5, seed_grad=5), gradient(seed=5)) < 1e-14
    assert relative_error(gradient(seed=5, seed_grad=0), gradient(seed=5)) > 1e-3


def squared_loss_gradients(runs, **seed_grad):
    """Gradients of mean((I - T)^2) for rho in a furnace with next-event estimation: every pixel has the same expectation."""
    scene = furnace((0.3, 0.6, 0.9), size=16)
    wanted = parameters(scene, ["walls.bsdf.reflectance.value"])
    renderer = rb.Renderer(scene, spp=1, max_depth=3, rr_depth=100, nee=True)
    rows = []
    for seed in range(runs):
        image = renderer(seed=seed, **{name: value + seed for name, value in seed_grad.items()})
        rows.append(torch.autograd.grad(((image - TARGET) ** 2).mean(), wanted)[0])
    return torch.stack(rows)


def test_the_gradient_of_a_squared_loss_is_unbiased_and_with_shared_samples_it_is_not():
    L, d_rho, _ = closed_form((0.3, 0.6, 0.9), depth=3)
    expected = 2 * (L - TARGET) * d_rho / 3  # the mean over three channels, of which each has its own rho
    assert expected.abs().min() > 0.05
    assert z_score(squared_loss_gradients(24, seed_grad=1000), expected) < 4.5  # 3 numbers, t with 23 degrees of freedom
    assert z_score(squared_loss_gradients(24), expected) > 10


def test_the_tape_refuses_an_independent_backward_pass():
    scene = cornell(size=2)
    parameters(scene, ["white.reflectance.value"])
    with pytest.raises(ValueError, match="seed_grad .* TapeAdjoint"):
        rb.Renderer(scene, adjoint=rb.TapeAdjoint(), **SETTINGS)(seed=1, seed_grad=2)
