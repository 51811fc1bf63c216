"""Modules in batches: their values and gradients against autograd's on all places at once, and how often they run."""

import pytest
import torch
from torch import nn

import torch_radbp as rb
from tests.deep import deep_but
from tests.gradients import MEMOIZED, QUADRATIC, relative_error
from tests.scenes.networks import mlp, room
from torch_radbp.adjoint import sweep
from torch_radbp.tensors.vec import Vec2, Vec3
from torch_radbp.texture import module_bank
from torch_radbp.texture.module_bank import ModuleBank
from torch_radbp.texture.module_function import ModuleFunction, Use

LANES = 101
TOLERANCE = 1e-14  # sums of a hundred numbers in another order
SETTINGS = {"spp": 2, "max_depth": 4, "rr_depth": 2}
STRATEGIES = [*MEMOIZED, *QUADRATIC, rb.MemoizedAdjoint(2, keep_hits=False)]


@pytest.fixture(autouse=True)
def small_batches(monkeypatch):
    monkeypatch.setattr(module_bank, "BATCH", 8)


def bank(modules) -> ModuleBank:
    functions = tuple(ModuleFunction(module, Use("", ())) for module in modules)
    return ModuleBank(functions, tuple(tuple(module.parameters()) for module in modules))


def places(generator: torch.Generator, channels: int) -> list[torch.Tensor]:
    return list(torch.rand(channels, LANES, generator=generator, dtype=torch.float64))


def case(modules: int, none: bool = False):
    """Some modules, lanes that read them, or none, their places, and adjoints of their values, some of them 0."""
    generator = torch.Generator().manual_seed(0)
    row = torch.randint(-int(none), modules, (LANES,), generator=generator, dtype=torch.int32)
    adjoint = Vec3(*places(generator, 3))
    ended = torch.rand(LANES, generator=generator) < 0.3
    return ([mlp(2, 3).double(), mlp(2, 1, 1).double()][:modules], row, Vec2(*places(generator, 2)),
            adjoint.map(lambda channel: torch.where(ended, 0.0, channel)))


def at_once(modules, row: torch.Tensor, at: torch.Tensor) -> torch.Tensor:
    """(N, 3) values of all lanes, by every module on all of them."""
    values = [module(at).expand(-1, 3) for module in modules]
    return sum(((row == number)[:, None] * value for number, value in enumerate(values)), torch.zeros(LANES, 3))


@pytest.mark.parametrize("given", [(1,), (2,), (2, True)], ids=["one module", "two", "two, and lanes of none"])
def test_values_and_slopes_are_those_of_all_places_at_once(given):
    modules, row, at, _ = case(*given)
    stacked = at.stack().requires_grad_()
    recorded = at_once(modules, row, stacked)
    expected = recorded.detach()
    values, *slopes = bank(modules).values_and_slopes(row, at)
    assert relative_error(values.stack(), expected) < TOLERANCE
    assert relative_error(bank(modules).values(row, at).detach().stack(), expected) < TOLERANCE
    for channel in range(3):
        wanted, = torch.autograd.grad(recorded[:, channel].sum(), stacked, retain_graph=True)
        assert relative_error(torch.stack([slope[channel] for slope in slopes], 1), wanted) < TOLERANCE


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("given", [(1,), (2,), (2, True)], ids=["one module", "two", "two, and lanes of none"])
def test_gradients_are_those_of_all_places_at_once(given, threads):
    modules, row, at, adjoint = case(*given)
    values = at_once(modules, row, at.stack())
    parameters = [parameter for module in modules for parameter in module.parameters()]
    expected = torch.autograd.grad(values, parameters, adjoint.stack())
    before = torch.get_num_threads()
    torch.set_num_threads(threads)
    try:
        found = {(module, number): gradient for module, number, gradient in
                 bank(modules).gradients([[True] * 4, [True, False, True, True]][:len(modules)], row, at, adjoint)}
    finally:
        torch.set_num_threads(before)
    assert found.keys() == {(0, k) for k in range(4)} | ({(1, 0), (1, 2), (1, 3)} if len(modules) > 1 else set())
    for (module, number), gradient in found.items():
        assert relative_error(gradient, expected[4 * module + number]) < TOLERANCE


def test_gradients_are_the_same_bits_whatever_the_number_of_threads():
    modules, row, at, adjoint = case(2)
    before, found = torch.get_num_threads(), []
    try:
        for threads in (1, 2, 4):
            torch.set_num_threads(threads)
            found.append(list(bank(modules).gradients([[True] * 4] * 2, row, at, adjoint)))
    finally:
        torch.set_num_threads(before)
    for other in found[1:]:
        assert all(torch.equal(a[2], b[2]) for a, b in zip(found[0], other, strict=True))


class Gated(nn.Module):
    """A module that reads one of its parameters only if there are places where it matters."""

    def __init__(self):
        super().__init__()
        self.everywhere, self.scale = mlp(2, 3).double(), nn.Parameter(torch.ones((), dtype=torch.float64))

    def forward(self, at):
        value, here = self.everywhere(at), at[:, :1] > 0.95
        return torch.where(here, value * self.scale, value) if bool(here.any()) else value


def test_a_parameter_that_some_batches_do_not_read_has_its_gradient():
    _, row, at, adjoint = case(1)
    module = Gated()
    found = {number: gradient for _, number, gradient in bank([module]).gradients([[True] * 5], row, at, adjoint)}
    expected = torch.autograd.grad(module(at.stack()), list(module.parameters()), adjoint.stack())
    for number, wanted in enumerate(expected):
        assert relative_error(found[number], wanted) < TOLERANCE


def evaluated(adjoint: rb.AdjointStrategy | None, adj_image=None, **settings) -> tuple[int, int]:
    """The places of which a step computes the values of a module, and those of which it computes gradients."""
    scene, counts = room(), {False: 0, True: 0}
    renderer = rb.Renderer(scene, **SETTINGS, compile=False, **settings, **({} if adjoint is None else {"adjoint": adjoint}))
    renderer(seed=0)  # looks at the modules

    def count(module, given, values):
        counts[torch.is_grad_enabled()] += len(values)

    hook = scene.floor.bsdf.reflectance.module.register_forward_hook(count)
    image = renderer(seed=0)
    image.backward(torch.ones_like(image) if adj_image is None else adj_image)
    hook.remove()
    return counts[False], counts[True]


@pytest.mark.parametrize("adjoint", deep_but(STRATEGIES[:1] + STRATEGIES[-1:], STRATEGIES), ids=str)
def test_a_module_runs_once_for_the_values_of_a_path_and_once_for_its_gradients(adjoint):
    values, gradients = evaluated(adjoint, share_samples=True)
    whole, _ = evaluated(rb.MemoizedAdjoint(), share_samples=True)
    assert 0 < gradients <= whole
    assert values == whole if adjoint.keep_hits else values > whole


def test_a_module_is_called_once_a_bounce_for_image_and_derivative_and_once_for_all_gradients(monkeypatch):
    monkeypatch.setattr(module_bank, "BATCH", 1 << 12)
    scene, calls = room(), []
    renderer = rb.Renderer(scene, **SETTINGS, compile=True)
    renderer(seed=0)  # looks at the modules
    hook = scene.floor.bsdf.reflectance.module.register_forward_hook(
        lambda module, given, values: calls.append((torch.is_grad_enabled(), len(values))))
    renderer(seed=0).sum().backward()
    hook.remove()
    of_values, of_gradients = ([lanes for recorded, lanes in calls if recorded == kind] for kind in (False, True))
    assert len(of_gradients) == 1 and 2 <= len(of_values) < SETTINGS["max_depth"]  # not at bounces where nobody meets it
    assert min(lanes for _, lanes in calls) > 0


@pytest.mark.parametrize("compile", [False, True])
def test_gradients_do_not_depend_on_how_many_adjoints_are_held_back(monkeypatch, compile):
    found = []
    for held in (0, 60, 1 << 16):
        monkeypatch.setattr(sweep, "HELD", held)
        scene = room()
        rb.Renderer(scene, **SETTINGS, compile=compile)(seed=0).sum().backward()
        found.append([parameter.grad for _, parameter in scene.named_parameters() if parameter.grad is not None])
    assert len(found[0]) == 16 and all(bool(gradient.any()) for gradient in found[0])
    for other in found[1:]:
        assert max(map(relative_error, other, found[0])) < 1e-12  # sums of some hundred numbers in another order


def test_samples_of_the_derivative_cost_their_values_once_more():
    shared, of_shared = evaluated(None, share_samples=True)
    values, gradients = evaluated(None)
    assert 1.5 * shared < values < 2.5 * shared
    assert 0 < gradients < 1.5 * of_shared


def test_where_no_light_arrives_a_module_does_not_run_again():
    _, everywhere = evaluated(None, share_samples=True)
    half = torch.zeros(1, 3, 5, 5, dtype=torch.float64)
    half[..., :2] = 1.0
    _, gradients = evaluated(None, half, share_samples=True)
    assert 0 < gradients < 0.8 * everywhere
    assert evaluated(None, torch.zeros_like(half), share_samples=True)[1] == 0
