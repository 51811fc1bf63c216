"""On a GPU: kernels, images and gradients are those of the processor. Skipped without one; `make gpu-check` runs them."""

import warnings

import pytest
import torch

import torch_radbp as rb
from benchmarks.instances import field_of
from tests.gradients import assert_informative, cotangent, relative_error
from tests.jit.programs import addition, arguments, assert_close, mixed
from tests.rendering.taped import singly
from tests.scenes import CASES, cornell
from tests.scenes.everything import EVERYTHING, build_everything
from torch_radbp import raycast
from torch_radbp.jit import LaneFunction
from torch_radbp.jit.lane.elementary_double import FORMULAS
from torch_radbp.jit.nvidia.driver import Driver
from torch_radbp.jit.nvidia.graphs import Graphs
from torch_radbp.jit.order import chosen, partition, put
from torch_radbp.jit.recording.structure import with_other_leaves
from torch_radbp.jit.scatter import Sums, copies, scatter_add
from torch_radbp.scene.packing import geometry
from torch_radbp.shape import cylinder, disk, sphere
from torch_radbp.tensors.record import leaves_of

pytestmark = [pytest.mark.gpu, pytest.mark.filterwarnings("error:.*runs eagerly:RuntimeWarning",
                                                          "ignore::torch_radbp.SilhouetteWarning",
                                                          "ignore::torch_radbp.JumpWarning")]
DTYPES = (torch.bool, torch.int32, torch.float32, torch.float64, torch.int64)


def moved(record, device: str):
    """The same nested tuples with tensors on a device."""
    leaves = (leaf.to(device) for leaf in leaves_of(record) if isinstance(leaf, torch.Tensor))
    return with_other_leaves(record, lambda: next(leaves))


@pytest.mark.parametrize("lanes", [1, 127, 128, 129, 100_003])
@pytest.mark.parametrize("dtype, rtol", [(torch.float32, 3e-6), (torch.float64, 1e-12)], ids=str)
def test_a_function_of_lanes(lanes, dtype, rtol):
    given = arguments(lanes, dtype)
    found = LaneFunction(mixed, tables=("colours",))(*moved(given, "cuda"))
    assert_close(moved(found, "cpu"), mixed(*given), rtol)


@pytest.mark.parametrize("dtype, tolerance", [(torch.float32, 1e-6), (torch.float64, 3e-15)], ids=str)
@pytest.mark.parametrize("name", [name for name in FORMULAS if name not in ("pow", "atan2", "hypot")])
def test_elementary_functions(name, dtype, tolerance):
    x, function = torch.linspace(0.01, 0.99, 10_001, dtype=dtype), getattr(torch, name)
    found = LaneFunction(lambda x: function(x))(x.cuda()).cpu()
    torch.testing.assert_close(found, function(x), rtol=tolerance, atol=0)


def test_lanes_are_chosen_partitioned_and_put():
    number = torch.randint(0, 5, (10_000,), dtype=torch.int32)
    assert torch.equal(chosen((number > 2).cuda()).cpu(), chosen(number > 2))
    (order, counts), (expected, expected_counts) = partition(number.cuda(), 6), partition(number, 6)
    assert torch.equal(order.cpu(), expected) and list(counts) == list(expected_counts)
    targets = [torch.zeros(20_000, dtype=dtype) for dtype in DTYPES]
    place, entries = torch.randperm(20_000, dtype=torch.int32)[:10_000], [torch.arange(10_000).to(dtype) for dtype in DTYPES]
    on_gpu = [target.cuda() for target in targets]
    put(targets, place, entries)
    put(on_gpu, place.cuda(), [entry.cuda() for entry in entries])
    assert all(torch.equal(found.cpu(), wanted) for found, wanted in zip(on_gpu, targets))


@pytest.mark.parametrize("deterministic", [False, True])
@pytest.mark.parametrize("entries", [1, 4, 100_000])
def test_numbers_are_added_to_tables(entries, deterministic):
    case = addition(200_000, entries, 3, copies(entries, torch.device("cuda", 0)), torch.float32)
    there = [case._replace(index=case.index.cuda(), numbers=[number.cuda() for number in case.numbers],
                           sums=Sums([total.cuda() for total in case.sums.totals], case.sums.touched.cuda()))
             for _ in range(2)]
    before = torch.are_deterministic_algorithms_enabled()
    torch.use_deterministic_algorithms(deterministic)
    try:
        for part in there:
            scatter_add([part])
    finally:
        torch.use_deterministic_algorithms(before)
    for numbers, *totals in zip(case.numbers, *(part.sums.totals for part in there)):
        expected = torch.zeros(entries, dtype=torch.float64).index_add_(0, case.index, numbers.double())
        torch.testing.assert_close(totals[0].sum(1).cpu(), expected, rtol=1e-12, atol=1e-10)
        assert not deterministic or torch.equal(*totals)


def image_and_gradients(scene: rb.Scene, names, device: str, **settings):
    """Both on the CPU, rendered on a device."""
    scene = scene.to(device)
    wanted = [scene.get_parameter(name).requires_grad_() for name in names]
    image = rb.Renderer(scene, **settings)()
    gradients = torch.autograd.grad(image, wanted, cotangent(image.detach().cpu()).to(device), allow_unused=True)
    return image.detach().cpu(), [torch.zeros(1) if gradient is None else gradient.cpu() for gradient in gradients]


@pytest.mark.parametrize("caster", ["warp", "brute"])
def test_the_image_and_gradients_of_the_cornell_box(caster):
    """Fusing changes roundings of 6e-8, some thousands of which add up; a lane in ten thousand may decide otherwise."""
    names, settings = CASES["cornell"].parameters, {"spp": 16, "max_depth": 5, "rr_depth": 3}
    expected, gradients = image_and_gradients(cornell(torch.float32, 32), names, "cpu", **settings)
    image, found = image_and_gradients(cornell(torch.float32, 32), names, "cuda", caster=caster, **settings)
    assert_informative(expected, gradients)
    differs = ((image - expected).abs() > 1e-4 * expected.max()).any(dim=1)
    assert differs.sum() <= 10  # of 1024 pixels
    for name, gradient, wanted in zip(names, found, gradients):
        assert relative_error(gradient, wanted) < 2e-3, name


def test_the_image_of_instances_and_gradients_by_their_poses(monkeypatch):
    """Groups have trees of their own. By Warp's CPU device gradients differ by 3e-4, where paths decide otherwise."""
    monkeypatch.setattr(raycast, "MOST_COPIED", 0)
    names = ["stone_0.to_world", "group.stone.vertex_positions", "group.stone.bsdf.reflectance.value"]
    settings = {"spp": 16, "max_depth": 4, "rr_depth": 100, "terms": ("interior",)}
    expected, gradients = image_and_gradients(field_of(30, 400, 32), names, "cpu", **settings)
    image, found = image_and_gradients(field_of(30, 400, 32), names, "cuda", caster="warp", **settings)
    differs = ((image - expected).abs() > 1e-4 * expected.max()).any(dim=1)
    assert expected.std() > 0 and differs.sum() <= 20  # of 1024 pixels
    for name, gradient, wanted in zip(names, found, gradients):
        assert wanted.abs().max() > 0 and relative_error(gradient, wanted) < 1e-2, name


def test_bounces_that_are_recorded_bring_what_single_calls_do(monkeypatch):
    """The image has the same bits, gradients are sums in another order."""
    names, settings = CASES["cornell"].parameters, {"spp": 16, "max_depth": 5, "rr_depth": 3, "caster": "warp"}
    image, found = image_and_gradients(cornell(torch.float32, 32), names, "cuda", **settings)
    singly(monkeypatch)
    expected, gradients = image_and_gradients(cornell(torch.float32, 32), names, "cuda", **settings)
    assert expected.std() > 0 and torch.equal(image, expected)
    for name, gradient, wanted in zip(names, found, gradients):
        assert relative_error(gradient, wanted) < 1e-6, name


def test_bounces_that_are_graphs_bring_what_launches_do(monkeypatch):
    """The image has the same bits, gradients are sums in another order. Each sequence is a graph, as if it came again."""
    names, settings = CASES["cornell"].parameters, {"spp": 16, "max_depth": 5, "rr_depth": 3, "caster": "warp"}
    expected, gradients = image_and_gradients(cornell(torch.float32, 32), names, "cuda", **settings)
    played, play = [], Driver.play
    monkeypatch.setattr(Driver, "play", lambda self, graph: played.append(graph) or play(self, graph))
    monkeypatch.setattr(Graphs, "of", lambda self, given, make: make())
    image, found = image_and_gradients(cornell(torch.float32, 32), names, "cuda", **settings)
    assert len(played) >= 2 * settings["max_depth"] and torch.equal(image, expected)
    for name, gradient, wanted in zip(names, found, gradients):
        assert relative_error(gradient, wanted) < 1e-6, name


def test_steps_of_training_come_to_be_graphs(monkeypatch):
    """As torch's allocator hands out the same memory after some steps; images are those of other streams, without any."""
    played, play = [], Driver.play
    monkeypatch.setattr(Driver, "play", lambda self, graph: played.append(graph) or play(self, graph))
    renderer = rb.Renderer(cornell(torch.float32, 32).to("cuda"), spp=16, max_depth=5, caster="warp")
    with torch.no_grad():
        images = [renderer(seed=seed % 2) for seed in range(40)]
        with torch.cuda.stream(torch.cuda.Stream()):
            others = [renderer(seed=seed) for seed in range(2)]
        torch.cuda.synchronize()
    assert played and all(torch.equal(image, others[number % 2]) for number, image in enumerate(images))


def test_the_host_waits_for_nothing_between_bounces():
    def waits(depth: int) -> int:
        scene = cornell(torch.float32, 16).to("cuda")
        wanted = [scene.get_parameter(name).requires_grad_() for name in CASES["cornell"].parameters]
        renderer = rb.Renderer(scene, spp=4, max_depth=depth, rr_depth=100, caster="warp")
        for mode in ("default", "warn"):  # all is recorded in the first turn
            torch.cuda.set_sync_debug_mode(mode)
            with warnings.catch_warnings(record=True) as told:
                warnings.simplefilter("always")
                try:
                    image = renderer(seed=1)
                    torch.autograd.grad(image, wanted, torch.ones_like(image), allow_unused=True)
                finally:
                    torch.cuda.set_sync_debug_mode("default")
        return sum("synchroniz" in str(warning.message) for warning in told)

    assert waits(7) == waits(3)


@pytest.fixture
def coarse(monkeypatch):
    """Curved shapes of few triangles, of which `brute` tries every one."""
    for module, constant, number in ((sphere, "SEGMENTS", 16), (sphere, "RINGS", 8), (geometry, "TRIANGLES", 2 * 16 * 7),
                                     (disk, "SECTORS", 16), (cylinder, "SECTORS", 16)):
        assert getattr(module, constant) > number
        monkeypatch.setattr(module, constant, number)


# Rounding decides by which of two pixels some curves in mirrors and glass are found: `test_terms` has those.
TERMS = {"materials": ("interior", "shadow")}


@pytest.mark.parametrize("sampling", ["hybrid", "attached"])
@pytest.mark.parametrize("name", EVERYTHING)
@pytest.mark.usefixtures("coarse")
def test_every_plugin_and_parameter_in_double_precision(name, sampling):
    """By the same rays, of `brute`."""
    names = [name for name, _ in build_everything(name).named_parameters()]
    settings = {"spp": 2, "max_depth": 4, "rr_depth": 2, "sampling": sampling, "caster": "brute",
                "terms": TERMS.get(name, rb.Renderer(build_everything(name)).terms)}
    (expected, gradients), (image, found) = (
        image_and_gradients(build_everything(name), names, device, **settings) for device in ("cpu", "cuda"))
    assert expected.dtype == torch.float64 and expected.isfinite().all() and expected.any()
    assert relative_error(image, expected) < 1e-9
    for name, gradient, wanted in zip(names, found, gradients):
        assert relative_error(gradient, wanted) < 1e-9 if wanted.abs().max() > 1e-9 else gradient.abs().max() < 1e-8, name
