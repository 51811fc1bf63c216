"""The set-ups by which Mitsuba tests its projective integrators, at its own samples, within its own thresholds.

Mitsuba's own tests leave out "self shadowing" and "ball over a glossy floor" for these integrators, and five of the others
are commented out there. Its cotangents are all ones, for which the derivative of half of the set-ups is 0: here they are
derivative images, by differences whose samples are not those that they are compared with.
"""

from __future__ import annotations

import pytest
import torch

import torch_radbp as rb
from tests.deep import deep_but
from tests.scenes.projective_setups import SET_UPS, Errors, SetUp, difference

pytestmark = pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning")

STEP, SPP = 0.003, 1024  # of a difference
PASSES = {"ball over a glossy floor": 4, "occluder": 16}  # of each half of the reference, if not two
# Of which the largest error of a pixel is not judged: where a wall stands on a floor, edges come as near to vertices of
# paths as one likes, and single samples of what these hide are large, anywhere along the foot: of five seeds the largest
# error of a pixel is .41, 1.03, .89, .46 and .37, over a reference of 32 passes a half.
ENDS = ("self shadowing",)
QUICK = ("camera",)


def halves_of_reference(name: str) -> list[torch.Tensor]:
    """Two independent differences, finite and not zero."""
    passes = PASSES.get(name, 2)
    found = [sum(difference(SET_UPS[name], STEP, SPP, 100 + half * passes + number) for number in range(passes)) / passes
             for half in range(2)]
    assert all(half.isfinite().all() and half.abs().max() > 0 for half in found)
    return found


def derivative_of_loss(set_up: SetUp, cotangent: torch.Tensor) -> float:
    """By the backward pass, along what moves."""
    scene = set_up.build()
    values = [scene.get_parameter(name).requires_grad_() for name in set_up.names]
    image = rb.render(scene, spp=set_up.spp_backward, seed=1, max_depth=set_up.max_depth)
    gradients = torch.autograd.grad((image * cotangent).sum(), values)
    tangents = set_up.tangents(scene).values()
    return float(sum((gradient.double() * tangent.double()).sum() for gradient, tangent in zip(gradients, tangents)))


@pytest.mark.parametrize("name", deep_but(QUICK, list(SET_UPS)))
def test_derivatives_are_as_close_to_differences_as_mitsuba_asks(name):
    set_up, (one, other) = SET_UPS[name], halves_of_reference(name)
    scene = set_up.build()
    image = rb.jvp(scene, set_up.tangents(scene), spp=set_up.spp, seed=0, max_depth=set_up.max_depth)
    errors = Errors.of(image, (one + other) / 2)
    assert errors.mean <= set_up.bounds.mean and (name in ENDS or errors.most <= set_up.bounds.most), errors
    expected = float((one.double() * other.double()).sum())
    found = derivative_of_loss(set_up, one)
    assert expected > 0 and abs(found - expected) <= set_up.bounds.backward * expected, (found, expected)
