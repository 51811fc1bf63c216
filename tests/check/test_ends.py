"""At the ends of ranges right gradients are not called biased, wrong ones are, and no image is rendered outside."""

import pytest
import torch

import torch_radbp as rb
from tests.check.ends import ENDS, SEEDS, check, is_wrong
from tests.deep import deep, deep_but
from tests.scenes import diffuse, load, rectangle, rgb, sensor
from tests.scenes.quiet import quiet
from torch_radbp.check import gradient as check_module
from torch_radbp.check.stencil import ROUNDING

QUICK = (("blend of diffuse and metal", False), ("mask", True))
DEEP = [pytest.mark.deep]


def rows(*quick: tuple[str, bool]) -> list:
    """Every parameter at both ends, all deep but some."""
    return [pytest.param(name, high, id=f"{name}, {'high' if high else 'low'}", marks=[] if (name, high) in quick else DEEP)
            for name in ENDS for high in (False, True)]


GLOSS = ENDS["principled clearcoat_gloss"]
OPACITY = "plane.bsdf.opacity.data"


@pytest.mark.parametrize("name, high", rows(*QUICK))
def test_a_right_derivative_at_an_end_is_not_biased(name, high):
    for seed in range(SEEDS if (name, high) not in QUICK else 1):
        result = check(ENDS[name], high, seed)
        assert result.sides == "to one side"
        assert result.verdict in ("agrees", "too noisy") or (result.verdict, high) == ("at a floor", False), str(result)
        assert "roughness" in name or "sunsky" in name or result.agrees, str(result)


@pytest.mark.parametrize("name, high", rows(QUICK[0]))
def test_a_wrong_derivative_at_an_end_is_biased(name, high, monkeypatch):
    """By a quarter; but at the floor of a roughness, where nothing can be said, and where the sun makes noise."""
    forward, backward = is_wrong()
    monkeypatch.setattr(check_module, "rendering_with_tangent", forward)
    monkeypatch.setattr(check_module.Measurement, "backward", backward)
    verdict = check(ENDS[name], high, 1).verdict
    assert verdict == "biased" or ("roughness" in name and verdict == "at a floor") or ("sunsky" in name and not high)


def holes(*values: float) -> rb.Scene:
    """A mask whose opacity is an image of one row."""
    image = {"type": "bitmap", "data": torch.tensor(values).expand(3, 1, -1).permute(1, 2, 0), "raw": True}
    return load(torch.float64, camera=sensor(4), sky={"type": "constant", "radiance": rgb(1, 0.8, 0.6)}, plane=rectangle(
        (0, 0, 0), 2.0, (0.3, 1, 0.2), 25, bsdf={"type": "mask", "opacity": image, "nested": diffuse(0.2, 0.2, 0.2)}))


@pytest.mark.parametrize("values", [(0.01, 0.005), (0.0, 1.0), *map(deep, [
    (1.0, 1.0), (0.0, 0.0), (0.995, 0.5), (0.99, 0.005)])])
def test_no_image_is_rendered_outside_of_the_range(values, monkeypatch):
    """With entries at both ends, too, of which those above go down."""
    seen, call = [], check_module.functional_call

    def noted(module, parameters, **arguments):
        seen.append(parameters[f"scene.{OPACITY}"].detach())
        return call(module, parameters, **arguments)

    monkeypatch.setattr(check_module, "functional_call", noted)
    result = rb.check_gradient(holes(*values), OPACITY, spp=4096, max_depth=3, batches=8, compile=False)
    assert len({float(value.flatten()[0]) for value in seen}) == 3
    assert torch.stack(seen).min() > -2 * ROUNDING and torch.stack(seen).max() < 1 + 2 * ROUNDING
    assert result.verdict in ("agrees", "too noisy"), str(result)


def test_a_direction_that_leaves_the_range_at_both_ends_is_an_error():
    with pytest.raises(ValueError, match="leave its domain to both sides; give another direction, which leads into it"):
        rb.check_gradient(holes(0.0, 1.0), OPACITY, direction=torch.ones(1, 2, 3), spp=8, compile=False)


def test_a_parameter_that_is_just_outside_already_is_checked_there():
    scene = holes(1.0, 0.5)
    opacity = scene.get_parameter(OPACITY)
    opacity.data[0, 0] = 1.01
    result = rb.check_gradient(scene, OPACITY, spp=4096, max_depth=3, batches=8, compile=False)
    assert result.verdict in ("agrees", "too noisy")
    opacity.data.add_(0.1)
    with pytest.raises(ValueError, match="must be in .0, 1., got 1.11"):
        rb.check_gradient(scene, OPACITY, spp=8, compile=False)


def test_a_step_over_which_the_image_bends_is_said_to_be_too_large():
    """The clear coat's brightness has half of its derivative 0.04 from the end; steps that are chosen get finer."""
    result = check(GLOSS, True, 0, step=0.04, batches=8)
    assert result.verdict == "too large a step" and not result.agrees, str(result)
    step = float(result.explanation.partition("(step=")[2].rstrip(")"))
    assert step == pytest.approx(0.005)
    chosen = check(GLOSS, True, 0, batches=8)
    assert chosen.agrees and chosen.step < 0.02 / 8 * 1.001


@pytest.mark.deep
def test_where_the_image_bends_an_eighth_of_the_step_that_is_advised_agrees():
    assert check(GLOSS, True, 0, step=0.005 / 8, batches=8).agrees


@pytest.mark.parametrize("factor, step", [(1.5, 0.002), *map(deep, (0.7, 0.7, 1.5), (0.002, None, None))])
def test_a_step_is_not_blamed_for_a_wrong_derivative(factor, step, monkeypatch):
    """By a step of 0.002 differences are off by 1 %, and an error of the derivative does not shrink with it."""
    forward, backward = is_wrong(factor)
    monkeypatch.setattr(check_module, "rendering_with_tangent", forward)
    monkeypatch.setattr(check_module.Measurement, "backward", backward)
    assert check(GLOSS, True, 0, step=step, batches=8).verdict == "biased"


@pytest.mark.parametrize("name", ["rough metal ggx", *deep_but([], ["rough glass ggx", "rough plastic ggx"])])
def test_a_roughness_below_its_floor_is_not_compared_and_at_it_agrees(name):
    """Values below 1e-4 count as that, with its derivative (`tests/bsdf/test_floor.py`), which differences do not show."""
    scene = quiet(name, 1)
    alpha = next(key for key, _ in scene.named_parameters() if ".alpha" in key)
    verdicts = []
    for value in (0.0, 1e-4):
        with torch.no_grad():
            scene.get_parameter(alpha).fill_(value)
        verdicts.append(rb.check_gradient(scene, alpha, spp=256, max_depth=3, batches=8, compile=False).verdict)
    assert verdicts == ["at a floor", "agrees"]
