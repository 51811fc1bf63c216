"""On a GPU a bounce is one sequence of launches, forwards and backwards, in which the host waits for nothing.

No GPU is needed: kernels run on the processor (`tests/jit/emulated.py`), and rays are cast by Warp's CPU device.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

import pytest
import torch

import torch_radbp as rb
from tests.deep import deep, deep_but
from tests.gradients import cotangent, image_and_gradients, relative_error, unwarned_renderer
from tests.jit.emulated import Emulated
from tests.jit.interpreter import interpreted, needs_interpreter
from tests.rendering.host import exchanges
from tests.rendering.on_gpu import render_on
from tests.rendering.taped import SCENES, SETTINGS, SOME, WAYS, rendered, singly
from tests.scenes import CASES, cornell, load, media, overhead, rectangle, rgb, smoke
from tests.scenes.closed_box import closed_box
from tests.scenes.mirrors import BALL, CUBE, MIRROR, SKY, VIEWED
from tests.scenes.networks import lit_room, room
from torch_radbp import raycast
from torch_radbp.adjoint.function import RenderFunction
from torch_radbp.jit.nvidia.gpu import Gpu
from torch_radbp.jit.nvidia.graphs import Graphs
from torch_radbp.jit.run import LaneFunction
from torch_radbp.path.lane_room import ASKED, room_for

pytest.importorskip("warp")
pytestmark = pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning", "ignore::torch_radbp.JumpWarning")
SMALL = SETTINGS | {"spp": 2, "max_depth": 4, "caster": "warp"}


@pytest.fixture(scope="module")
def gpu() -> Iterator[Gpu]:
    """A GPU on which compiled renderings run; what one test has compiled the others find."""
    device = Gpu(Emulated())
    with pytest.MonkeyPatch.context() as patch:
        render_on(device, patch, taped=True)
        yield device


def assert_same_bits(build, gpu: Gpu, monkeypatch, **settings) -> int:
    """Recorded or not, images and gradients are the same, and tell something; returns the number of sequences."""
    settings = SMALL | settings
    before = gpu.launcher.sequences
    image, gradients = rendered(build(), **settings)
    found = gpu.launcher.sequences - before
    singly(monkeypatch)
    expected, others = rendered(build(), **settings)
    assert gpu.launcher.sequences == before + found
    assert expected.std() > 0 and max(float(other.abs().max()) for other in others.values()) > 1e-3
    assert torch.equal(image, expected) and gradients.keys() == others.keys()
    for name, other in others.items():
        assert torch.isfinite(other).all() and torch.equal(gradients[name], other), name
    return found


@needs_interpreter
@pytest.mark.parametrize("name", ["box", deep("smoke"), deep("networks")])
def test_ptx_renders_what_torch_does(name, monkeypatch):
    """The first test, before `gpu` is there for all others."""
    monkeypatch.setenv("RADBP_KERNEL_CACHE", "off")
    build, names, depth = {"box": (lambda: cornell(torch.float32, 8), CASES["cornell"].parameters, 3),
                           "smoke": (lambda: smoke.room(smoke.varied(3)).float(), smoke.NAMES, 2),
                           "networks": (lambda: room(dtype=torch.float32), NETWORKS, 3)}[name]
    device, settings = Gpu(interpreted().launcher), {"spp": 2, "max_depth": depth, "rr_depth": 2, "caster": "warp"}
    expected, gradients = image_and_gradients(build(), names, compile=False, **settings)
    render_on(device, monkeypatch, taped=True)
    image, found = image_and_gradients(build(), names, compile=True, **settings)
    assert expected.std() > 0 and relative_error(image, expected) < 1e-5
    for each, gradient, wanted in zip(names, found, gradients):
        assert wanted.abs().max() > 0 and relative_error(gradient, wanted) < 1e-4, each
    assert {"counts", "count", "sum", "place", "lanes", "put", "scatter"} <= set(device.launcher.driver.launches)


@pytest.mark.parametrize("name, sampling", [case if case in SOME else deep(*case) for case in WAYS])
def test_images_and_gradients_have_the_bits_of_single_calls(name, sampling, gpu, monkeypatch):
    found = assert_same_bits(lambda: SCENES[name](torch.float32), gpu, monkeypatch, sampling=sampling)
    assert found == 2 * SMALL["max_depth"]  # one for each bounce, forwards and backwards


@pytest.mark.parametrize("settings", [{"adjoint": rb.MemoizedAdjoint(2, keep_hits=False)},
                                      {"adjoint": rb.MemoizedAdjoint("log"), "share_samples": True},
                                      {"max_depth": 1}, *map(deep, [
                                          {"adjoint": rb.ReplayAdjoint()}, {"adjoint": rb.QuadraticAdjoint()},
                                          {"hide_emitters": True}, {"nee": False}, {"chunk": 50}])], ids=str)
def test_so_they_have_with_other_settings(settings, gpu, monkeypatch):
    found = assert_same_bits(lambda: SCENES["two sides"](torch.float32), gpu, monkeypatch, **settings)
    assert found >= 2 * settings.get("max_depth", SMALL["max_depth"])


def test_so_they_have_where_groups_have_trees_of_their_own(gpu, monkeypatch):
    monkeypatch.setattr(raycast, "MOST_COPIED", 0)
    assert_same_bits(lambda: SCENES["instances and balls"](torch.float32), gpu, monkeypatch)


def test_paths_that_are_asked_for_only_now_and_then_are_those_that_go_on(gpu, monkeypatch):
    found = assert_same_bits(lambda: SCENES["closed box"](torch.float32), gpu, monkeypatch, max_depth=3 * ASKED, rr_depth=2)
    assert ASKED < found < 4 * ASKED  # who asks finds that no path is left


def test_room_is_that_for_all_until_the_device_is_asked():
    assert room_for([1.0] + [0.3] * ASKED + [0.2]) == [1.0] * ASKED + [0.6] * ASKED
    assert room_for([0.5]) == [1.0] * ASKED


def test_sums_are_in_order_where_torch_is_deterministic(gpu, monkeypatch):
    """Also after bounces have been recorded whose numbers are added in any order."""
    def scattered() -> bool:
        first = len(gpu.launcher.launches)
        rendered(SCENES["two sides"](torch.float32), **SMALL)
        return "scatter" in {launch.name for launch in gpu.launcher.launches[first:]}

    assert scattered()
    monkeypatch.setattr(torch, "are_deterministic_algorithms_enabled", lambda: True)
    assert not scattered()


def test_memory_is_planned_for_all_lanes_of_a_bounce(gpu, monkeypatch):
    """Of which on the processor only those count that reach it."""
    renderer = unwarned_renderer(SCENES["sky and points"](torch.float32), **SMALL)

    def shares() -> list[float]:
        return renderer.planner.workload(renderer.prepare(1, None, None, None)).fractions

    assert shares() == [1.0] * SMALL["max_depth"]
    singly(monkeypatch)
    assert shares()[-1] < 1.0


NETWORKS = ["floor.bsdf.reflectance.module.0.weight", "ball.bsdf.alpha.module.2.weight",
            "box.bsdf.reflectance.module.0.weight", "light.emitter.radiance.value"]
GLASS, PANE = {"type": "dielectric", "int_ior": 1.3}, {"type": "thindielectric", "int_ior": 1.4}
MEDIA = {"boundaries": (lambda: media.room(media.NULL), media), "glass": (lambda: media.room(GLASS), media),
         "panes": (lambda: media.room(PANE), media), "smoke": (lambda: smoke.room(smoke.varied(3)), smoke),
         "flame": (lambda: smoke.room(smoke.varied(3) | {"emission": rgb(0.5, 1.0, 0.7)}), smoke)}


@pytest.mark.parametrize("settings", [{}, *map(deep, [
    {"adjoint": rb.MemoizedAdjoint(2, keep_hits=False)}, {"share_samples": True}, {"adjoint": rb.MemoizedAdjoint("log")}])],
                         ids=str)
@pytest.mark.parametrize("name, moving", [("boundaries", False), ("smoke", True), *map(lambda case: deep(*case), [
    ("boundaries", True), ("smoke", False), *((name, moving) for name in MEDIA for moving in (False, True)
                                              if name not in ("boundaries", "smoke"))])])
def test_ways_through_media_have_the_bits_of_single_calls(name, moving, settings, gpu, monkeypatch):
    """In sequences of launches, of which the host finds out in the end whether rays have passed all boundaries. Where these
    move, sequences have room for more of them than single calls, in other functions: there digits differ by rounding."""
    build, of = MEDIA[name]
    names, before = [*of.NAMES, *(of.MOVING if moving else [])], gpu.launcher.sequences
    few = name == "glass" or "share_samples" in settings  # of the paths depend on each parameter
    settings = SMALL | settings | ({"spp": 16} if few else {})
    image, gradients = rendered(build().to(torch.float32), names, **settings)
    passes = 2 if "share_samples" in settings else 3  # of the image, of the derivative, and back
    assert gpu.launcher.sequences - before >= passes * SMALL["max_depth"] - 1
    singly(monkeypatch)
    before = gpu.launcher.sequences
    expected, others = rendered(build().to(torch.float32), names, **settings)
    assert gpu.launcher.sequences == before and expected.std() > 0 and torch.equal(image, expected)
    assert gradients.keys() == others.keys() == set(names)
    for each, other in others.items():
        assert torch.isfinite(other).all() and other.abs().max() > 1e-4, each
        assert relative_error(gradients[each], other) <= (1e-6 if moving else 0.0), each


def test_boundaries_that_are_not_passed_in_time_are_passed_in_a_second_try(gpu, monkeypatch):
    """A stack of slabs takes more repetitions than there are at first; then they are known."""
    air = media.haze((0.1, 0.2, 0.3), (0.5, 0.5, 0.5))
    slabs = {f"slab_{number}": media.slab(0.3 * (1 + number), 0.1, interior=air) for number in range(6)}
    scene = load(torch.float32, camera=overhead(4, 4.0, 1.0), floor=rectangle((0, 0, 0), 3.0),
                 bulb={"type": "point", "position": [0.0, 0.0, 3.0], "intensity": rgb(9, 8, 7)}, **slabs)
    floor = scene.get_parameter("floor.bsdf.reflectance.value").requires_grad_()
    renderer = unwarned_renderer(scene, **SMALL | {"max_depth": 2, "compile": True})

    def both_passes() -> tuple[torch.Tensor, torch.Tensor, int, int]:
        before = gpu.launcher.sequences
        image = renderer(seed=1)
        between = gpu.launcher.sequences
        gradient, = torch.autograd.grad(image, floor, cotangent(image.detach()))
        return image.detach(), gradient, between - before, gpu.launcher.sequences - between

    first, again = both_passes(), both_passes()
    assert renderer.repetitions.most == 15 and first[2] == 3 * again[2] and first[3] == again[3] > 0
    singly(monkeypatch)
    expected = both_passes()
    assert expected[2:] == (0, 0) and expected[0].std() > 0 and expected[1].abs().min() > 1e-3
    for found in (first, again):
        assert torch.equal(found[0], expected[0]) and torch.equal(found[1], expected[1])


@pytest.mark.parametrize("build", deep_but([room], [room, lit_room]))
@pytest.mark.parametrize("moving", [False, True], ids=["still", "moving"])
@pytest.mark.parametrize("settings", [{}, deep({"adjoint": rb.MemoizedAdjoint(2, keep_hits=False)}),
                                      deep({"share_samples": True})], ids=str)
def test_networks_are_asked_between_sequences_of_launches(settings, moving, build, gpu, monkeypatch):
    """Two of each bounce forwards; one backwards, unless slopes are asked, too, which is done from Python."""
    names = [name for name, _ in build().named_parameters()
             if "module" in name or name.endswith("reflectance.value") or (moving and name.endswith("to_world"))]
    settings, before = SMALL | settings, gpu.launcher.sequences
    image, gradients = rendered(build(dtype=torch.float32), names, **settings)
    assert gpu.launcher.sequences - before >= (2 if moving or len(settings) > len(SMALL) else 3) * SMALL["max_depth"] - 2
    singly(monkeypatch)
    before = gpu.launcher.sequences
    expected, others = rendered(build(dtype=torch.float32), names, **settings)
    assert gpu.launcher.sequences == before and expected.std() > 0 and torch.equal(image, expected)
    assert gradients.keys() == others.keys() and sum("module" in name for name in others) >= 8
    for name, other in others.items():
        assert torch.isfinite(other).all() and torch.equal(gradients[name], other), name
        assert other.abs().max() > 1e-4 or "module" not in name, name


@pytest.mark.parametrize("sampling", deep_but(["attached"], ["detached", "attached"]))
def test_tangents_have_the_bits_of_single_calls(sampling, gpu, monkeypatch):
    def tangents() -> torch.Tensor:
        scene = SCENES["two sides"](torch.float32)
        given = {name: torch.full_like(value, 0.1) for name, value in scene.named_parameters()
                 if name.endswith(("reflectance.value", "to_world"))}
        return rb.jvp(scene, given, seed=1, sampling=sampling, **SMALL)

    before = gpu.launcher.sequences
    taped = tangents()
    assert gpu.launcher.sequences > before
    singly(monkeypatch)
    expected = tangents()
    assert expected.std() > 0 and torch.equal(taped, expected)


@pytest.mark.parametrize("moving", [False, deep(True)], ids=["still", "moving"])
@pytest.mark.parametrize("name", deep_but(["boundaries"], MEDIA))
def test_tangents_through_media_are_those_of_single_calls(name, moving, gpu, monkeypatch):
    """In sequences of launches, one for each bounce; where boundaries move but for rounding, as above."""
    build, of = MEDIA[name]

    def tangents() -> tuple[torch.Tensor, int]:
        before, scene = gpu.launcher.sequences, build().to(torch.float32)
        names = [*of.NAMES, *(of.MOVING if moving else [])]
        given = {name: torch.full_like(scene.get_parameter(name), 0.1) for name in names}
        return rb.jvp(scene, given, seed=1, **SMALL), gpu.launcher.sequences - before

    taped, sequences = tangents()
    assert sequences >= 2 * SMALL["max_depth"] - 1  # of the image, and of the derivative
    singly(monkeypatch)
    expected, sequences = tangents()
    assert sequences == 0 and expected.std() > 0
    assert relative_error(taped, expected) <= (1e-6 if moving else 0.0)


@pytest.mark.parametrize("name", deep_but(["boundaries"], ["boundaries", "smoke"]))
def test_what_vertices_in_media_see_of_edges_is_found_in_sequences(name, gpu, monkeypatch):
    """The paths to them and those behind edges; whether these have passed all boundaries is found out after each."""
    build, of = MEDIA[name]

    def gradient() -> tuple[torch.Tensor, int]:
        before, scene = gpu.launcher.sequences, build().to(torch.float32)
        pose = scene.get_parameter(of.MOVING[0]).requires_grad_()
        image = rb.render(scene, seed=3, **SMALL | {"max_depth": 3, "terms": ("shadow",)})
        return torch.autograd.grad(image, pose, cotangent(image.detach()))[0], gpu.launcher.sequences - before

    taped, sequences = gradient()
    assert sequences > 3 + 2
    singly(monkeypatch)
    expected, sequences = gradient()
    assert sequences == 0 and expected.abs().max() > 1e-3 and relative_error(taped, expected) <= 1e-6


@pytest.mark.parametrize("term, scene", [("primary", {"sky": SKY, "mirror": MIRROR, "ball": BALL, "cube": CUBE}),
                                         ("shadow", None)], ids=["mirrors", "shadows"])
def test_places_where_images_jump_are_those_of_single_calls(term, scene, gpu, monkeypatch):
    """Ways by mirrors are followed in sequences of launches, and paths to what shadows are seen from; the host waits for how
    many go on."""
    def gradient() -> torch.Tensor:
        objects = load(torch.float32, sensor=VIEWED, **scene) if scene else cornell(torch.float32, 8)
        pose = next(value for name, value in objects.requires_grad_(False).named_parameters() if name.endswith("to_world"))
        pose.requires_grad_()
        image = rb.render(objects, seed=3, spp=4, max_depth=4, terms=(term,), compile=True, caster="warp")
        return torch.autograd.grad(image, pose, cotangent(image.detach()))[0]

    before = gpu.launcher.sequences
    taped = gradient()
    assert gpu.launcher.sequences > before + 4
    singly(monkeypatch)
    expected = gradient()
    assert expected.abs().max() > 1e-3 and torch.equal(taped, expected)


@pytest.mark.parametrize("light_paths, material", [("all", {"type": "roughconductor"}),
                                                   deep("caustics", {"type": "dielectric"})])
def test_paths_from_lamps_have_the_bits_of_single_calls(light_paths, material, gpu, monkeypatch):
    found = assert_same_bits(lambda: closed_box(material), gpu, monkeypatch, light_paths=light_paths)
    assert found > 3 * SMALL["max_depth"]  # of camera paths, and of those from lamps


@pytest.mark.parametrize("name", deep_but(["boundaries", "networks"], [*SCENES, *MEDIA, "networks"]))
def test_graphs_have_the_bits_of_launches(name, gpu, monkeypatch):
    """Of bounces, the rays among them. Here each sequence is made a graph, as if it had come before."""
    def build() -> rb.Scene:
        return (SCENES[name](torch.float32) if name in SCENES else room(dtype=torch.float32) if name == "networks"
                else MEDIA[name][0]().to(torch.float32))

    names = NETWORKS if name == "networks" else MEDIA[name][1].NAMES if name in MEDIA else None
    monkeypatch.setattr(Graphs, "of", lambda self, given, make: None)
    sequences, replays = gpu.launcher.sequences, gpu.launcher.replays
    expected, others = rendered(build(), names, **SMALL)
    assert gpu.launcher.replays == replays and gpu.launcher.sequences > sequences
    sequences = gpu.launcher.sequences
    monkeypatch.setattr(Graphs, "of", lambda self, given, make: make())
    image, gradients = rendered(build(), names, **SMALL)
    assert gpu.launcher.replays - replays == gpu.launcher.sequences - sequences > 0
    assert expected.std() > 0 and torch.equal(image, expected) and gradients.keys() == others.keys()
    for name, other in others.items():
        assert torch.isfinite(other).all() and torch.equal(gradients[name], other), name


def box(depth: int, adjoint: rb.MemoizedAdjoint) -> rb.Renderer:
    """A renderer of a closed box, in which no path ends before its time."""
    scene = cornell(torch.float32, 6)
    for name, value in scene.named_parameters():
        value.requires_grad_(name.endswith("reflectance.value"))
    return unwarned_renderer(scene, **SMALL | {"max_depth": depth, "rr_depth": 100, "adjoint": adjoint})


def both_ways(renderer: rb.Renderer) -> None:
    """An image and its gradients, on this thread."""
    image = renderer(seed=1)
    with torch.no_grad():  # as autograd's engine does, by which it would leave a mode
        RenderFunction.backward(image.grad_fn, cotangent(image.detach()))


@pytest.mark.parametrize("taped, adjoint", [(True, rb.MemoizedAdjoint()), (True, rb.MemoizedAdjoint(2, keep_hits=False)),
                                            (False, rb.MemoizedAdjoint(2, keep_hits=False)), *(
                                                deep(*case) for case in ((True, rb.MemoizedAdjoint(2)),
                                                                         (False, rb.MemoizedAdjoint()),
                                                                         (False, rb.MemoizedAdjoint(2))))], ids=repr)
def test_the_host_waits_for_nothing_between_bounces(taped, adjoint, gpu, monkeypatch):
    """And calls no function of lanes: what is left of a bounce in Python does not depend on what happens there."""
    monkeypatch.setattr("torch_radbp.rendering.cost.memory_of", lambda device: float("inf"))
    calls, prepared = Counter(), LaneFunction.prepared
    if not taped:
        singly(monkeypatch)

    def counted(self, arguments):
        calls[self.name] += 1
        return prepared(self, arguments)

    def of_depth(depth: int) -> tuple[Counter, Counter, int]:
        renderer = box(depth, adjoint)
        both_ways(renderer)
        both_ways(renderer)
        calls.clear()
        before = gpu.launcher.sequences
        found = exchanges(lambda: both_ways(renderer))
        return found, calls.copy(), gpu.launcher.sequences - before

    monkeypatch.setattr(LaneFunction, "prepared", counted)
    (few, called, once), (many, called_more, more) = of_depth(3), of_depth(5)
    waits = {what: count - few[what] for what, count in many.items() if count > few[what]}
    assert bool(waits) != taped, waits
    assert bool(called_more - called) != taped, called_more - called
    if adjoint.records_all:  # a sequence for each bounce, forwards and backwards
        assert more - once == (2 * 2 if taped else 0)
