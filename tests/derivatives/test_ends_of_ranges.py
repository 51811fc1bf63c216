"""At the ends of the ranges of parameters, and just outside, an image does not depend on what requires a gradient.

Renderings tolerate 2 % outside (`Domain.check_range`). What a frozen copy shows there is what the optimizer has seen.
"""

import functools
import math

import pytest
import torch
from torch import Tensor

from tests.gradients import unwarned_renderer
from tests.scenes import diffuse, load, rectangle, rgb, sensor
from tests.scenes.every_plugin import build
from tests.scenes.everything import objects
from tests.scenes.pairs import registered
from tests.scenes.quiet import Example, examples
from torch_radbp.check.stencil import domains_of
from torch_radbp.plugin.domain import LARGEST_COORDINATE

OUT = 0.01  # how far outside, as a share of the greatest number in the range, or of those that the parameter has
# At the lower end, and at the upper one for the first two, a part is left out of a material unless its derivative is wanted:
# for less noise or cost, and with other samples of what is left. So there images are equal in expectation only.
ABSENT = {"bsdf blendbsdf: weight", "bsdf mask: opacity", "bsdf principled: anisotropic", "bsdf principled: clearcoat",
          "bsdf principled: spec_trans", "bsdf principledthin: anisotropic", "bsdf principledthin: diff_trans",
          "bsdf principledthin: spec_trans"}
BOTH_ABSENT = {"bsdf blendbsdf: weight", "bsdf mask: opacity"}
EXAMPLES = {str(pair): example for pair, example in examples().items()}
SPP, BATCHES = 256, 8
DEEP = [pytest.mark.deep]
LINEAR = {"weight": {"type": "blendbsdf", "weight": 0.5, "first": diffuse(0.2, 0.2, 0.2), "second": {"type": "conductor"}},
          "opacity": {"type": "mask", "nested": diffuse(0.2, 0.2, 0.2)}}


def rendered(example: Example, value: Tensor, wanted: bool, seed: int = 3, batches: int = 1, **settings) -> Tensor:
    """Images that see the same, with the value of a parameter, whose derivative is wanted, or is not."""
    scene = build(example.scene, **{f"sensor_{number}": objects(example.scene)["sensor"] for number in range(1, batches)})
    parameter = scene.get_parameter(example.parameter)
    parameter.data.copy_(value)
    parameter.requires_grad_(wanted)
    return unwarned_renderer(scene, **{"spp": 8, "max_depth": 4, "compile": False} | settings)(seed=seed).detach()


@functools.cache
def ends_of(example: Example) -> tuple[Tensor, dict[str, float], float]:
    """A parameter, the ends of its range that it can have, and the greatest number that is allowed."""
    scene = build(example.scene)
    parameter = scene.get_parameter(example.parameter)
    domains = domains_of(scene, parameter)
    low, high = max([d.low for d in domains], default=-math.inf), min([d.high for d in domains], default=math.inf)
    found = {"low": low} if all(d.low_is_in for d in domains) else {}
    found |= {"high": high} if all(d.high_is_in for d in domains) else {}
    return parameter.detach(), {end: value for end, value in found.items() if abs(value) < LARGEST_COORDINATE}, high


def beyond(example: Example, end: str) -> Tensor | None:
    """The parameter just outside of an end; where the range has only one, its least entry, beside the others."""
    value, ends, high = ends_of(example)
    if high < math.inf:
        return torch.full_like(value, ends[end] + OUT * high * (1 if end == "high" else -1))
    if value.numel() == 1:
        return None  # it must not leave the range
    place = value.argmin()
    return value.flatten().index_fill(0, place, ends[end] - OUT * float(value.abs().max())).view_as(value)


def cases() -> list:
    """Parameters with the ends of their ranges, each example once; quick are those of `ABSENT`, and every eighth."""
    found = {}
    for pair in map(str, sorted(registered())):
        if pair not in EXAMPLES:
            continue  # test_every_parameter.py names it
        example = EXAMPLES[pair]
        for end in ends_of(example)[1]:
            found.setdefault((example, end), pair)
    return [pytest.param(example, end, pair, id=f"{pair}, {end}", marks=[] if pair in ABSENT or place % 8 == 0 else DEEP)
            for place, ((example, end), pair) in enumerate(found.items())]


CASES = cases()


@pytest.mark.parametrize("example, end, pair", CASES)
def test_just_outside_an_image_is_the_same_whether_its_parameter_is_differentiated(example, end, pair):
    """Bit by bit."""
    value = beyond(example, end)
    if value is None:
        with pytest.raises(ValueError, match="must be at least"):
            rendered(example, torch.full_like(ends_of(example)[0], -OUT), wanted=False)
        return
    frozen, wanted = (rendered(example, value, wanted) for wanted in (False, True))
    assert torch.isfinite(frozen).all() and frozen.abs().max() > 0
    assert torch.equal(frozen, wanted)


@pytest.mark.parametrize("example, end, pair", CASES)
def test_at_the_end_too(example, end, pair):
    """Bit by bit, or in expectation where a part of the material is absent. |z| < 5 with 14 degrees of freedom: 2e-4."""
    value = torch.full_like(ends_of(example)[0], ends_of(example)[1][end])
    if pair not in ABSENT or (end == "high" and pair not in BOTH_ABSENT):
        assert torch.equal(*(rendered(example, value, wanted) for wanted in (False, True)))
        return
    means = [rendered(example, value, wanted, seed, BATCHES, spp=SPP).mean((1, 2, 3))
             for wanted, seed in ((False, 0), (True, 1))]
    error = (sum(mean.var() for mean in means) / BATCHES).sqrt()
    assert error < 0.01 * means[0].mean().abs()
    assert (means[0].mean() - means[1].mean()).abs() < 5 * error


@pytest.mark.parametrize("compile", [False, True], ids=["eager", "compiled"])
@pytest.mark.parametrize("name", LINEAR)
def test_weights_just_outside_continue_the_line_between_the_materials(name, compile):
    """Light that is scattered once is linear in the weight: so differences over an end are derivatives.

    Furnaces of .2 and 1: of the light .2 + .8 w arrives. Noise: a material is sampled by at least .02 of 65,536 samples.
    """
    scene = load(torch.float64, camera=sensor(4, fov=20), sky={"type": "constant", "radiance": rgb(1, 1, 1)},
                 plane=rectangle((0, 0, 0), 3.0, (0.3, 1, 0.2), 25, bsdf=LINEAR[name]))
    parameter = scene.get_parameter(f"plane.bsdf.{name}.value")
    renderer = unwarned_renderer(scene, spp=4096, max_depth=3, compile=compile)
    first, second = (0.2, 1.0) if name == "weight" else (1.0, 0.2)
    for weight in (-0.02, -0.01, 0.0, 1.0, 1.01, 1.02):
        for wanted in (False, True):
            parameter.requires_grad_(False).fill_(weight).requires_grad_(wanted)
            expected = first + (second - first) * weight
            assert float(renderer(seed=2).detach().mean()) == pytest.approx(expected, abs=2e-3), (weight, wanted)


def test_a_frozen_copy_of_what_overshot_shows_the_same():
    """A compiled one, as the optimizer's was."""
    example = EXAMPLES["bsdf blendbsdf: weight"]
    for end in ("low", "high"):
        images = [rendered(example, beyond(example, end), wanted, compile=True) for wanted in (False, True)]
        torch.testing.assert_close(*images, rtol=1e-9, atol=0)  # functions that are compiled apart round apart
