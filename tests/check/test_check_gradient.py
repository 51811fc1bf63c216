"""A right gradient agrees, wrong ones are found out, and what noise hides is said to be hidden."""

import pytest
import torch
from torch import nn
from torch.nn.utils import parametrize

import torch_radbp as rb
from tests.boundary.closed_forms import parallel
from tests.deep import deep
from tests.scenes import CASES, cornell, diffuse, load, rectangle, rgb, sensor, textured_lamp
from torch_radbp.check import gradient as check_module
from torch_radbp.check.gradient import checked_direction, checked_step, informative_cotangents
from torch_radbp.check.statistics import Cotangent, Estimates, compare, expected_square, tile_sums
from torch_radbp.rendering.jvp import DualImage

WHITE, SETTINGS = "white.reflectance.value", {"spp": 64, "max_depth": 4}
SHAPE = (1, 3, 16, 16)


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_a_right_gradient_agrees(dtype):
    scene = cornell(dtype, 12)
    result = rb.check_gradient(scene, WHITE, **SETTINGS | {"spp": 128})
    assert result.verdict == "agrees" and result.agrees, str(result)
    assert result.detectable < 0.05 and result.spp == 128 and result.comparison.z.shape == (1, 3, 12, 12)
    pixels, projections = result.comparison.pixels, result.comparison.projections
    assert 0.7 < pixels.mean_square_z < 1.4  # 432 values of t^2 with 15 to 30 degrees of freedom: 1.1 with deviation 0.1
    assert pixels.share_above_3 < 0.02 and pixels.max_z < 6 and 0 < pixels.mean_relative_error < 0.3
    assert [p.name for p in projections] == ["ones", "derivative image", "smooth random"]
    assert all(p.backward_error < (1e-12 if dtype == torch.float64 else 1e-5) for p in projections)
    assert not any(parameter.requires_grad or parameter.grad is not None for parameter in scene.parameters())


@pytest.mark.parametrize("name", ["floor.bsdf.reflectance.data", "wall.bsdf.reflectance.value"])
def test_bitmaps_and_other_settings_agree(name):
    result = rb.check_gradient(CASES["mirror_bilinear"].scene(), name, spp=128, max_depth=3, seed=2, nee=True,
                               adjoint=rb.MemoizedAdjoint("log"), batches=8)
    assert result.agrees, str(result)


def test_the_same_seed_gives_the_same_outcome():
    first, second, other = (rb.check_gradient(cornell(size=6), WHITE, spp=16, max_depth=3, seed=seed, batches=8).figures()
                            for seed in (1, 1, 2))
    assert first == second != other


def test_both_estimates_are_of_samples_of_their_own(monkeypatch):
    seeds = {"forward": [], "difference": []}
    for kind in seeds:
        method = getattr(check_module.Measurement, kind)

        def noted(self, number, kind=kind, method=method):
            seeds[kind].append(self.arguments(number)["seed"])
            return method(self, number)

        monkeypatch.setattr(check_module.Measurement, kind, noted)
    rb.check_gradient(cornell(size=4), WHITE, spp=8, max_depth=2, batches=8)
    assert len(seeds["forward"]) == 8 and len(seeds["difference"]) == 9
    assert len({*seeds["forward"], *seeds["difference"]}) == 17


def scaled(factor):
    """Forward mode whose derivative is wrong by a factor."""
    right = check_module.rendering_with_tangent

    def wrong(*arguments, **named):
        image, tangent = right(*arguments, **named)
        return DualImage(image, factor(tangent))

    return wrong


def backward_scaled(factor):
    right = check_module.Measurement.backward
    return lambda *arguments: [factor * value for value in right(*arguments)]


def test_a_derivative_that_is_a_tenth_too_small_is_biased(monkeypatch):
    monkeypatch.setattr(check_module, "rendering_with_tangent", scaled(lambda tangent: 0.9 * tangent))
    monkeypatch.setattr(check_module.Measurement, "backward", backward_scaled(0.9))
    result = rb.check_gradient(cornell(size=12), WHITE, **SETTINGS | {"spp": 256})
    assert result.verdict == "biased" and "derivative image" in result.explanation, str(result)
    assert not result.agrees
    assert abs(result.comparison.projections[1].relative_error + 0.1) < 0.03


def test_an_error_in_one_place_that_cancels_in_sum_is_biased(monkeypatch):
    def wrong(tangent):
        left, right = tangent.split(tangent.shape[-1] // 2, -1)
        return torch.cat([0.8 * left, right * (1 + 0.2 * left.sum() / right.sum())], -1)

    monkeypatch.setattr(check_module, "rendering_with_tangent", scaled(wrong))
    monkeypatch.setattr(check_module.Measurement, "backward",
                        lambda self, number, cotangents: [float((w * self.forward(number)[1]).sum()) for w in cotangents])
    result = rb.check_gradient(cornell(size=12), WHITE, **SETTINGS | {"spp": 256})
    assert result.verdict == "biased", str(result)
    tiles = result.comparison.tiles
    assert abs(result.comparison.projections[0].z) < 4 and tiles.mean_square_z > tiles.limit


def test_a_parameter_that_is_detached_on_its_way_is_biased():
    class HalfDetached(nn.Module):
        """The identity with half of its derivative."""

        def forward(self, x):
            return 0.5 * x + 0.5 * x.detach()

        def right_inverse(self, y):
            return y

    scene = cornell(size=8)
    parametrize.register_parametrization(scene.get_submodule("white.reflectance"), "value", HalfDetached())
    result = rb.check_gradient(scene, "white.reflectance.parametrizations.value.original", **SETTINGS)
    assert result.verdict == "biased" and abs(result.comparison.projections[1].relative_error + 0.5) < 0.1, str(result)


# The field of view is in degrees: in steps of 0.05 whether a jump is seen at 64 samples depends on the seed.
@pytest.mark.parametrize("name, step", [("light.to_world", 0.05), ("box.vertex_positions", 0.05), ("sensor.x_fov", 2.0)])
def test_a_derivative_without_what_moves_is_biased_probably_by_silhouettes(name, step, monkeypatch):
    """Forward mode says zero; differences see the thing move, whatever the renderer can differentiate."""
    monkeypatch.setattr(check_module, "rendering_with_tangent", scaled(lambda tangent: 0 * tangent))
    monkeypatch.setattr(check_module.Measurement, "backward", lambda self, number, cotangents: [0.0] * len(cotangents))
    scene = cornell(size=8)
    before = scene.get_parameter(name).clone()
    result = rb.check_gradient(scene, name, spp=32, max_depth=2, step=step, batches=8, terms=["interior", "primary"])
    assert result.verdict == "biased, probably by silhouettes", str(result)
    assert result.comparison.difference.abs().max() > 0
    assert f"The renderer leaves out a part: terms=('interior', 'primary') leaves out 'shadow'; derivatives with respect " \
           f"to `{name}` lack the contribution of the borders of shadows" in result.explanation
    assert torch.equal(scene.get_parameter(name), before)


def lamp(edge: float):
    """A square that shines, seen on pixels of width 1/4 whose borders are at multiples of that."""
    return load(camera=parallel(8), lamp=rectangle((0, 0, 0), edge, emitter={"type": "area"}))


ALONG_X = torch.zeros(4, 4)
ALONG_X[0, 3] = 1.0


@pytest.mark.parametrize("edge, direction", [(0.5, None), (0.4901, ALONG_X), deep(0.5, ALONG_X), deep(0.4901, None)],
                         ids=["on the border-random", "beside it-along x", "on the border-along x", "beside it-random"])
def test_an_edge_that_moves_over_the_border_of_pixels_is_no_silhouette_that_is_left_out(edge, direction):
    """Where it stands on the border, or within a step from it, differences are the mean of two derivatives."""
    result = rb.check_gradient(lamp(edge), "lamp.to_world", spp=512, max_depth=1, batches=16, direction=direction)
    assert result.verdict in ("agrees", "too noisy") and "silhouette" not in str(result), str(result)
    assert direction is None or result.comparison.projections[1].bend > 0 and "borders of pixels" in result.explanation


def test_of_an_error_that_nothing_explains_silhouettes_are_not_said(monkeypatch):
    monkeypatch.setattr(check_module, "rendering_with_tangent", scaled(lambda tangent: 0 * tangent))
    monkeypatch.setattr(check_module.Measurement, "backward", lambda self, number, cotangents: [0.0] * len(cotangents))
    result = rb.check_gradient(lamp(0.5), "lamp.to_world", spp=512, max_depth=1, batches=8)
    assert result.verdict == "biased" and "does not know of anything that it leaves out" in result.explanation


def test_terms_that_are_left_out_are_named():
    result = rb.check_gradient(lamp(0.45), "lamp.to_world", spp=128, max_depth=1, batches=8, terms=["interior"])
    assert result.verdict == "biased, probably by silhouettes", str(result)
    assert "The renderer leaves out a part: terms=('interior',) leaves out 'primary'; " \
           "terms=('interior',) leaves out 'shadow'; derivatives with" in result.explanation


@pytest.mark.parametrize("value, step, sides", [(0.0, None, "to one side"), (0.1, 0.3, "to one side"),
                                                (0.2, 0.1, "to both sides")])
def test_differences_do_not_leave_the_domain(value, step, sides):
    scene = load(sensor=sensor(4, (0.5, 0.2, 2)), sky={"type": "constant"},
                 wall=rectangle((0, 0, 0), bsdf=diffuse(value, value, value)))
    result = rb.check_gradient(scene, "wall.bsdf.reflectance.value", spp=32, max_depth=2, step=step, batches=8,
                               direction="ones")
    assert result.sides == sides and result.figures()["sides"] == sides and sides in str(result)
    assert result.verdict != "biased" and abs(result.comparison.projections[0].relative_error) < 0.03, str(result)


def test_forward_and_backward_that_differ_are_biased(monkeypatch):
    monkeypatch.setattr(check_module.Measurement, "backward", backward_scaled(1.001))
    result = rb.check_gradient(cornell(size=6), WHITE, spp=16, max_depth=3, batches=8)
    assert result.verdict == "biased" and "forward mode and the backward pass differ by 0.001" in result.explanation


def test_path_replay_at_zero_reflectance_is_biased():
    scene = cornell(size=6)
    scene.get_parameter(WHITE).data[0] = 0
    settings = {"spp": 32, "max_depth": 6, "rr_depth": 100, "direction": [1.0, 0.0, 0.0], "batches": 8}
    assert rb.check_gradient(scene, WHITE, adjoint=rb.ReplayAdjoint(), **settings).verdict == "biased"
    assert rb.check_gradient(scene, WHITE, **settings).verdict != "biased"


def test_few_samples_are_too_noisy_and_the_advice_is_about_right():
    few = rb.check_gradient(cornell(size=8), WHITE, spp=16, max_depth=4)
    assert few.verdict == "too noisy" and not few.agrees, str(few)
    times = int(few.explanation.split("use ")[1].split(" times")[0])
    assert f"(spp={times * 16})" in few.explanation and 1 < times < 100
    # A standard error of 16 batches is itself uncertain by a fifth, and the advice by its square.
    more = rb.check_gradient(cornell(size=8), WHITE, spp=2 * times * 16, max_depth=4)
    assert more.agrees, str(more)


def test_a_parameter_that_does_not_matter_tells_nothing():
    scene = load(sensor=sensor(4), wall=rectangle((0, 0, 0)), behind=rectangle((0, 0, 9)),
                 sky={"type": "constant", "radiance": rgb(1, 1, 1)})
    result = rb.check_gradient(scene, "behind.bsdf.reflectance.value", spp=8, max_depth=1, batches=8)
    assert result.verdict == "too noisy" and "zero everywhere" in result.explanation


def test_values_that_are_not_finite_are_biased(monkeypatch):
    def broken(tangent):
        tangent = tangent.clone()
        tangent[0, 0, 0, 0] = float("nan")
        return tangent

    monkeypatch.setattr(check_module, "rendering_with_tangent", scaled(broken))
    result = rb.check_gradient(cornell(size=4), WHITE, spp=16, max_depth=2, batches=8)
    assert result.verdict == "biased" and "8 values that are NaN" in result.explanation


def samples(error, noise=0.1, count=16, seed=0):
    """Estimates of a known derivative image, one of them off by `error`."""
    generator = torch.Generator().manual_seed(seed)
    truth = 1 + torch.linspace(0, 1, SHAPE[-1], dtype=torch.float64).expand(SHAPE)
    a, b = (truth + noise * torch.randn(count, *SHAPE, generator=generator, dtype=torch.float64) for _ in range(2))
    return Estimates(a, b + error, torch.zeros(SHAPE, dtype=torch.float64)), truth


def test_z_is_standard_normal_if_nothing_is_wrong():
    """1000 images: the mean square of z is that of Student's t to 1%, between its degrees of freedom 15 and 30."""
    ones = [Cotangent("ones", torch.ones(SHAPE, dtype=torch.float64))]
    squares, projected, over = [], [], 0
    for seed in range(300):
        drawn, _ = samples(0.0, seed=seed)
        result = compare(drawn, ones, [0.0], 1e-16)
        squares.append(result.pixels.mean_square_z)
        projected.append(result.projections[0].z)
        over += result.tiles.mean_square_z > result.tiles.limit
    mean = sum(squares) / len(squares)
    assert 30 / 28 - 0.01 < mean < expected_square(16)
    assert 0.8 < torch.tensor(projected).square().mean() < 1.45  # 300 values of t^2: 1.1 with deviation 0.1
    assert over == 0


def test_a_bias_is_measured_without_the_noise():
    _, truth = samples(0.0)
    drawn, _ = samples(0.1 * truth)
    result = compare(drawn, [Cotangent("ones", torch.ones_like(truth))], [0.0], 1e-16)
    assert abs(result.projections[0].relative_error - 0.1) < 0.003
    assert abs(result.tiles.relative_bias - 0.1) < 0.003
    assert result.tiles.mean_square_z > result.tiles.limit
    few = compare(samples(0.0, noise=1.0)[0], [], [], 1e-16)
    assert few.tiles.relative_bias < 0.03  # the noise of a tile is 0.12 of it


def test_one_tile_of_fireflies_does_not_drown_a_bias_of_the_others():
    _, truth = samples(0.0)
    drawn, _ = samples(0.1 * truth)
    drawn.difference[0, 0, 0, 0, 0] = 1e5  # one bright path in one batch
    result = compare(drawn, [], [], 1e-16)
    assert result.tiles.mean_square_z > result.tiles.limit and abs(result.tiles.relative_bias - 0.1) < 0.003


@pytest.mark.parametrize("events", [0.1, 0.7, 3.0, 20.0])
def test_rare_samples_that_make_a_part_of_the_differences_are_no_bias(events):
    """`events` to a tile, over all batches; most tiles have none, or one, and forward mode has their mean everywhere."""
    over = 0
    for seed in range(20):
        drawn, truth = samples(0.0, seed=seed)
        chance = events * 64 / (truth.numel() * len(drawn.difference))
        rare = torch.rand(drawn.difference.shape, generator=torch.Generator().manual_seed(seed)) < chance
        spiked = drawn._replace(difference=drawn.difference + 10.0 * rare, jvp=drawn.jvp + 10.0 * chance)
        tiles = compare(spiked, [], [], 1e-16).tiles
        over += tiles.mean_square_z > tiles.limit
        wrong = truth * torch.linspace(-1, 1, SHAPE[-1])
        biased = compare(spiked._replace(jvp=spiked.jvp + wrong), [], [], 1e-16).tiles
        assert biased.mean_square_z > biased.limit
    assert over <= 1


def test_a_bias_in_few_pixels_is_said_to_be_concentrated():
    error = torch.zeros(SHAPE, dtype=torch.float64)
    error[..., 3:5, 7] = 5.0
    assert compare(samples(error)[0], [], [], 1e-16).pixels.concentration < 0.01
    assert compare(samples(0.5)[0], [], [], 1e-16).pixels.concentration > 0.3


def test_images_without_noise_are_compared_to_rounding():
    truth = torch.ones(SHAPE, dtype=torch.float64)
    exact = Estimates(truth.expand(16, *SHAPE), truth.expand(16, *SHAPE) + 1e-13, 1e-12 * truth)
    result = compare(exact, [Cotangent("ones", truth)], [768.0], 1e-16)
    assert result.pixels.max_z < 1 and abs(result.projections[0].z) < 4
    unequal = compare(exact._replace(rounding=0 * truth), [], [], 1e-16)
    assert unequal.pixels.max_z == float("inf")


@pytest.mark.parametrize("shape", [(2, 3, 5, 19), (1, 3, 64, 40), (1, 3, 1, 1)])
def test_tiles_cover_the_image(shape):
    images = torch.randn(4, *shape, dtype=torch.float64)
    sums = tile_sums(images)
    assert sums.shape == (4, shape[0] * min(8, shape[2]) * min(8, shape[3]))
    torch.testing.assert_close(sums.sum(1), images.flatten(1).sum(1))


def test_cotangents_are_bounded_and_differ():
    reference = torch.randn(2, 3, 9, 11, dtype=torch.float64)
    reference[0, 0, 0, 0] = 1e6  # one bright pixel
    ones, own, smooth = (cotangent.image for cotangent in informative_cotangents(reference, 0))
    assert own.abs().max() < 1 and torch.equal(own.sign(), reference.sign()) and smooth.std() > 0.3
    assert torch.equal(informative_cotangents(0 * reference, 0)[1].image, 0 * reference)
    assert ones.shape == smooth.shape == reference.shape


def test_directions_and_steps():
    parameter = torch.tensor([0.2, -0.8, 0.0])
    d = checked_direction("p", parameter, None)
    assert d.dtype == torch.float32 and d.min() >= 0.5 and d.max() <= 1.5 and len(d.unique()) == 3
    assert torch.equal(checked_direction("p", parameter, "ones"), torch.ones(3))
    assert torch.equal(checked_direction("p", torch.tensor(3.0), None), torch.tensor(1.0))
    assert not checked_direction("p", torch.eye(4), "random")[3].any()
    assert checked_step(parameter, 2 * torch.ones(3), None) == pytest.approx(0.008)
    assert checked_step(torch.zeros(3), torch.ones(3), None) == pytest.approx(0.02)
    assert checked_step(parameter, torch.ones(3), 0.5) == 0.5


def test_progress_is_told_to_the_end():
    told = []
    rb.check_gradient(textured_lamp(), "sky.radiance.value", spp=8, max_depth=2, batches=8,
                      progress=lambda done, total: told.append((done, total)))
    assert told[-1] == (37, 37) and [done for done, _ in told] == sorted(done for done, _ in told)


BAD = {
    "name": (AttributeError, "whit.reflectance.value", {}, "did you mean 'white.reflectance.value'"),
    "direction": (ValueError, WHITE, {"direction": [1.0, 0.0]}, r"direction of .* must have shape \(3,\), got \(2,\)"),
    "zero direction": (ValueError, WHITE, {"direction": [0, 0, 0]}, "must not be zero everywhere"),
    "word": (ValueError, WHITE, {"direction": "up"}, "'random' or 'ones' or an array"),
    "step": (ValueError, WHITE, {"step": 0.0}, "step must be greater than 0"),
    "step out of the domain": (ValueError, WHITE, {"step": 1e7}, f"differences of '{WHITE}' by steps of 1e.07 along this "
                               "direction leave its domain to both sides; give a smaller step .parameter .* must be"),
    "batches": (ValueError, WHITE, {"batches": 4}, "at least 8"),
    "spp": (ValueError, WHITE, {"spp": 0}, "spp must be an integer of at least 1"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_argument_is_an_error_that_says_what_to_do(case):
    error, name, arguments, message = BAD[case]
    with pytest.raises(error, match=message):
        rb.check_gradient(cornell(size=2), name, **{"max_depth": 2} | arguments)


def test_figures_and_text():
    result = rb.check_gradient(cornell(size=4), WHITE, spp=16, max_depth=2, batches=8)
    figures = result.figures()
    assert figures["parameter"] == WHITE and figures["projections"][0]["name"] == "ones"
    assert {"mean_square_z", "share_above_3", "max_z", "mean_relative_error"} <= figures["pixels"].keys()
    text = str(result)
    assert result.verdict in text.splitlines()[-1] and "VJP-JVP" in text and WHITE in text
