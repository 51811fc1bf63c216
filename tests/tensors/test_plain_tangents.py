"""Tangents of stages in plain torch are those of torch, and none of them is computed by functions in Python."""

import sys
from operator import add, mul, sub, truediv

import pytest
import torch
from torch.autograd import forward_ad

import torch_radbp as rb
from tests.scenes import cornell
from torch_radbp.tensors.plain_tangents import PlainTangents

OPERATORS = add, sub, mul, truediv
FUNCTIONS = (*OPERATORS, torch.add, torch.sub, torch.mul, torch.div, torch.maximum, torch.minimum, torch.atan2, torch.hypot)
STILL = {"as many": torch.tensor([0.3, -0.7, 1.1]), "other dimensions": torch.tensor([[0.6], [1.3]]),
         "one": torch.tensor(0.4, dtype=torch.float64), "whole": torch.tensor([2, -3, 1])}


def assert_as_of_torch(function, *operands) -> None:
    """Value and tangent of a function are the same in `PlainTangents`; None: what moves."""
    with torch.no_grad(), forward_ad.dual_level():
        moving = forward_ad.make_dual(torch.tensor([0.9, -0.4, 0.5]), torch.tensor([0.2, 0.6, -0.3]))
        operands = [moving if part is None else part for part in operands]
        expected = forward_ad.unpack_dual(function(*operands))
        with PlainTangents():
            found = forward_ad.unpack_dual(function(*operands))
        assert torch.equal(found.primal, expected.primal) and found.primal.dtype == expected.primal.dtype
        assert expected.tangent.any()
        torch.testing.assert_close(found.tangent, expected.tangent, rtol=1e-6, atol=0)


@pytest.mark.parametrize("function", FUNCTIONS, ids=lambda function: f"{function.__module__}.{function.__name__}")
def test_values_and_tangents_are_those_of_torch(function):
    """Whichever operand moves."""
    for still in (*STILL.values(), *([0.8] if function in OPERATORS else [])):
        assert_as_of_torch(function, None, still)
        assert_as_of_torch(function, still, None)


def test_what_is_written_into_a_sum_does_not_change_what_it_was_made_of():
    with torch.no_grad(), forward_ad.dual_level(), PlainTangents():
        moving = forward_ad.make_dual(torch.ones(3), torch.ones(3))
        total = moving + 1.0
        total += moving
        assert torch.equal(forward_ad.unpack_dual(moving).tangent, torch.ones(3))
        assert torch.equal(forward_ad.unpack_dual(total).tangent, torch.full((3,), 2.0))


def test_stages_compute_no_tangent_by_functions_in_python():
    called = []

    def noted(frame, event, argument):
        if event == "call" and "_refs" in frame.f_code.co_filename:
            called.append(frame.f_back.f_code.co_name)

    scene = cornell(size=2)
    tangents = {name: torch.ones_like(scene.get_parameter(name))
                for name in ("white.reflectance.value", "box.vertex_positions")}
    sys.setprofile(noted)
    try:
        image = rb.jvp(scene, tangents, spp=2, max_depth=3, terms=("interior",), compile=False)
    finally:
        sys.setprofile(None)
    assert image.abs().max() > 0 and len(called) < 100, len(called)
