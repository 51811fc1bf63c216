"""Exposure, lens falloff and tone curve: closed forms, derivatives, inverses."""

import pytest
import torch

import torch_radbp as rb
from torch_radbp.formats.image import linear_to_srgb

VIEWS = torch.tensor([2, 0])


@pytest.fixture
def images():
    return torch.rand(2, 3, 4, 5, dtype=torch.float64, generator=torch.Generator().manual_seed(0))


def disturbed(module, seed: int = 1):
    """`module` in float64, with parameters that are not those of the beginning."""
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for parameter in module.double().parameters():
            parameter.add_(0.3 * torch.randn(parameter.shape, dtype=torch.float64, generator=generator))
    return module


MODELS = {
    "exposure": lambda: rb.Exposure(3, gains=torch.tensor([[1.0, 2, 3], [1, 1, 1], [0.5, 0.5, 0.5]])),
    "fixed exposure": lambda: rb.Exposure(3, fixed=0),
    "exposure without balance": lambda: rb.Exposure(3, white_balance=False),
    "lens falloff": rb.LensFalloff,
    "tone curve": rb.ToneCurve,
    "tone curves": lambda: rb.ToneCurve("identity", pieces=3, per_channel=True),
}


@pytest.mark.parametrize("make", MODELS.values(), ids=MODELS)
def test_derivatives_by_images_and_parameters_are_those_of_differences(make, images):
    module = disturbed(make())
    names, values = zip(*((name, value.detach().clone().requires_grad_()) for name, value in module.named_parameters()))

    def called(image, *parameters):
        return torch.func.functional_call(module, dict(zip(names, parameters)), (image, VIEWS))

    found = torch.autograd.grad(called(images, *values).square().sum(), values)
    assert all(grad.isfinite().all() and grad.abs().max() > 1e-4 for grad in found)
    assert torch.autograd.gradcheck(called, (images.requires_grad_(), *values))


def test_each_view_has_its_gains(images):
    gains = torch.tensor([[1.0, 2, 3], [1, 1, 1], [0.5, 0.25, 0.75]], dtype=torch.float64)
    exposure = rb.Exposure(3, gains=gains).double()
    torch.testing.assert_close(exposure.gains, gains, rtol=1e-6, atol=0)
    torch.testing.assert_close(exposure(images, VIEWS), images * gains[VIEWS][:, :, None, None], rtol=1e-6, atol=0)
    torch.testing.assert_close(exposure(images[:1], 2), images[:1] * gains[2][:, None, None], rtol=1e-6, atol=0)
    times = torch.tensor([1.0, 2.0, 0.5])
    torch.testing.assert_close(rb.Exposure(3, gains=times).gains, times[:, None].expand(-1, 3))


def test_gain_and_balance_do_not_overlap():
    """What the channels of a balance have in common has no effect."""
    exposure = disturbed(rb.Exposure(3))
    before = exposure.gains.detach()
    exposure.log_balance.data += 0.7
    torch.testing.assert_close(exposure.gains.detach(), before)
    torch.testing.assert_close(before.log().mean(1), exposure.log_gain.detach())
    without = rb.Exposure(3, white_balance=False)
    assert [name for name, _ in without.named_parameters()] == ["log_gain"]


def test_a_view_that_is_fixed_stays_as_it_was(images):
    exposure = disturbed(rb.Exposure(3, fixed=2, gains=torch.tensor([1.0, 1.0, 0.5])))
    torch.testing.assert_close(exposure(images, VIEWS)[0], 0.5 * images[0], rtol=1e-6, atol=0)
    exposure(images, VIEWS).sum().backward()
    assert exposure.log_gain.grad[2] == 0 and exposure.log_gain.grad[0] != 0
    assert (exposure.log_balance.grad[2] == 0).all()


def test_falloff_is_a_polynomial_of_the_distance_and_one_at_the_beginning(images):
    assert torch.equal(rb.LensFalloff()(images), images)
    lens = rb.LensFalloff((-0.3, 0.1))
    factors = lens.factors(6, 8).detach()
    x, y = (3.5 / 5, 2.5 / 5)  # the middle of the first pixel, in half diagonals: (10, of 6 x 8) / 2
    square = x**2 + y**2
    assert float(factors[0, 0]) == pytest.approx(1 - 0.3 * square + 0.1 * square**2, rel=1e-6)
    torch.testing.assert_close(factors, factors.flip(0, 1))
    lens.centre.data = torch.tensor([x, -y])
    assert float(lens.factors(6, 8)[0, 7].detach()) == pytest.approx(1, abs=1e-6)  # upper right


def test_the_falloff_of_a_window_is_cut_out_of_that_of_the_whole():
    lens, whole = disturbed(rb.LensFalloff()), torch.rand(2, 3, 12, 20, dtype=torch.float64)
    expected = lens(whole).detach()
    windows = (3, 1, 5, 4), (15, 8, 5, 4)
    parts = [whole[..., y:y + high, x:x + wide] for x, y, wide, high in windows]
    for part, window in zip(parts, windows):
        x, y, wide, high = window
        found = lens(part, window=window, size=(20, 12)).detach()
        torch.testing.assert_close(found, expected[..., y:y + high, x:x + wide])
        assert (found - lens(part).detach()).abs().max() > 0.01
    each = lens(torch.stack([part[0] for part in parts]), window=windows, size=(20, 12)).detach()
    torch.testing.assert_close(each[1], expected[0, :, 8:12, 15:20])


@pytest.mark.parametrize("per_channel", [False, True])
@pytest.mark.parametrize("start, expected", [("srgb", linear_to_srgb), ("identity", lambda values: values)])
def test_a_curve_begins_as_a_known_one(start, expected, per_channel):
    values = torch.linspace(-0.1, 1.3, 2 * 3 * 70, dtype=torch.float64).view(1, 3, 20, 7)
    curve = rb.ToneCurve(start, per_channel=per_channel).double()
    torch.testing.assert_close(curve(values), expected(values), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("start", ["srgb", "identity"])
def test_curves_increase_keep_their_ends_and_are_inverted(start, seed):
    """With parameters of a size that no camera has."""
    curve = disturbed(rb.ToneCurve(start, per_channel=True), seed)
    for parameter in curve.parameters():
        parameter.data *= 5
    values = torch.linspace(-0.2, 1.4, 2001, dtype=torch.float64).expand(1, 3, 1, -1)
    coded = curve(values).detach()
    assert (coded.diff(dim=3) > 0).all()
    torch.testing.assert_close(curve.inverse(coded).detach(), values, rtol=1e-9, atol=1e-9)
    ends = torch.tensor([0.0, 1.0], dtype=torch.float64).expand(1, 3, 1, 2)
    torch.testing.assert_close(curve(ends).detach(), ends, rtol=0, atol=1e-12)


def test_the_derivative_at_black_is_that_beside_it():
    """Much is exactly black; where pieces meet, a derivative must not count twice."""
    curve = disturbed(rb.ToneCurve("identity"))
    values = torch.tensor([-1e-9, 0.0, 1e-9, 1 - 1e-9, 1.0, 1 + 1e-9], dtype=torch.float64).expand(1, 3, 1, 6)
    values = values.clone().requires_grad_()
    curve(values).sum().backward()
    found, = values.grad[0, 0]
    torch.testing.assert_close(found[:3], curve.log_slopes.exp()[0, 0].expand(3).detach(), rtol=1e-6, atol=0)
    torch.testing.assert_close(found[3:], curve.log_slopes.exp()[0, -1].expand(3).detach(), rtol=1e-6, atol=0)


def test_the_inverse_has_derivatives_too(images):
    curve = disturbed(rb.ToneCurve(pieces=3))
    names, values = zip(*((name, value.detach().clone().requires_grad_()) for name, value in curve.named_parameters()))

    class Inverse(torch.nn.Module):
        def __init__(self):
            super().__init__()
            self.curve = curve

        def forward(self, image):
            return self.curve.inverse(image)

    def called(image, *parameters):
        return torch.func.functional_call(Inverse(), {f"curve.{n}": p for n, p in zip(names, parameters)}, (image,))

    assert torch.autograd.gradcheck(called, (images.requires_grad_(), *values))


def test_a_curve_is_found_from_pairs():
    """A gamma of 1 / 1.8, from sRGB; noise-free pairs, 8 pieces: to half of a level of 8 bits."""
    curve = rb.ToneCurve().double()
    light = torch.linspace(0, 1, 3 * 64, dtype=torch.float64).view(1, 3, 8, 8)
    optimizer = torch.optim.Adam(curve.parameters(), lr=0.02)
    for _ in range(300):
        optimizer.zero_grad()
        loss = (curve(light) - light ** (1 / 1.8)).square().mean()
        loss.backward()
        optimizer.step()
    assert (linear_to_srgb(light) - light ** (1 / 1.8)).abs().max() > 0.03
    assert (curve(light) - light ** (1 / 1.8)).abs()[light > 0.02].max() < 0.5 / 255


BAD = {
    "views": (lambda image: rb.Exposure(0), "views must be an integer of at least 1"),
    "fixed": (lambda image: rb.Exposure(3, fixed=3), "fixed must be the index of a view, from 0 to 2, got 3"),
    "gains": (lambda image: rb.Exposure(3, gains=torch.ones(2)), r"gains must have shape \(3,\) or \(3, 3\), got \(2,\)"),
    "negative": (lambda image: rb.Exposure(1, gains=torch.zeros(1)), "gains must be positive"),
    "balance": (lambda image: rb.Exposure(1, gains=torch.ones(1, 3), white_balance=False), "without white_balance must"),
    "no view": (lambda image: rb.Exposure(3)(image, torch.tensor([0, 3])), r"views must be from 0 to 2, got \[0, 3\]"),
    "one view": (lambda image: rb.Exposure(3)(image, 0), "views must be one integer for each of 2 images"),
    "shape": (lambda image: rb.LensFalloff()(image[0]), r"images must have shape \(B, 3, H, W\), got \(3, 4, 5\)"),
    "window without size": (lambda image: rb.LensFalloff()(image, window=(0, 0, 5, 4)), "a window needs the size of the"),
    "size without window": (lambda image: rb.LensFalloff()(image, size=(5, 4)), "a window needs the size of the whole"),
    "window beside": (lambda image: rb.LensFalloff()(image, window=(1, 0, 5, 4), size=(5, 4)),
                      r"a window of 5 x 4 pixels at \(1, 0\) must have the size of the images, 5 x 4, and lie inside"),
    "window of another size": (lambda image: rb.LensFalloff()(image, window=(0, 0, 4, 4), size=(9, 9)), "must have the"),
    "windows": (lambda image: rb.LensFalloff()(image, window=[(0, 0, 5, 4)] * 7, size=(9, 9)), "or one for each of "),
    "coefficients": (lambda image: rb.LensFalloff(()), "coefficients must be one or more finite numbers"),
    "NaN": (lambda image: rb.ToneCurve()(image.where(image < 0.5, torch.nan)),
            "images have .* values that are NaN, which no"),
    "NaN to invert": (lambda image: rb.ToneCurve().inverse(image * torch.nan), "images have 120 values that are NaN"),
    "start that is NaN": (lambda image: rb.ToneCurve(float("nan")), "start nan is not known; known: identity, srgb"),
    "start": (lambda image: rb.ToneCurve("sgrb"), "start 'sgrb' is not known; did you mean 'srgb'"),
}


@pytest.mark.parametrize("call, message", BAD.values(), ids=BAD)
def test_bad_arguments_are_named(call, message, images):
    with pytest.raises(ValueError, match=message):
        call(images)


def test_infinite_exposures_are_on_a_curve():
    """A lamp is as bright as it is; the curve goes on with the slope at its end."""
    image = torch.tensor([torch.inf, 2.0, -torch.inf]).view(1, 3, 1, 1)
    found = rb.ToneCurve("identity")(image).detach()
    assert torch.equal(found, image)


def test_images_must_be_floats(images):
    with pytest.raises(TypeError, match="images must be a tensor of floating point numbers, got torch.uint8"):
        rb.ToneCurve()(images.byte())
