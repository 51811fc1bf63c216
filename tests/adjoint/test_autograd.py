"""What torch may ask of the one `autograd.Function`: a second pass, a derivative of the derivative, its memory back."""

import pytest
import torch
from torch.multiprocessing.reductions import StorageWeakRef

import torch_radbp as rb
from tests.gradients import cotangent, image_and_gradients, relative_error
from tests.scenes import CASES, cornell, furnace, parameters

pytestmark = pytest.mark.usefixtures("threads")  # with one and with two

STRATEGIES = [rb.MemoizedAdjoint(), rb.MemoizedAdjoint("log", keep_hits=False), rb.QuadraticAdjoint(), rb.ReplayAdjoint()]


def rendering(adjoint=None, seed_grad=None):
    scene = cornell(size=4)
    wanted = parameters(scene, ["white.reflectance.value"])
    return rb.Renderer(scene, spp=2, max_depth=4, adjoint=adjoint)(seed=1, seed_grad=seed_grad), wanted


@pytest.mark.parametrize("seed_grad", [None, 1])
@pytest.mark.parametrize("adjoint", STRATEGIES, ids=repr)
def test_a_second_backward_pass_raises(adjoint, seed_grad):
    image, _ = rendering(adjoint, seed_grad)
    image.sum().backward()
    with pytest.raises(RuntimeError, match="second time"):
        image.sum().backward()


@pytest.mark.parametrize("adjoint", STRATEGIES, ids=repr)
def test_a_graph_that_is_retained_can_be_walked_twice(adjoint):
    image, wanted = rendering(adjoint)
    first, = torch.autograd.grad(image, wanted, cotangent(image.detach()), retain_graph=True)
    second, = torch.autograd.grad(image, wanted, cotangent(image.detach()))
    assert first.abs().max() > 0 and torch.equal(first, second)


@pytest.mark.parametrize("adjoint", STRATEGIES, ids=repr)
@pytest.mark.parametrize("loss", [lambda image: image.sum(), lambda image: (image**2).sum()], ids=["linear", "squares"])
def test_a_backward_pass_that_is_recorded_raises(adjoint, loss):
    image, wanted = rendering(adjoint)
    with pytest.raises(RuntimeError, match=r"first derivatives only.*create_graph=True.*adjoint=rb.TapeAdjoint\(\)"):
        torch.autograd.grad(loss(image), wanted, create_graph=True)


def test_the_hessian_of_a_rendering_is_refused_and_by_the_tape_that_of_the_closed_form():
    """Without next-event estimation a pixel of the furnace is Le (1 + rho + rho^2 + rho^3)."""
    name, rho = "walls.bsdf.reflectance.value", torch.tensor([0.3, 0.6, 0.9], dtype=torch.float64)

    def pixel(adjoint):
        renderer = rb.Renderer(furnace(), spp=1, max_depth=4, rr_depth=100, nee=False, adjoint=adjoint)
        return lambda value: torch.func.functional_call(renderer, {f"scene.{name}": value})[0, :, 1, 1].sum()

    with pytest.raises(RuntimeError, match="first derivatives only"):
        torch.autograd.functional.hessian(pixel(rb.MemoizedAdjoint()), rho)
    found = torch.autograd.functional.hessian(pixel(rb.TapeAdjoint()), rho)
    expected = torch.tensor([1.0, 0.5, 0.25], dtype=torch.float64) * (2 + 6 * rho)
    torch.testing.assert_close(found, torch.diag(expected), rtol=1e-10, atol=1e-12)


def test_path_records_are_freed_by_the_backward_pass_though_the_image_lives_on():
    image, _ = rendering(seed_grad=1)
    visibility = [StorageWeakRef(t.untyped_storage()) for t in image.grad_fn.saved_tensors if t.dtype == torch.bool]
    assert visibility and len(visibility) % 4 == 0 and not any(mask.expired() for mask in visibility)
    image.sum().backward()
    assert image.shape == (1, 3, 4, 4) and all(mask.expired() for mask in visibility)


def test_gradients_of_two_renderings_add_up():
    case = CASES["cornell"]
    _, first = image_and_gradients(case.scene(), case.parameters, seed=1, spp=2, max_depth=3)
    _, second = image_and_gradients(case.scene(), case.parameters, seed=2, spp=2, max_depth=3)
    scene = case.scene()
    wanted = parameters(scene, case.parameters)
    renderer = rb.Renderer(scene, spp=2, max_depth=3)
    images = [renderer(seed=seed) for seed in (1, 2)]  # both graphs alive at the same time
    for image in images:
        image.backward(cotangent(image.detach()))
    for parameter, a, b in zip(wanted, first, second):
        assert (a + b).abs().max() > 0 and relative_error(parameter.grad, a + b) < 1e-14


def test_a_parameter_that_changes_before_the_backward_pass_does_not_change_the_gradient():
    image, (white,) = rendering()
    expected, = torch.autograd.grad(image, white, cotangent(image.detach()), retain_graph=True)
    with torch.no_grad():
        white += 0.1
    gradient, = torch.autograd.grad(image, white, cotangent(image.detach()))
    assert expected.abs().max() > 0 and torch.equal(gradient, expected)


def test_no_gradient_is_recorded_in_no_grad_mode():
    scene = cornell(size=4)
    parameters(scene, ["white.reflectance.value"])
    with torch.no_grad():
        image = rb.Renderer(scene, spp=2, max_depth=4)(seed=1)
    assert not image.requires_grad
    with torch.inference_mode():
        assert torch.equal(rb.Renderer(scene, spp=2, max_depth=4)(seed=1), image)
