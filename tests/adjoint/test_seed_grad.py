"""Image and derivative have samples of their own: unbiased gradients of losses that are not linear in the image.

With I an unbiased image, E[2 (I - T) dI] = 2 (E I - T) dE I + 2 Cov(I, dI); two independent draws remove the covariance
(Gkioulekas et al. 2016; Azinovic et al. 2019, section 4).
"""

import warnings

import pytest
import torch

import torch_radbp as rb
from tests.adjoint.furnace import closed_form
from tests.deep import deep_but
from tests.gradients import image_and_gradients, relative_error, z_score
from tests.scenes import CASES, cornell, furnace, parameters
from tests.scenes.everything import build_everything
from torch_radbp.adjoint import function, images
from torch_radbp.adjoint.record import record_wavefront, trace_both
from torch_radbp.rendering import cost
from torch_radbp.rendering.cost import traced_together
from torch_radbp.rendering.jvp import rendering_with_tangent
from torch_radbp.tensors.differentiated import detached
from torch_radbp.tensors.record import leaves_of

SETTINGS = {"spp": 2, "max_depth": 4}
CHUNK = 16  # lanes
TARGET = 2.0  # of the furnace, whose radiance is 0.7 to 1.4


@pytest.mark.parametrize("adjoint", [rb.MemoizedAdjoint(), rb.MemoizedAdjoint("log"), rb.QuadraticAdjoint(),
                                     rb.ReplayAdjoint(), rb.TapeAdjoint()], ids=repr)
def test_the_backward_pass_is_that_of_the_other_seed(adjoint):
    case = CASES["cornell"]
    shared = SETTINGS | {"share_samples": True}
    image, same = image_and_gradients(case.scene(), case.parameters, seed=1, adjoint=adjoint, **shared)
    adj_image = 2 * (image - 0.3) / image.numel()
    _, expected = image_and_gradients(case.scene(), case.parameters, seed=2, adj_image=adj_image, **shared)

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

    assert relative_error(gradient(seed=5, seed_grad=0), gradient(seed=0, seed_grad=0)) < 1e-14
    assert relative_error(gradient(seed=5, seed_grad=0), gradient(seed=5, seed_grad=5)) > 1e-3
    assert relative_error(gradient(seed=5), gradient(seed=5, seed_grad=5)) > 1e-3


def test_the_seed_of_the_derivative_follows_from_that_of_the_image():
    scene = cornell()
    wanted = parameters(scene, ["white.reflectance.value"])

    def gradient(seed, **settings):
        return torch.autograd.grad(rb.render(scene, seed=seed, **SETTINGS, **settings).sum(), wanted)[0]

    assert torch.equal(gradient(5), gradient(5))
    assert relative_error(gradient(5), gradient(6)) > 1e-3
    assert torch.equal(gradient(5, share_samples=True), gradient(5, share_samples=True, seed_grad=5))


def test_forward_mode_has_samples_of_its_own_too():
    scene = cornell()
    renderer = rb.Renderer(scene, **SETTINGS)
    tangents = {"white.reflectance.value": torch.ones(3, dtype=scene.dtype)}
    image, tangent = rendering_with_tangent(renderer, tangents, 5)
    shared = rendering_with_tangent(rb.Renderer(scene, share_samples=True, **SETTINGS), tangents, 5)
    assert torch.equal(image, shared.image) and relative_error(image, renderer(seed=5)) < 1e-14
    assert relative_error(tangent, shared.tangent) > 1e-3


@pytest.mark.parametrize("adjoint", [rb.MemoizedAdjoint(), rb.MemoizedAdjoint(2, keep_hits=False), rb.ReplayAdjoint()],
                         ids=repr)
def test_records_that_would_take_too_much_memory_are_traced_again(adjoint, monkeypatch):
    """One chunk is kept; the gradient is that of all kept."""
    scene = cornell()
    wanted = parameters(scene, ["white.reflectance.value"])
    renderer = rb.Renderer(scene, adjoint=adjoint, share_samples=True, chunk=CHUNK, **SETTINGS)
    traced = []
    monkeypatch.setattr(function, "record_wavefront",
                        lambda *arguments: (traced.append(1), record_wavefront(*arguments))[1])

    def gradient():
        traced.clear()
        return torch.autograd.grad(renderer(seed=5).sum(), wanted)[0]

    kept = gradient()
    assert not traced
    call = renderer.prepare(5, None, None, None)
    record = record_wavefront(call, call.make_integrand(detached(call.scene)), call.wavefronts[0])
    size = sum(leaf.nbytes for leaf in leaves_of(record) if isinstance(leaf, torch.Tensor))
    monkeypatch.setattr(cost, "SHARE_OF_RECORDS", 1.5 * size / cost.memory_of(scene.device))
    assert torch.equal(kept, gradient())
    assert 0 < len(traced) < len(call.wavefronts)


def squared_loss_gradients(runs, **settings):
    """Gradients of mean((I - T)^2) for rho in a furnace with next-event estimation: every pixel has the same expectation."""
    scene = furnace((0.3, 0.6, 0.9), size=16)
    wanted = parameters(scene, ["walls.bsdf.reflectance.value"])
    renderer = rb.Renderer(scene, spp=1, max_depth=3, rr_depth=100, nee=True, **settings)
    rows = []
    for seed in range(runs):
        image = renderer(seed=seed)
        rows.append(torch.autograd.grad(((image - TARGET) ** 2).mean(), wanted)[0])
    return torch.stack(rows)


def test_the_gradient_of_a_squared_loss_is_unbiased_and_with_shared_samples_it_is_not():
    L, d_rho, _ = closed_form((0.3, 0.6, 0.9), depth=3)
    expected = 2 * (L - TARGET) * d_rho / 3  # the mean over three channels, of which each has its own rho
    assert expected.abs().min() > 0.05
    assert z_score(squared_loss_gradients(24), expected) < 4.5  # 3 numbers, t with 23 degrees of freedom
    assert z_score(squared_loss_gradients(24, share_samples=True), expected) > 10


def test_a_loop_without_seeds_is_told_of_its_noise():
    scene = cornell(size=2)
    wanted = parameters(scene, ["white.reflectance.value"])
    renderer = rb.Renderer(scene, **SETTINGS)
    optimizer = torch.optim.SGD(wanted, lr=1e-3)
    with warnings.catch_warnings():
        warnings.simplefilter("error", rb.RepeatedNoiseWarning)
        renderer(), renderer()  # nothing has changed
        renderer(seed=0).sum().backward()
        optimizer.step()
        renderer(seed=0)
        with torch.no_grad():
            renderer()
    with pytest.warns(rb.RepeatedNoiseWarning, match=r"called without a seed again .* renderer\(seed=step\)") as told:
        renderer()
    assert told[0].filename == __file__


@pytest.mark.parametrize("name", deep_but(["cornell"], ["cornell", "lamps"]))
def test_one_wavefront_of_both_samples_has_the_bits_of_two(name, monkeypatch):
    """Queues hold lanes of both; only those of the derivative are differentiated."""
    def rendered():
        scene = CASES[name].scene() if name in CASES else build_everything(name)
        names = CASES[name].parameters if name in CASES else [parameter for parameter, _ in scene.named_parameters()]
        return image_and_gradients(scene, names, compile=True, **SETTINGS)

    traced = []
    monkeypatch.setattr(images, "trace_both", lambda *arguments: (traced.append(1), trace_both(*arguments))[1])
    image, gradients = rendered()
    assert len(traced) == 1
    monkeypatch.setattr(rb.MemoizedAdjoint, "records_all", False)
    apart, expected = rendered()
    assert len(traced) == 1 and torch.equal(image, apart)
    assert any(gradient.abs().max() > 0 for gradient in expected)
    assert all(torch.equal(gradient, other) for gradient, other in zip(gradients, expected))


def test_samples_are_traced_together_only_where_all_their_records_are_few():
    few = traced_together(rb.MemoizedAdjoint(), 128 * 128 * 4, 8, 5, torch.float32)
    assert few and not traced_together(rb.MemoizedAdjoint(), 256 * 256 * 4, 8, 5, torch.float32)
    assert not traced_together(rb.MemoizedAdjoint(), 128 * 128 * 4, 128, 200, torch.float32)  # long paths
    for replaying in (rb.MemoizedAdjoint(2), rb.MemoizedAdjoint(keep_hits=False), rb.ReplayAdjoint(), rb.QuadraticAdjoint(),
                      rb.TapeAdjoint()):
        assert not traced_together(replaying, 16, 8, 5, torch.float32), replaying
