"""Totals of large tables are used again, and are zero when they are."""

import copy

import pytest
import torch

import torch_radbp as rb
from tests.scenes import diffuse, load, rectangle, sensor
from torch_radbp.adjoint.scatter import Contribution, Gradients, gradients_of
from torch_radbp.threads.zeroed_memory import LEAST, ZeroedMemory

ENTRIES = 200_000  # of a table whose totals are kept


def contribution(seed: int) -> Contribution:
    generator = torch.Generator().manual_seed(seed)
    return Contribution(0, torch.randint(ENTRIES, (5000,), generator=generator, dtype=torch.int32),
                        torch.randn(5000, generator=generator))


def test_totals_that_are_used_again_are_zero():
    memory, found = ZeroedMemory(), []
    for seed in range(3):
        gradients = Gradients([torch.empty(ENTRIES), torch.empty(5)], memory)
        gradients.add([contribution(seed)])
        found.append(gradients.rows[0].data_ptr())
        (gradient, small), _ = gradients_of([gradients])
        fresh = Gradients([torch.empty(ENTRIES), torch.empty(5)])
        fresh.add([contribution(seed)])
        assert torch.equal(gradient, gradients_of([fresh])[0][0]) and gradient.any() and not small.any()
        assert not gradients.rows[0].any()
        memory.give_back(gradients.rows)
        assert [table.nbytes >= LEAST for table in memory.unused] == [True]
    assert len(set(found)) == 1


def test_what_two_ask_for_at_once_is_not_the_same():
    memory = ZeroedMemory()
    first, second = (memory.take(ENTRIES, 1, torch.device("cpu")) for _ in range(2))
    assert first.data_ptr() != second.data_ptr()
    memory.give_back([first, second])
    assert memory.take(ENTRIES, 2, torch.device("cpu")).shape == (ENTRIES, 2)
    taken = [memory.take(ENTRIES, 1, torch.device("cpu")).data_ptr() for _ in range(2)]
    assert set(taken) == {first.data_ptr(), second.data_ptr()}


@pytest.mark.usefixtures("threads")
def test_gradients_of_a_large_image_are_the_same_in_every_step():
    image = torch.rand(256, 300, 3, generator=torch.Generator().manual_seed(3))
    scene = load(torch.float32, sensor=sensor(24), floor=rectangle((0, 0, -1), 0.3, bsdf=diffuse(0.5, 0.5, 0.5)),
                 sky={"type": "envmap", "bitmap": image.numpy()})
    data = scene.get_parameter("sky.data").requires_grad_()
    renderer = rb.Renderer(scene, spp=4, max_depth=3, chunk=500)

    def gradient(renderer: rb.Renderer, seed: int) -> torch.Tensor:
        return torch.autograd.grad(renderer(seed=seed).sum(), data)[0]

    expected = [gradient(rb.Renderer(scene, spp=4, max_depth=3, chunk=500), seed) for seed in range(3)]
    assert all(each.any() for each in expected) and not torch.equal(expected[0], expected[1])
    for seed in (0, 1, 2, 1, 0):
        assert torch.equal(gradient(renderer, seed), expected[seed])
        assert renderer.memory.unused
    assert not copy.deepcopy(renderer).memory.unused


def test_a_gradient_that_is_not_finite_leaves_nothing_behind():
    image = torch.rand(256, 300, 3, generator=torch.Generator().manual_seed(3))
    scene = load(torch.float32, sensor=sensor(8), floor=rectangle((0, 0, -1), 0.3),
                 sky={"type": "envmap", "bitmap": image.numpy()})
    data = scene.get_parameter("sky.data").requires_grad_()
    renderer = rb.Renderer(scene, spp=4, max_depth=3)
    expected = torch.autograd.grad(renderer(seed=0).sum(), data)[0]
    with pytest.raises(rb.NonFiniteError):
        torch.autograd.grad(renderer(seed=0).sum() * float("inf"), data)
    assert torch.equal(torch.autograd.grad(renderer(seed=0).sum(), data)[0], expected) and expected.any()


def test_an_image_that_is_changed_in_place_before_the_backward_pass_is_refused():
    """It is read where it lies, and not copied."""
    image = torch.rand(40, 50, 3, generator=torch.Generator().manual_seed(3))
    scene = load(torch.float32, sensor=sensor(8), floor=rectangle((0, 0, -1), 0.3),
                 sky={"type": "envmap", "bitmap": image.numpy()})
    data = scene.get_parameter("sky.data").requires_grad_()
    rendered = rb.Renderer(scene, spp=4, max_depth=3)(seed=0)
    with torch.no_grad():
        data.mul_(0.5)
    with pytest.raises(RuntimeError, match="changed in place between a rendering and its backward pass"):
        rendered.sum().backward()
