"""Closed form: in a closed box whose walls emit Le and reflect rho, every path of N vertices carries Le sum_{k<N} rho^k.

Without next-event estimation F is exactly rho at every vertex, so one path suffices for value and derivative
(Li 2020, the first pseudo code of `Li` and `d_Li`, which has no next-event estimation).
"""

import pytest
import torch

import torch_radbp as rb
from tests.adjoint.furnace import DEPTH, EMISSION, closed_form
from tests.gradients import EXACT, REPLAY, assert_informative, image_and_gradients, relative_error, z_score
from tests.scenes import furnace, parameters

NAMES = ("walls.bsdf.reflectance.value", "walls.emitter.radiance.value")
REFLECTANCES = {"bright": (0.3, 0.6, 0.9), "black_in_one_channel": (0.3, 0.0, 0.9)}


def check(reflectance, dtype, adjoint, tolerance):
    """Asserts value and derivatives of the mean image in every channel."""
    scene = furnace(reflectance, EMISSION, dtype)
    adj_image = torch.full((1, 3, 4, 4), 1 / 16, dtype=dtype)
    image, gradients = image_and_gradients(scene, NAMES, adj_image=adj_image, spp=1, max_depth=DEPTH, rr_depth=100,
                                           nee=False, adjoint=adjoint)
    L, d_rho, d_Le = closed_form(reflectance)
    assert_informative(L, [d_rho, d_Le])
    for value, expected in ((image, L[None, :, None, None]), *zip(gradients, (d_rho, d_Le))):
        error = ((value.double() - expected) / expected).abs().max()
        assert error < tolerance, f"relative error {error:.1e}"


@pytest.mark.parametrize("reflectance", REFLECTANCES.values(), ids=REFLECTANCES)
@pytest.mark.parametrize("adjoint", EXACT, ids=repr)
def test_value_and_gradient_are_exact_with_one_path_per_pixel(adjoint, reflectance):
    check(reflectance, torch.float64, adjoint, 1e-12)  # some tens of roundings of 1e-16


@pytest.mark.parametrize("reflectance", REFLECTANCES.values(), ids=REFLECTANCES)
@pytest.mark.parametrize("adjoint", EXACT, ids=repr)
def test_value_and_gradient_are_exact_in_single_precision(adjoint, reflectance):
    check(reflectance, torch.float32, adjoint, 4e-6)  # 9 bounces of a few roundings of 6e-8 each


@pytest.mark.parametrize("adjoint", REPLAY, ids=repr)
def test_path_replay_is_exact_where_nothing_is_black(adjoint):
    check(REFLECTANCES["bright"], torch.float64, adjoint, 1e-12)


@pytest.mark.parametrize("adjoint", REPLAY, ids=repr)
def test_path_replay_loses_the_gradient_at_zero_reflectance_and_says_so(adjoint):
    scene = furnace(REFLECTANCES["black_in_one_channel"])
    _, (gradient, _) = image_and_gradients(scene, NAMES, adj_image=torch.full((1, 3, 4, 4), 1 / 16, dtype=torch.float64),
                                           spp=1, max_depth=DEPTH, rr_depth=100, nee=False, adjoint=adjoint)
    _, expected, _ = closed_form(REFLECTANCES["black_in_one_channel"])
    torch.testing.assert_close(gradient[[0, 2]], expected[[0, 2]], rtol=1e-12, atol=0)
    assert expected[1] == 0.5 and gradient[1] == 0
    assert "reflectance of exactly 0" in type(adjoint).__doc__


@pytest.mark.parametrize("depth", [1, 2, 3])
def test_the_shortest_paths_are_right(depth):
    scene = furnace(size=2)
    image, gradients = image_and_gradients(scene, NAMES, adj_image=torch.full((1, 3, 2, 2), 1 / 4, dtype=torch.float64),
                                           spp=1, max_depth=depth, nee=False)
    L, d_rho, d_Le = closed_form((0.3, 0.6, 0.9), depth=depth)
    torch.testing.assert_close(image[0, :, 0, 0], L, rtol=1e-12, atol=0)
    torch.testing.assert_close(gradients[0], d_rho, rtol=1e-12, atol=0)
    torch.testing.assert_close(gradients[1], d_Le, rtol=1e-12, atol=0)


@pytest.mark.parametrize("settings", [{"nee": True}, {"nee": True, "rr_depth": 2}, {"nee": False, "rr_depth": 2}],
                         ids=["nee", "nee_and_roulette", "roulette"])
def test_next_event_estimation_and_roulette_keep_the_expectation(settings):
    reflectance, depth = (0.3, 0.0, 0.9), 5
    scene, runs = furnace(reflectance, size=16), 24
    adj_image = torch.full((1, 3, 16, 16), 1 / 256, dtype=torch.float64)
    wanted = parameters(scene, NAMES)
    renderer = rb.Renderer(scene, spp=4, max_depth=depth, **{"rr_depth": 100} | settings)
    rows = []
    for seed in range(runs):
        image = renderer(seed=seed)
        gradients = torch.autograd.grad(image, wanted, adj_image)
        rows.append(torch.stack([image.detach().mean((0, 2, 3)), *gradients]))
    expected = torch.stack(closed_form(reflectance, depth=depth))
    # 9 numbers, t-distributed with 23 degrees of freedom: beyond 5 by chance about 4 times in 10,000; the seeds are fixed.
    assert z_score(torch.stack(rows), expected) < 5
    # An estimator this precise would show a missing percent.
    assert relative_error(torch.stack(rows).mean(0), expected) < 0.02
