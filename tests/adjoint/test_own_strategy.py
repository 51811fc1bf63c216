"""A strategy of one's own is a class derived from `AdjointStrategy`, and nothing else has to know it."""

from dataclasses import dataclass

import pytest
import torch

import torch_radbp as rb
from tests.gradients import assert_informative, image_and_gradients
from tests.scenes import CASES


@dataclass(frozen=True)
class KeepsEverything(rb.AdjointStrategy):
    """Keeps the state of every bounce."""

    def kept(self, bounces, most):
        return tuple(range(bounces))

    def replayed(self, reaching, kept, moving):
        return 0.0

    def backward(self, sweep):
        for depth in reversed(range(sweep.record.bounces)):
            sweep.adjoint(sweep.record.states[depth], depth)


@pytest.mark.parametrize("compile", [False, True])
def test_a_strategy_of_ones_own_gives_the_gradients_of_the_others(compile):
    case = CASES["textured_lamp"]

    def results(adjoint):
        return image_and_gradients(case.scene(), case.parameters, adjoint=adjoint, spp=4, max_depth=4, compile=compile)

    image, expected = results(rb.MemoizedAdjoint())
    found, gradients = results(KeepsEverything())
    assert_informative(image, expected)
    assert torch.equal(found, image)
    assert all(torch.allclose(gradient, wanted, rtol=1e-12, atol=0) for gradient, wanted in zip(gradients, expected))


def test_its_memory_is_predicted():
    renderer = rb.Renderer(CASES["cornell"].scene(), spp=4, max_depth=4, adjoint=KeepsEverything())
    assert renderer.memory_plan().peak >= rb.Renderer(CASES["cornell"].scene(), spp=4, max_depth=4,
                                                      adjoint=rb.MemoizedAdjoint("log")).memory_plan().peak > 0
