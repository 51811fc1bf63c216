"""Geometry that moves: between two renderings, between a rendering and its backward pass, and in other threads."""

import gc
import sys
import threading
import weakref
from concurrent.futures import ThreadPoolExecutor

import pytest
import torch

import torch_radbp as rb
from tests.gradients import assert_informative, cotangent, relative_error, unwarned_renderer
from tests.scenes import CASES, cornell, parameters

NAMES = CASES["cornell"].parameters
SETTINGS = {"spp": 4, "max_depth": 4}
MOVED = "box.to_world"
THREADS = 6


def move(scene: rb.Scene, by: float) -> None:
    """Along x."""
    with torch.no_grad():
        scene.get_parameter(MOVED)[0, 3] += by


def budget_that_retraces() -> dict:
    """For 256 samples a pixel."""
    scene = cornell(torch.float32, 16)
    parameters(scene, NAMES)
    for size in range(24, 1, -1):
        budget = {"memory_budget": f"{size}MiB", "chunk": 4096}
        if rb.Renderer(scene, spp=256, max_depth=4, **budget).memory_plan().retrace:
            return budget
    raise AssertionError("no memory budget makes the backward pass trace its paths again")


def gradients(settings, call, by: float) -> tuple[torch.Tensor, list[torch.Tensor]]:
    """Of a first image, with the box moved and rendered again before they are asked for."""
    scene = cornell(torch.float32, 16)
    wanted = parameters(scene, NAMES)
    renderer = unwarned_renderer(scene, **settings)
    image = renderer(seed=3, **call)
    if by:
        move(scene, by)
        assert relative_error(renderer(seed=3).detach(), image.detach()) > 0.01
    return image.detach(), list(torch.autograd.grad(image, wanted, cotangent(image.detach())))


@pytest.mark.parametrize("caster", ["embree", "brute"])
@pytest.mark.parametrize("settings, call", [
    ({"adjoint": rb.MemoizedAdjoint("sqrt", keep_hits=False)}, {}),
    ({"adjoint": rb.ReplayAdjoint(keep_hits=False)}, {}),
    ({"adjoint": rb.QuadraticAdjoint()}, {}),
    ({"adjoint": rb.TapeAdjoint()}, {}),
    ({}, {"seed_grad": 7}),
], ids=str)
def test_the_backward_pass_sees_the_geometry_of_its_image(settings, call, caster):
    image, expected = gradients(SETTINGS | settings | {"caster": caster}, call, by=0.0)
    same, found = gradients(SETTINGS | settings | {"caster": caster}, call, by=-0.3)
    assert_informative(image, expected)
    assert torch.equal(same, image)
    assert all(torch.equal(gradient, wanted) for gradient, wanted in zip(found, expected))


def test_the_backward_pass_that_traces_again_sees_the_geometry_of_its_image():
    settings = {"spp": 256, "max_depth": 4} | budget_that_retraces()
    image, expected = gradients(settings, {}, by=0.0)
    _, found = gradients(settings, {}, by=-0.3)
    assert_informative(image, expected)
    assert all(torch.equal(gradient, wanted) for gradient, wanted in zip(found, expected))


@pytest.mark.parametrize("by", [0.0, 0.1])
def test_a_caster_is_made_where_geometry_has_moved_and_only_there(by):
    scene = cornell()
    renderer = rb.Renderer(scene, **SETTINGS)
    renderer()
    first = renderer.last_caster
    scene.get_parameter("white.reflectance.value").data.mul_(0.5)
    renderer(seed=2)
    assert renderer.last_caster is first
    move(scene, by)
    renderer()
    assert (renderer.last_caster is first) == (by == 0.0)


def test_a_scene_in_another_dtype_gets_another_caster():
    scene = cornell(torch.float32)
    renderer = rb.Renderer(scene, **SETTINGS)
    renderer()
    scene.double()
    assert torch.equal(renderer(), rb.Renderer(scene, **SETTINGS)())


def test_a_caster_lives_as_long_as_the_graph_that_needs_it():
    scene = cornell()
    wanted = parameters(scene, NAMES)
    renderer = unwarned_renderer(scene, adjoint=rb.MemoizedAdjoint(keep_hits=False), **SETTINGS)
    image = renderer()
    first = weakref.ref(renderer.last_caster)
    move(scene, 0.1)
    renderer()
    gc.collect()
    assert first() is not None
    torch.autograd.grad(image.sum(), wanted)
    del image
    gc.collect()
    assert first() is None


@pytest.mark.parametrize("differentiated", [False, True])
def test_casters_of_the_past_are_freed(differentiated):
    """Even while their images live on, whose backward pass casts no rays."""
    scene = cornell()
    if differentiated:
        parameters(scene, NAMES)
    renderer = unwarned_renderer(scene, share_samples=True, **SETTINGS)
    casters, images = [], []
    for _ in range(4):
        images.append(renderer())
        casters.append(weakref.ref(renderer.last_caster))
        move(scene, 0.01)
    gc.collect()
    assert [caster() is None for caster in casters] == [True, True, True, False]
    assert all(image.requires_grad == differentiated for image in images)


@pytest.fixture
def eager_switching():
    """Threads take turns as often as Python lets them."""
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(interval)


def test_threads_may_render_while_geometry_moves(eager_switching):
    """Each gets an image of a place where the box was: between what it was before the call and after it."""
    step, turns, known = 0.001, 5, cornell(torch.float32, 4)
    start = known.get_parameter(MOVED).detach().clone()
    images = []
    for number in range(THREADS * turns + 1):
        with torch.no_grad():
            known.get_parameter(MOVED).copy_(start)[0, 3] += number * step
        images.append(rb.render(known, seed=5, **SETTINGS))
    assert not torch.equal(images[0], images[1])

    scene, moving, places = cornell(torch.float32, 4), threading.Lock(), []
    renderer = rb.Renderer(scene, **SETTINGS)

    def turn(_: int) -> bool:
        with moving, torch.no_grad():
            places.append(start[0, 3] + (len(places) + 1) * step)
            scene.get_parameter(MOVED)[0, 3] = places[-1]
            before = len(places)
        image = renderer(seed=5)
        after = len(places)
        return any(relative_error(image, images[place]) < 1e-6 for place in range(before, after + 1))

    with ThreadPoolExecutor(THREADS) as pool:
        assert all(pool.map(turn, range(THREADS * turns)))


def test_threads_may_differentiate_while_geometry_moves(eager_switching):
    """A graph keeps the geometry that it was made of."""
    scene = cornell(torch.float32, 4)
    wanted = parameters(scene, NAMES)
    renderer = rb.Renderer(scene, adjoint=rb.MemoizedAdjoint(keep_hits=False), **SETTINGS)
    image = renderer(seed=5)
    expected = torch.autograd.grad(image, wanted, torch.ones_like(image), retain_graph=True)

    def turn(number: int) -> bool:
        if number % 2:
            move(scene, 0.001)
            return bool(torch.isfinite(renderer(seed=number)).all())
        found = torch.autograd.grad(image, wanted, torch.ones_like(image), retain_graph=True)
        return all(relative_error(gradient, other) < 1e-6 for gradient, other in zip(found, expected))

    with ThreadPoolExecutor(THREADS) as pool:
        assert all(pool.map(turn, range(4 * THREADS)))
