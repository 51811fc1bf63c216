"""What each loss promises of its bias, in expectation over synthetic noise; masks; and kornia's SSIM."""

import kornia
import pytest
import torch

import torch_radbp as rb

SAMPLES, TARGET = 400_000, 0.4
SHAPE = (SAMPLES, 3, 1, 1)
EPSILON = 1e-2


def noisy(theta: float, seed: int = 1):
    """Images theta X of independent pixels, X exponential, twice; and theta, (N, 3, 1, 1), which they are attached to.

    As the renderer does, image and derivative have samples of their own: X of the value and Y of the derivative.
    """
    generator = torch.Generator().manual_seed(seed)
    parameter = torch.full(SHAPE, theta, dtype=torch.float64, requires_grad=True)

    def image():
        x, y = (torch.empty(SHAPE, dtype=torch.float64).exponential_(generator=generator) for _ in range(2))
        return theta * x + (parameter - theta) * y

    return image(), image(), parameter


def gradient(loss, theta: float) -> tuple[float, float]:
    """Mean over pixels of the derivative by theta, and its standard error."""
    a, b, parameter = noisy(theta)
    loss(a, b, torch.full(SHAPE, TARGET, dtype=torch.float64)).backward()
    per_pixel = parameter.grad * parameter.numel()  # the loss is a mean over pixels
    return per_pixel.mean().item(), per_pixel.std().item() / parameter.numel() ** 0.5


@pytest.mark.parametrize("theta", [0.1, TARGET, 1.2])
def test_the_squared_error_is_unbiased(theta):
    mean, error = gradient(rb.losses.two_buffer_l2, theta)
    assert 0 < error < 0.02 and abs(mean - 2 * (theta - TARGET)) < 4 * error


@pytest.mark.parametrize("theta", [0.1, TARGET, 1.2])
def test_the_relative_error_has_the_right_zero_and_sign_at_any_noise(theta):
    """E[2 (theta X - T) / (theta^2 X'^2 + eps)] = 2 (theta - T) E[1 / (theta^2 X^2 + eps)], the mean by quadrature."""
    x = torch.linspace(0, 40, 2_000_001, dtype=torch.float64)
    weight = torch.trapezoid(torch.exp(-x) / (theta**2 * x**2 + EPSILON), x).item()
    assert weight > 1.2 / (theta**2 + EPSILON)  # its size is not that without noise
    mean, error = gradient(lambda *images: rb.losses.two_buffer_relative_l2(*images, epsilon=EPSILON), theta)
    assert 0 < error < 0.05 * weight and abs(mean - 2 * (theta - TARGET) * weight) < 4 * error


def test_one_denominator_of_both_images_would_move_the_zero():
    """What the exchange of weights is for: at theta = T the gradient should be 0."""
    def naive(a, b, target):
        return ((a - target) * (b - target) / ((a + b).detach().square() / 4 + EPSILON)).mean()

    mean, error = gradient(naive, TARGET)
    assert abs(mean) > 20 * error
    mean, error = gradient(rb.losses.two_buffer_relative_l2, TARGET)
    assert abs(mean) < 4 * error


def test_the_value_of_the_relative_error_without_noise_is_the_plain_one():
    image, target = torch.rand(2, 1, 3, 4, 5, dtype=torch.float64)
    image.requires_grad_()
    found = rb.losses.two_buffer_relative_l2(image, image, target)
    plain = ((image - target).square() / (image.detach().square() + 1e-2)).mean()
    torch.testing.assert_close(found, plain)
    torch.testing.assert_close(*(torch.autograd.grad(value, image)[0] for value in (found, plain)))


@pytest.mark.parametrize("spread", [0.1, 0.2])
def test_the_bias_of_the_logarithmic_error_is_what_its_docstring_says(spread):
    """At theta = T, relative noise s: E[log(I + e)] is below log(T + e) by s^2 T^2 / (2 (T + e)^2), so the gradient asks
    for more light; to a tenth, which higher orders of s^2 = 0.04 take."""
    generator = torch.Generator().manual_seed(2)
    parameter = torch.full(SHAPE, TARGET, dtype=torch.float64, requires_grad=True)
    a, b = (TARGET * (1 + spread * (2 * torch.rand(SHAPE, dtype=torch.float64, generator=generator) - 1) * 3**0.5)
            + (parameter - TARGET) for _ in range(2))
    rb.losses.two_buffer_log_l2(a, b, torch.full_like(a, TARGET), epsilon=EPSILON).backward()
    per_pixel = parameter.grad * parameter.numel()
    mean, error = per_pixel.mean().item(), per_pixel.std().item() / parameter.numel() ** 0.5
    # 2 E[log a - log T] E[1 / (b + e)], the second factor to the same order.
    offset = -(spread * TARGET) ** 2 / (2 * (TARGET + EPSILON) ** 2)
    expected = 2 * offset / (TARGET + EPSILON) * (1 - 2 * offset)
    assert error < 0.02 * abs(expected) and mean == pytest.approx(expected, rel=0.1)


def test_logarithms_of_images_below_zero_are_finite():
    image = torch.tensor([-0.1, 0.0, 1.0]).view(1, 3, 1, 1).requires_grad_()
    loss = rb.losses.two_buffer_log_l2(image, image, torch.full((1, 3, 1, 1), 0.5))
    loss.backward()
    assert loss.isfinite() and image.grad.isfinite().all()


LOSSES = {"l2": rb.losses.two_buffer_l2, "relative": rb.losses.two_buffer_relative_l2, "log": rb.losses.two_buffer_log_l2,
          "ssim": lambda a, b, t, m: rb.losses.ssim(a, b, t, m, window=3),
          "lpips": lambda a, b, t, m: rb.losses.lpips(a, b, t, lambda x, y: (x - y).abs(), m)}


@pytest.mark.parametrize("loss", LOSSES.values(), ids=LOSSES)
def test_what_is_masked_has_neither_value_nor_derivative(loss):
    a, b, target = torch.rand(3, 2, 3, 8, 8, dtype=torch.float64)
    mask = torch.zeros(2, 1, 8, 8, dtype=torch.float64)
    mask[:, :, 2:6, 3:7] = 1
    a.requires_grad_()
    value = loss(a, b, target, mask)
    value.backward()
    assert value.isfinite() and value != 0
    assert (a.grad[:, :, 2:6, 3:7] != 0).any() and (a.grad * (1 - mask) == 0).all()
    other = torch.where(mask > 0, a.detach(), 7.0)
    torch.testing.assert_close(loss(other, b, target, mask), value.detach(), rtol=1e-12, atol=0)
    assert loss(a, b, target, None) != value


@pytest.mark.parametrize("nothing", [torch.nan, torch.inf, -torch.inf])
@pytest.mark.parametrize("loss", LOSSES.values(), ids=LOSSES)
def test_a_target_that_is_not_finite_does_not_count_where_the_mask_is_zero(loss, nothing):
    """EXR targets are NaN where nothing was rendered; loss and derivative are those of any other values there."""
    a, b, target = torch.rand(3, 2, 3, 8, 8, dtype=torch.float64)
    mask = torch.rand(2, 1, 8, 8, dtype=torch.float64)
    mask[:, :, :3] = 0
    a.requires_grad_()
    broken = target.clone()
    broken[:, :, 0, ::2] = nothing
    expected = loss(a, b, torch.where(broken.isfinite(), target, 0.0), mask)
    value = loss(a, b, broken, mask)
    torch.testing.assert_close(value, expected, rtol=1e-12, atol=0)
    torch.testing.assert_close(*(torch.autograd.grad(each, a)[0] for each in (value, expected)), rtol=1e-12, atol=0)
    assert value != 0 and broken[0, 0, 0, 0].isnan() == torch.tensor(nothing).isnan()  # the caller's is left as it was
    broken[1, 2, 7, 7] = nothing
    with pytest.raises(ValueError, match="target has 1 values that are NaN or infinite; a mask that is 0 there leaves"):
        loss(a, b, broken, mask)
    with pytest.raises(ValueError, match="target has 25 values that are NaN or infinite"):  # 2 x 3 x 4 and that one
        loss(a, b, broken, None)


@pytest.mark.parametrize("value, got", [(-0.1, "-0.1"), (torch.nan, "NaN or infinity"), (torch.inf, "NaN or infinity")])
@pytest.mark.parametrize("loss", [*LOSSES.values(), lambda a, b, t, m: rb.losses.masked_mean(a - t, m)],
                         ids=[*LOSSES, "masked mean"])
def test_a_negative_mask_is_refused(loss, value, got):
    """It would make a loss that is less the worse the image is."""
    a, b, target = torch.rand(3, 1, 3, 8, 8, dtype=torch.float64)
    mask = torch.ones(1, 1, 8, 8, dtype=torch.float64)
    mask[0, 0, 2, 2] = value
    with pytest.raises(ValueError, match=f"mask must be at least 0, how much of a pixel counts, got {got}"):
        loss(a, b, target, mask)


def test_values_that_are_nan_where_the_mask_is_zero_do_not_count():
    values = torch.tensor([1.0, torch.nan, 3.0, torch.inf]).view(1, 1, 2, 2)
    assert rb.losses.masked_mean(values, torch.tensor([1.0, 0, 3, 0]).view(1, 1, 2, 2)) == 2.5


def test_losses_can_be_vectorised():
    """`torch.func` hides the values of a batch: they are not checked there."""
    a, b, target = torch.rand(3, 4, 1, 3, 8, 8, dtype=torch.float64)
    mask = torch.ones(1, 1, 8, 8, dtype=torch.float64)
    found = torch.func.vmap(lambda a, b, t: rb.losses.two_buffer_l2(a, b, t, mask))(a, b, target)
    expected = torch.stack([rb.losses.two_buffer_l2(*each, mask) for each in zip(a, b, target)])
    torch.testing.assert_close(found, expected)


def test_a_mask_weighs():
    values = torch.arange(12, dtype=torch.float64).view(1, 3, 2, 2)
    mask = torch.tensor([[[[1.0, 0.0], [0.5, 0.0]]]], dtype=torch.float64)
    expected = (values[0, :, 0, 0] + 0.5 * values[0, :, 1, 0]).sum() / 4.5
    torch.testing.assert_close(rb.losses.masked_mean(values, mask), expected)
    torch.testing.assert_close(rb.losses.masked_mean(values, mask.expand(1, 3, 2, 2)), expected)
    assert rb.losses.masked_mean(values, 0 * mask) == 0
    with pytest.raises(ValueError, match=r"mask must have shape \(1, 1, 2, 2\), got \(1, 2, 2\)"):
        rb.losses.masked_mean(values, mask[0])
    with pytest.raises(TypeError, match="mask must be a tensor of torch.float32 or torch.float64, got torch.bool"):
        rb.losses.two_buffer_l2(values, values, values, mask > 0)


def test_ssim_is_that_of_kornia():
    image, target = torch.rand(2, 1, 3, 16, 16, dtype=torch.float64)
    image.requires_grad_()
    found, reference = rb.losses.ssim(image, image, target), kornia.losses.ssim_loss(image, target, 11)
    assert 0.1 < reference < 1
    torch.testing.assert_close(found, reference)
    torch.testing.assert_close(*(torch.autograd.grad(value, image)[0] for value in (found, reference)))


def test_the_distance_of_features_is_that_of_the_module():
    """Images in [-1, 1], as LPIPS takes them; each with the derivative of the other."""
    a, b, target = torch.rand(3, 1, 3, 8, 8, dtype=torch.float64)
    a.requires_grad_()
    found = rb.losses.lpips(a, b, target, lambda x, y: (x - y).square().sum((1, 2, 3), keepdim=True))
    expected = 4 * ((a - target).square().sum() + (b - target).square().sum()) / 2
    torch.testing.assert_close(found, expected.detach())
    torch.testing.assert_close(torch.autograd.grad(found, a)[0], 4 * (b - target))
    with pytest.raises(TypeError, match="module must be a distance of two batches of images.*got str"):
        rb.losses.lpips(a, b, target, "vgg")


def test_exchanged_is_the_mean_of_a_loss_over_both():
    a, b, target = torch.rand(3, 1, 3, 8, 8, dtype=torch.float64)
    a.requires_grad_()
    found = rb.losses.exchanged(torch.nn.functional.mse_loss, a, b, target)
    torch.testing.assert_close(found, ((a - target).square().mean() + (b - target).square().mean()).detach() / 2)
    torch.testing.assert_close(torch.autograd.grad(found, a)[0], (b - target) / a.numel())


def test_epsilon_must_be_positive():
    image = torch.rand(1, 3, 4, 4)
    for loss in (rb.losses.two_buffer_relative_l2, rb.losses.two_buffer_log_l2):
        with pytest.raises(ValueError, match="epsilon must be greater than 0"):
            loss(image, image, image, epsilon=0.0)
