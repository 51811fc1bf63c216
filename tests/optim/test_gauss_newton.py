"""Gauss-Newton: one step for linear problems, few for others, ranges, reweighting, and what noise asks for."""

import math

import pytest
import torch

import torch_radbp as rb
from tests.scenes import cornell
from tests.scenes.sunlit import COLOUR, wall_under_sun
from torch_radbp.optim import GaussNewton
from torch_radbp.optim.linearisation import Linearisation


def test_a_linear_problem_takes_one_step():
    """Damping of 1e-6 leaves 1e-6 of the way."""
    scene = wall_under_sun()
    renderer = rb.Renderer(scene, spp=2, max_depth=2)
    target, colour = renderer(seed=0).detach(), scene.get_parameter(COLOUR)
    truth = colour.detach().clone()
    with torch.no_grad():
        colour.mul_(0.2)
    optimizer = GaussNewton([colour], scene, spp=2)
    first = optimizer.step(lambda seed, spp: renderer(seed=seed, spp=spp) - target)
    assert first == pytest.approx(float((0.8 * target).square().mean()), rel=1e-6)
    assert (colour - truth).abs().max() <= 2e-6
    assert optimizer.search["gain"] == pytest.approx(1, abs=1e-4) and optimizer.search["spp"] == 2


def test_conjugate_gradients_solve_what_has_many_parameters():
    generator = torch.Generator().manual_seed(0)
    matrix = torch.randn(300, 250, generator=generator, dtype=torch.float64)
    truth = torch.randn(250, generator=generator, dtype=torch.float64)
    found = torch.zeros(250, dtype=torch.float64, requires_grad=True)
    optimizer = GaussNewton([found], damping=0, iterations=600)
    optimizer.step(lambda seed, spp: matrix @ (found - truth))
    assert (found - truth).norm() <= 1e-4 * truth.norm()
    assert found.requires_grad


def test_conjugate_gradients_predict_from_where_the_step_begins():
    """80 numbers by x^3 = 1 from 3: as of one, the step is to 55 / 27, and errors fall from 26 to those of its cube."""
    x = torch.full((80,), 3.0, dtype=torch.float64, requires_grad=True)
    optimizer = GaussNewton([x], damping=0)
    optimizer.step(lambda seed, spp: x ** 3 - 1)
    assert torch.allclose(x.detach(), torch.full_like(x, 55 / 27), rtol=1e-9)
    assert optimizer.search["gain"] == pytest.approx(1 - (((55 / 27) ** 3 - 1) / 26) ** 2, rel=1e-9)


def test_a_failed_step_by_conjugate_gradients_is_tried_again_from_where_it_began():
    """The arctangent from 2, where the undamped step goes too far: the damped one ends between 0 and 2."""
    x = torch.full((80,), 2.0, dtype=torch.float64, requires_grad=True)
    optimizer = GaussNewton([x], damping=0)
    optimizer.step(lambda seed, spp: x.atan())
    assert optimizer.search["damping"] >= 1e-3
    damping = optimizer.search["damping"] * (10 if optimizer.search["gain"] > 0.5 else 1)
    slope = 0.2  # of the arctangent at 2; the diagonal of J^T J is its square
    expected = 2 - math.atan(2) / (slope * (1 + damping))
    assert torch.allclose(x.detach(), torch.full_like(x, expected), rtol=1e-6)


def test_steps_that_are_too_short_are_doubled():
    """Noise of J three times as large as J makes a step a tenth of what it should be: thrice doubled, it is eight tenths."""
    x = torch.full((1,), 2.0, dtype=torch.float64, requires_grad=True)
    optimizer = GaussNewton([x], damping=0)
    optimizer.step(lambda seed, spp: torch.cat([x - 1, (3.0 if seed % 4 >= 2 else 0.0) * (x - x.detach())]))
    assert optimizer.search["gain"] == pytest.approx(1.9)
    assert float(x.detach()) == pytest.approx(1.2)


def test_numbers_that_share_no_channel_are_found_by_one_image():
    """Three products for nine reflectances, and one more that looks whether they are separate; J is that of nine."""
    scene = cornell(torch.float64, 6)
    renderer = rb.Renderer(scene, spp=4, max_depth=3)
    held = [scene.get_parameter(f"{name}.reflectance.value") for name in ("white", "green", "red")]
    seeds = []

    def images(seed, spp):
        seeds.append(seed)
        return renderer(seed=seed, spp=spp)

    linear = Linearisation(images, held)
    whole = linear.jacobian(1, 4)
    assert whole.abs().amax(0).min() > 0 and len(seeds) == 9
    assert sorted(map(sorted, linear.columns.groups)) == [[0, 1, 2], [3, 4, 5], [6, 7, 8]]
    again = linear.jacobian(1, 4)
    assert len(seeds) == 9 + 4 and torch.equal(again, whole)


def test_columns_that_were_separate_and_are_no_longer_are_found_one_by_one():
    mixed = torch.zeros((), dtype=torch.float64)
    x = torch.ones(3, dtype=torch.float64)
    linear = Linearisation(lambda seed, spp: x + mixed * x.flip(0), [x])
    assert torch.equal(linear.jacobian(0, 1), torch.eye(3, dtype=torch.float64))
    assert linear.columns.groups == [[0, 1, 2]] and linear.columns.save
    mixed.fill_(0.5)
    expected = torch.eye(3, dtype=torch.float64) + 0.5 * torch.eye(3, dtype=torch.float64).flip(0)
    assert torch.equal(linear.jacobian(0, 1), expected)
    assert torch.equal(linear.jacobian(0, 1), expected)


def test_a_product_is_found_within_few_steps():
    """Rosenbrock's function as residuals: 10 (y - x^2) and 1 - x."""
    x, y = (torch.tensor(value, dtype=torch.float64, requires_grad=True) for value in (-1.2, 1.0))
    optimizer = GaussNewton([x, y])
    for _ in range(40):
        optimizer.step(lambda seed, spp: [10 * (y - x * x), 1 - x])
    assert (x.detach() - 1).abs() < 1e-6 and (y.detach() - 1).abs() < 1e-6


def test_values_stay_in_their_ranges():
    """A target that is brighter than a white wall: the reflectance ends at 1, the others where they should."""
    scene = wall_under_sun()
    renderer = rb.Renderer(scene, spp=2, max_depth=2)
    colour = scene.get_parameter(COLOUR)
    target = renderer(seed=0).detach() * torch.tensor([5.0, 1.5, 1.0], dtype=torch.float64)[:, None, None]
    optimizer = GaussNewton([colour], scene, spp=2)
    for _ in range(3):
        optimizer.step(lambda seed, spp: renderer(seed=seed, spp=spp) - target)
        assert colour.max() <= 1
    assert torch.allclose(colour.detach(), torch.tensor([1.0, 0.75, 0.7], dtype=torch.float64), atol=1e-4)


def test_outliers_count_less():
    scene = wall_under_sun(8)
    renderer = rb.Renderer(scene, spp=2, max_depth=2)
    colour, target = scene.get_parameter(COLOUR), renderer(seed=0).detach()
    truth = colour.detach().clone()
    target[..., 0, :3] += 50.0
    errors = {}
    for robust, steps in ((None, 2), (0.05, 8)):  # the first problem is linear
        with torch.no_grad():
            colour.copy_(truth + 0.05)
        optimizer = GaussNewton([colour], spp=2, robust=robust)
        for _ in range(steps):
            optimizer.step(lambda seed, spp: renderer(seed=seed, spp=spp) - target)
        errors[robust] = float((colour - truth).abs().max())
    assert errors[None] > 1 and errors[0.05] < 1e-3


def test_the_room_is_found_and_noise_asks_for_samples():
    """Reflectances of the Cornell box from a target of many samples, by relative residuals that the lamp does not rule."""
    scene = cornell(torch.float64, 8)
    renderer = rb.Renderer(scene, spp=16, max_depth=3)
    held = [scene.get_parameter(name) for name in ("green.reflectance.value", "red.reflectance.value")]
    truth = torch.cat(held).detach().clone()
    target = renderer(seed=999, spp=1024).detach()
    with torch.no_grad():
        for parameter in held:
            parameter.fill_(0.3)
    optimizer = GaussNewton(held, scene, spp=16, max_spp=128)
    for _ in range(8):
        optimizer.step(lambda seed, spp: (renderer(seed=seed, spp=spp) - target) / (target + 0.1))
    assert (torch.cat(held) - truth).abs().max() < 0.05
    assert optimizer.search["spp"] > 16 and math.isfinite(optimizer.search["gain"])


def test_the_jacobian_is_kept_while_it_says_how_residuals_change():
    """A linear problem needs one; of a product of parameters, far from where it is 1, J is another after each step."""
    scene = wall_under_sun()
    renderer, colour = rb.Renderer(scene, spp=2, max_depth=2), scene.get_parameter(COLOUR)
    target = renderer(seed=0).detach()
    with torch.no_grad():
        colour.mul_(0.2)
    optimizer = GaussNewton([colour], scene, spp=2)
    for _ in range(3):
        optimizer.step(lambda seed, spp: renderer(seed=seed, spp=spp) - target)
    assert optimizer.search["jacobians"] == 1 and optimizer.search["error_of_j"] < 1e-6
    x = torch.tensor([3.0], dtype=torch.float64, requires_grad=True)
    bent = GaussNewton([x], damping=0)
    bent.step(lambda seed, spp: x ** 3 - 1)
    # From 3 to 55 / 27: the change is 55^3 / 27^3 - 27, and that by J is -26.
    change = (55 / 27) ** 3 - 27
    assert bent.search["error_of_j"] == pytest.approx((1 + 26 / change) ** 2, rel=1e-9)
    for _ in range(10):
        bent.step(lambda seed, spp: x ** 3 - 1)
    assert abs(x.item() - 1) < 1e-9 and bent.search["jacobians"] > 3


def test_noise_of_the_jacobian_asks_for_its_samples():
    """A slope of 1 +- 1 / sqrt(spp), of one number: its variance over the square of what is used is the noise told."""
    x = torch.tensor([2.0], dtype=torch.float64, requires_grad=True)
    slopes = {}

    def residuals(seed, spp):
        slopes[seed, spp] = 1 + torch.randn(1, generator=torch.Generator().manual_seed(seed), dtype=x.dtype) / spp ** 0.5
        return slopes[seed, spp] * (x - 1)

    optimizer = GaussNewton([x], spp=1, max_spp=64)
    optimizer.step(residuals)
    used, other = float(slopes[2, 1]), float(slopes[3, 1])
    assert optimizer.search["noise_of_j"] == pytest.approx(0.5 * (used - other) ** 2 / used ** 2, rel=1e-9)
    assert optimizer.search["spp_of_j"] == (2 if optimizer.search["noise_of_j"] > 0.3 else 1)
    for _ in range(20):
        optimizer.step(residuals)
    assert abs(x.item() - 1) < 1e-3


def test_noise_of_the_jacobian_shortens_no_step():
    """10,000 pixels whose slopes are 1 +- 0.8: J^T J is 1.64 times the curvature, and the step ends where the error does."""
    x = torch.tensor([1.0], dtype=torch.float64, requires_grad=True)

    def residuals(seed, spp):
        noise = torch.randn(10000, generator=torch.Generator().manual_seed(seed), dtype=x.dtype)
        return (1 + 0.8 * noise) * x - 2

    optimizer = GaussNewton([x], damping=0)
    optimizer.step(residuals)
    assert optimizer.search["noise_of_j"] == pytest.approx(0.64 / 1.64, abs=0.02)
    assert abs(x.item() - 2) < 0.05  # 1.61 by J^T J alone
    assert optimizer.search["gain"] == pytest.approx(1, abs=0.05)


def test_noise_that_pixels_have_by_themselves_asks_for_samples():
    """Residuals of normal noise only: every step is noise, and samples are two or four times as many after it."""
    x = torch.zeros(3, dtype=torch.float64, requires_grad=True)
    matrix = torch.randn(60, 3, generator=torch.Generator().manual_seed(9), dtype=torch.float64)

    def residuals(seed, spp):
        noise = torch.randn(60, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
        return matrix @ x + noise / spp ** 0.5

    optimizer = GaussNewton([x], spp=4, max_spp=256)
    while (samples := optimizer.search["spp"]) < 256:
        optimizer.step(residuals)
        assert optimizer.search["noise_share"] > 0.3
        assert optimizer.search["spp"] in (2 * samples, 4 * samples, 256)
    for _ in range(40):
        optimizer.step(residuals)
    averaged = optimizer.search["averaged"]
    assert averaged > 30
    # Variances of 1 / 256 of each residual, halved by the pair and divided by the steps, by 60 rows of 3 columns.
    assert x.detach().norm() < 3 * (3 / 60 / 512 / averaged) ** 0.5


def test_what_makes_no_sense_is_said():
    parameter = torch.ones(2, dtype=torch.float64)
    with pytest.raises(ValueError, match="no parameter changes the residuals"):
        GaussNewton([parameter]).step(lambda seed, spp: torch.ones(3))
    with pytest.raises(ValueError, match="residuals must be finite"):
        GaussNewton([parameter]).step(lambda seed, spp: parameter * math.nan)
    with pytest.raises(ValueError, match="spp must be at least 1"):
        GaussNewton([parameter], spp=0)
    with pytest.raises(ValueError, match="holds no parameter of this scene"):
        GaussNewton([parameter], wall_under_sun())


def test_numbers_that_are_hardly_seen_do_not_make_up_for_the_errors_of_others():
    """100 numbers, of which the second half is seen a hundredth as well: only the first are off, and few conjugate
    gradients do not find these. Scaled by their own curvature the others moved by 11.6 times what the first were off by."""
    generator = torch.Generator().manual_seed(0)
    matrix = torch.randn(120, 100, generator=generator, dtype=torch.float64)
    matrix[:, 50:] *= 0.01
    off = torch.cat([torch.randn(50, generator=generator, dtype=torch.float64), torch.zeros(50, dtype=torch.float64)])
    x = off.clone().requires_grad_()
    GaussNewton([x], damping=0, iterations=4).step(lambda seed, spp: matrix @ x)
    assert x[:50].detach().norm() < 0.5 * off.norm()
    assert x[50:].detach().norm() < 0.3 * off.norm()
