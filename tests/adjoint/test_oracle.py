"""Every strategy against plain autograd through the whole loop (`TapeAdjoint`), in float64."""

import pytest
import torch

import torch_radbp as rb
from tests.deep import deep
from tests.gradients import MEMOIZED, QUADRATIC, REPLAY, SOME, assert_informative, image_and_gradients, relative_error
from tests.scenes import CASES, load, rectangle, rgb, sensor

TOLERANCE = 1e-10  # hundreds of lanes, each some hundred roundings of 1e-16
ALL = (*MEMOIZED, *QUADRATIC, *REPLAY)  # nothing is black in these scenes, so that path replay is right too
SETTINGS = {
    "nee": {"nee": True, "rr_depth": 100},
    "nee_and_roulette": {"nee": True, "rr_depth": 1, "spp": 4},
    # Light is found by chance here; two bounces off the lamp's own material need more paths.
    "no_nee": {"nee": False, "rr_depth": 100, "spp": 16},
    "no_nee_and_roulette": {"nee": False, "rr_depth": 2, "spp": 256},
    "hide_emitters": {"nee": True, "rr_depth": 3, "hide_emitters": True, "spp": 16},
}
FEW = (rb.MemoizedAdjoint(), rb.MemoizedAdjoint(3, keep_hits=False), rb.MemoizedAdjoint("log"), rb.QuadraticAdjoint())


def assert_all_agree(case, strategies, compile=True, **settings):
    """Asserts that image and gradients of every strategy are those of the tape, which is eager."""
    settings = {"spp": 2, "max_depth": 6, "compile": compile} | settings
    reference, expected = image_and_gradients(case.scene(), case.parameters, adjoint=rb.TapeAdjoint(), **settings)
    assert_informative(reference, expected)
    for adjoint in strategies:
        image, gradients = image_and_gradients(case.scene(), case.parameters, adjoint=adjoint, **settings)
        assert relative_error(image, reference) < TOLERANCE if compile else torch.equal(image, reference), adjoint
        for name, gradient, wanted in zip(case.parameters, gradients, expected):
            error = relative_error(gradient, wanted)
            assert error < TOLERANCE, f"{adjoint}, {name}: relative error {error:.1e}"


def called(part: object) -> str:
    return part if isinstance(part, str) else "compiled" if part is True else "eager" if part is False else \
        "all" if part is ALL else "some"


@pytest.mark.parametrize("compile, integrand, strategies", [
    (True, "nee_and_roulette", ALL), (False, "nee_and_roulette", ALL), (False, "no_nee_and_roulette", SOME),
    *((True, integrand, SOME) for integrand in SETTINGS if integrand != "nee_and_roulette"),
    *(deep(compile, integrand, ALL) for compile in (False, True) for integrand in SETTINGS
      if integrand != "nee_and_roulette")], ids=called)
def test_every_strategy_gives_the_gradient_of_the_tape_in_the_cornell_box(compile, integrand, strategies):
    assert_all_agree(CASES["cornell"], strategies, compile, **SETTINGS[integrand])


ACROSS = {"repeat_bilinear", "mirror_nearest", "clamp_trilinear"}  # every way to wrap and to filter once
OTHERS = [name for name in CASES if name != "cornell"]
QUICK = [name for name in OTHERS if name in ACROSS or CASES[name].build is not CASES["repeat_bilinear"].build]


@pytest.mark.parametrize("compile, name, strategies", [
    *((True, name, SOME) for name in QUICK), *((False, name, SOME) for name in QUICK[::2]),
    *(deep(compile, name, ALL) for compile in (False, True) for name in OTHERS)], ids=called)
def test_every_strategy_gives_the_gradient_of_the_tape_with(compile, name, strategies):
    assert_all_agree(CASES[name], strategies, compile, max_depth=4, rr_depth=2)


@pytest.mark.parametrize("name, integrand", [
    (name, integrand) if (place + number) % 2 == 0 else deep(name, integrand) for number, integrand in enumerate(SETTINGS)
    for place, name in enumerate(("two_sided", "textured_lamp", "sky_and_points"))])
def test_the_integrand_does_not_matter_with(name, integrand):
    # Without next-event estimation nothing finds a point light: the next test.
    case, settings = CASES[name], SETTINGS[integrand]
    if name == "sky_and_points" and not settings["nee"]:
        case = case._replace(parameters=tuple(p for p in case.parameters if not p.endswith("intensity.value")))
    assert_all_agree(case, FEW, max_depth=4, **settings)


def test_without_next_event_estimation_a_point_light_has_no_gradient():
    scene = CASES["sky_and_points"].scene()
    _, (gradient,) = image_and_gradients(scene, ["lamp.intensity.value"], nee=False, max_depth=3, spp=1)
    assert torch.equal(gradient, torch.zeros(3, dtype=torch.float64))


@pytest.mark.parametrize("stride", [1, 4, "sqrt", "log"])
def test_unlimited_depth_gives_the_gradient_of_the_tape(stride):
    assert_all_agree(CASES["cornell"], [rb.MemoizedAdjoint(stride)], max_depth=-1, rr_depth=1, spp=4)


@pytest.mark.parametrize("kept", [1, 2, 3])
def test_a_subset_of_the_parameters_has_the_same_gradients(kept):
    case = CASES["textured_lamp"]
    image, everything = image_and_gradients(case.scene(), case.parameters, spp=2, max_depth=4)
    assert_informative(image, everything)
    for first in range(len(case.parameters) - kept + 1):
        chosen = slice(first, first + kept)
        _, some = image_and_gradients(case.scene(), case.parameters[chosen], spp=2, max_depth=4)
        for gradient, expected in zip(some, everything[chosen]):
            assert relative_error(gradient, expected) < 1e-14


def test_a_lamp_that_is_passed_through_when_emitters_are_hidden_shows_what_is_behind():
    def scene(with_lamp):
        lamp = rectangle((0, 0, 0.5), 0.5, emitter={"type": "area", "radiance": rgb(5, 5, 5), "sampling_weight": 1e-6})
        return load(sensor=sensor(6, (0, 0, 3)), poster=rectangle((0, 0, 0)),
                    sky={"type": "constant", "radiance": rgb(1, 2, 3)}, **({"lamp": lamp} if with_lamp else {}))

    settings = {"spp": 1, "max_depth": 1, "nee": False}
    behind = rb.render(scene(False), hide_emitters=True, **settings)
    assert torch.equal(rb.render(scene(True), hide_emitters=True, **settings), behind)
    assert torch.equal(behind, torch.zeros_like(behind))  # depth 1: emission, all of it hidden
    assert rb.render(scene(True), **settings)[0, 0, 3, 3] == 5
    # One bounce later the poster is lit, seen through the back of nothing.
    assert rb.render(scene(True), hide_emitters=True, spp=4, max_depth=2, nee=False)[0, :, 3, 3].min() > 0
