"""What no machine can render is refused before the first ray, with the numbers."""

import re

import pytest
import torch

import torch_radbp as rb
from tests.scenes import cornell, sensor
from torch_radbp.rendering import cost

pytestmark = pytest.mark.hostile

GIB = 1 << 30


def with_film(**attributes) -> rb.Scene:
    film = {"type": "hdrfilm", "rfilter": {"type": "box"}} | attributes
    return cornell(torch.float32, sensors={"sensor": sensor(film=film)})


ABSURD = {
    "samples": ({}, {"spp": 10**12}, "1 image of 8 x 8 pixels with spp=1000000000000: 6.4e+13 paths, "),
    "samples beyond int32": ({}, {"spp": 2**31}, "1 image of 8 x 8 pixels with spp=2147483648: 1.37e+11 paths"),
    "film": ({"width": 10**5, "height": 10**5}, {"spp": 1}, "1 image of 100000 x 100000 pixels with spp=1: 1e+10 paths"),
    "film in one direction": ({"width": 10**9, "height": 10}, {"spp": 1}, "1 image of 1000000000 x 10 pixels"),
    "film and samples": ({"width": 4000, "height": 4000}, {"spp": 10**6}, "with spp=1000000: 1.6e+13 paths"),
}


@pytest.mark.parametrize("film, call, message", ABSURD.values(), ids=ABSURD)
@pytest.mark.parametrize("differentiated", [False, True])
def test_the_absurd_is_refused(film, call, message, differentiated):
    scene = with_film(**{"width": 8, "height": 8} | film)
    scene.get_parameter("red.reflectance.value").requires_grad_(differentiated)
    renderer = rb.Renderer(scene, max_depth=2)
    for attempt in (lambda: renderer(**call), lambda: renderer.memory_plan(**call), lambda: rb.render(scene, **call)):
        with pytest.raises(ValueError, match=re.escape(message) + ".* of memory at least; one call traces at most 1e"):
            attempt()


MEMORY = {  # film, settings, gigabytes that there are, what is needed
    "image": ({"width": 8192, "height": 8192}, {"spp": 1}, False, 1, r": 1\.[56]"),  # by the threads that trace at once
    "chunk": ({"width": 512, "height": 512}, {"spp": 64, "chunk": 10**9}, False, 1, ": 4.6"),
    "small chunks": ({"width": 64, "height": 64}, {"spp": 4096, "chunk": 1}, False, 1, ": 3.1"),
    "records of a chunk": ({"width": 512, "height": 512}, {"spp": 64, "chunk": 10**9}, True, 1, ": "),
    "tape": ({"width": 256, "height": 256}, {"spp": 1024, "adjoint": rb.TapeAdjoint()}, True, 8, ": 14"),
}


@pytest.mark.parametrize("film, settings, differentiated, there, message", MEMORY.values(), ids=MEMORY)
def test_more_memory_than_there_is_is_refused(film, settings, differentiated, there, message, monkeypatch):
    monkeypatch.setattr(cost, "memory_of", lambda device: there * GIB)
    scene = with_film(**film)
    scene.get_parameter("red.reflectance.value").requires_grad_(differentiated)
    with pytest.raises(ValueError, match=rf"{message}.* GiB of memory at least, and there are {there} GiB; .*smaller film"):
        rb.render(scene, max_depth=2, **settings)


def test_a_budget_or_no_gradient_asks_for_no_more_than_a_chunk(monkeypatch):
    """The planner keeps to its budget, records to their share, and what is not differentiated keeps nothing."""
    monkeypatch.setattr(cost, "memory_of", lambda device: GIB // 256)
    scene = with_film(width=8, height=8)
    scene.get_parameter("red.reflectance.value").requires_grad_()
    call = {"spp": 1024, "max_depth": 2, "chunk": 1024}
    with pytest.raises(ValueError, match="set memory_budget, or average the gradients of calls of fewer samples"):
        rb.render(scene, **call, adjoint=rb.TapeAdjoint())
    assert rb.render(scene, **call).requires_grad
    assert rb.render(scene, **call, share_samples=True).requires_grad
    assert rb.render(scene, **call, memory_budget="12MiB").requires_grad
    with torch.no_grad():
        rb.render(scene, **call)


def test_the_machine_has_memory():
    assert cost.memory_of(torch.device("cpu")) > GIB / 4
    assert cost.memory_of(torch.device("meta")) == float("inf")
    assert (cost.bytes_text(3 << 20), cost.bytes_text(1.5 * (1 << 40)), cost.bytes_text(10)) == ("3 MiB", "1.5 TiB", "10 B")


@pytest.mark.parametrize("settings", [{}, {"adjoint": rb.TapeAdjoint()}, {"chunk": 16}], ids=["memoized", "tape", "chunks"])
@pytest.mark.parametrize("differentiated", [False, True])
def test_an_image_may_be_changed_in_place(differentiated, settings):
    scene = cornell()
    parameter = scene.get_parameter("red.reflectance.value").requires_grad_(differentiated)
    image = rb.render(scene, spp=2, max_depth=3, **settings)
    expected = 2 * image.detach().clone().clamp(0, 0.2)
    image.clamp_(0, 0.2)
    image.mul_(2)
    assert torch.equal(image.detach(), expected)
    if differentiated:
        (gradient,) = torch.autograd.grad(image.sum(), parameter)
        again = rb.render(scene, spp=2, max_depth=3, **settings)
        (right,) = torch.autograd.grad((2 * again.clamp(0, 0.2)).sum(), parameter)
        assert torch.equal(gradient, right) and gradient.any()


@pytest.mark.parametrize("there, compiled, lanes", [
    (80, True, 1 << 24), (24, True, 24 << 18), (24, False, 24 << 16), (1, False, 1 << 18)])
def test_chunks_on_a_gpu_are_as_large_as_its_memory_allows(monkeypatch, there, compiled, lanes):
    monkeypatch.setattr(cost, "memory_of", lambda device: there * GIB)
    assert cost.lanes_of_chunks(torch.device("cuda"), torch.float32, 1, compiled) == lanes
    assert cost.lanes_of_chunks(torch.device("cpu"), torch.float32, 2, compiled) == 1 << (18 if compiled else 17)
    assert cost.lanes_of_chunks(torch.device("cuda"), torch.float32, 1, compiled, media=True) == lanes
    assert cost.lanes_of_chunks(torch.device("cpu"), torch.float32, 2, compiled, media=True) == 1 << 16
