"""Losses of noisy images: derivatives that noise does not bias, against closed forms and in a rendering."""

import re

import pytest
import torch

import torch_radbp as rb
from tests.scenes import CASES, parameters

THETA, TARGET, SAMPLES = 0.7, 0.4, 200_000
SHAPE = (SAMPLES, 3, 1, 1)


def mean_gradient(loss) -> tuple[float, float]:
    """Mean of the derivative by theta over independent pixels theta X, X exponential, and its standard error."""
    theta = torch.full(SHAPE, THETA, dtype=torch.float64, requires_grad=True)
    generator = torch.Generator().manual_seed(1)
    a, b = (theta * torch.empty(SHAPE, dtype=torch.float64).exponential_(generator=generator) for _ in range(2))
    loss(a, b, torch.full(SHAPE, TARGET, dtype=torch.float64)).backward()
    per_pixel = theta.grad * theta.numel()  # the loss is a mean over pixels
    return per_pixel.mean().item(), per_pixel.std().item() / theta.numel() ** 0.5


def exchanged(f):
    def loss(image_a, image_b, target):
        a, b = rb.losses.exchange_derivatives(image_a, image_b)
        return (f(a, target) + f(b, target)) / 2

    return loss


@pytest.mark.parametrize("loss", [rb.losses.two_buffer_l2, exchanged(torch.nn.functional.mse_loss)],
                         ids=["two buffers", "exchanged"])
def test_the_gradient_of_the_squared_error_is_unbiased_at_one_sample(loss):
    mean, error = mean_gradient(loss)
    assert error < 0.02
    assert abs(mean - 2 * (THETA - TARGET)) < 4 * error
    shared, error = mean_gradient(lambda a, b, target: torch.nn.functional.mse_loss(a, target))
    assert abs(shared - 2 * (THETA - TARGET)) > 40 * error  # E[X^2] = 2: what the two are for


def test_any_loss_sees_its_slope_at_one_image_and_the_derivative_of_the_other():
    """f(x) = x^3: E[3 a^2] E[dI] = 3 theta^2 E[X^2] = 6 theta^2."""
    mean, error = mean_gradient(exchanged(lambda image, target: (image**3).mean()))
    assert error < 0.05 and abs(mean - 6 * THETA**2) < 4 * error


def test_values_are_those_of_the_images():
    a, b = torch.rand(2, 1, 3, 4, 4, dtype=torch.float64)
    found = rb.losses.exchange_derivatives(a.requires_grad_(), b)
    assert torch.equal(found[0].detach(), a) and torch.equal(found[1].detach(), b)


def test_renderings_of_two_seeds_give_the_gradient_of_their_images():
    """d two_buffer_l2 = mean(dI_a (I_b - T) + (I_a - T) dI_b), by the derivative images."""
    case, name = CASES["cornell"], "white.reflectance.value"
    scene = case.scene()
    (white,) = parameters(scene, [name])
    renderer = rb.Renderer(scene, spp=4, max_depth=3)
    images = [renderer(seed=seed) for seed in (1, 2)]
    target = 0.9 * images[0].detach()
    found, = torch.autograd.grad(rb.losses.two_buffer_l2(*images, target), white)
    tangent = torch.tensor([0.3, -0.5, 0.8], dtype=torch.float64)
    slopes = [rb.jvp(scene, {name: tangent}, seed=seed, spp=4, max_depth=3) for seed in (1, 2)]
    values = [image.detach() - target for image in images]
    expected = (slopes[0] * values[1] + values[0] * slopes[1]).mean()
    assert expected.abs() > 0 and abs((found * tangent).sum() - expected) < 1e-10 * expected.abs()


def test_shapes_that_differ_are_refused():
    image = torch.rand(1, 3, 4, 4)
    for call in (lambda: rb.losses.two_buffer_l2(image, image, image[:, :1]),
                 lambda: rb.losses.exchange_derivatives(image, image[0])):
        with pytest.raises(ValueError, match=r"must have one shape, got \(1, 3, 4, 4\) and "):
            call()


IMAGE = torch.zeros(1, 3, 4, 4)
# Name -> (target, kind of error, what the message says).
TARGETS = {
    "bfloat16": (IMAGE.bfloat16(), TypeError, "target must be a tensor of torch.float32 or torch.float64, got "
                                              "torch.bfloat16; convert it, target.float()"),
    "half": (IMAGE.half(), TypeError, "got torch.float16; convert it, target.float()"),
    "truth values": (IMAGE.bool(), TypeError, "got torch.bool; convert it, target.float()"),
    "bytes": (IMAGE.byte(), TypeError, "got torch.uint8; convert it, target.float()"),
    "complex": (IMAGE.cfloat(), TypeError, "got torch.complex64"),
    "meta": (IMAGE.to("meta"), TypeError, "target is on the device meta, which holds no numbers: give it on the CPU"),
    "sparse": (IMAGE.to_sparse(), TypeError, "target must be a dense tensor, got torch.sparse_coo; convert it, "
                                             "target.to_dense()"),
    "none": (None, TypeError, "got NoneType"),
    "an array": (IMAGE.numpy(), TypeError, "got ndarray"),
    "another size": (IMAGE[..., :3], ValueError, "image_a and target must have one shape, got (1, 3, 4, 4) and (1, 3"),
}


@pytest.mark.hostile
@pytest.mark.parametrize("target, kind, message", TARGETS.values(), ids=TARGETS)
def test_a_target_that_is_no_image_is_named(target, kind, message):
    with pytest.raises(kind, match=re.escape(message)):
        rb.losses.two_buffer_l2(IMAGE, IMAGE, target)


@pytest.mark.hostile
def test_the_images_of_an_exchange_are_checked_too():
    with pytest.raises(TypeError, match="image_b must be a tensor of torch.float32 or torch.float64, got torch.bfloat16"):
        rb.losses.exchange_derivatives(IMAGE, IMAGE.bfloat16())
