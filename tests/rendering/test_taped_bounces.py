"""Bounces that are recorded and run as machine code: images and gradients have the bits that single operations give."""

import pytest
import torch

import torch_radbp as rb
from tests.deep import deep, deep_but
from tests.rendering.taped import SCENES, SETTINGS, SOME, WAYS, rendered, singly
from tests.scenes import cornell, diffuse, load, rectangle, rgb, sensor, sky_and_points, two_sided
from tests.scenes.everything import build_everything
from tests.scenes.networks import Function, lit_room, mlp, room
from torch_radbp.adjoint import record
from torch_radbp.jit.cpu.recorded import Recorded
from torch_radbp.jit.tape import RECORDINGS
from torch_radbp.jit.tiles import TILE
from torch_radbp.path import whole_paths

pytestmark = pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning", "ignore::torch_radbp.JumpWarning")


@pytest.fixture
def calls(monkeypatch) -> list[int]:
    """The lanes of each call of what was recorded, as they come."""
    found, call, run = [], Recorded.__call__, whole_paths.run_in_tiles

    def noting(self, given, lanes, *rest, **more):
        found.append(lanes)
        return call(self, given, lanes, *rest, **more)

    def noting_steps(steps, lanes):
        found.extend([lanes] * len(steps))
        return run(steps, lanes)

    monkeypatch.setattr(Recorded, "__call__", noting)
    monkeypatch.setattr(whole_paths, "run_in_tiles", noting_steps)
    return found


def assert_same_bits(build, calls, monkeypatch, **settings) -> None:
    """Recorded or not, images and gradients are the same, and tell something."""
    image, gradients = rendered(build(), **settings)
    assert len(calls) >= 2
    singly(monkeypatch)
    calls.clear()
    expected, others = rendered(build(), **settings)
    assert not calls and expected.std() > 0 and max(float(other.abs().max()) for other in others.values()) > 1e-3
    assert torch.equal(image, expected) and gradients.keys() == others.keys()
    for name, other in others.items():
        assert torch.isfinite(other).all() and torch.equal(gradients[name], other), name


@pytest.mark.parametrize("name, sampling", [case if case in SOME else deep(*case) for case in WAYS])
def test_images_and_gradients_have_the_same_bits(name, sampling, calls, monkeypatch):
    assert_same_bits(lambda: SCENES[name](torch.float32), calls, monkeypatch, sampling=sampling)


@pytest.mark.parametrize("adjoint", [rb.MemoizedAdjoint(2, keep_hits=False), rb.MemoizedAdjoint("log"), rb.ReplayAdjoint(),
                                     rb.QuadraticAdjoint()], ids=repr)
def test_so_they_have_with_every_strategy(adjoint, calls, monkeypatch):
    assert_same_bits(lambda: cornell(torch.float32), calls, monkeypatch, adjoint=adjoint)


@pytest.mark.parametrize("settings", [{"hide_emitters": True, "nee": False}, {"share_samples": True}, {"chunk": 50},
                                      {"max_depth": 1}, {"max_depth": 2}, {"spp": 1}], ids=str)
def test_so_they_have_with_other_settings(settings, calls, monkeypatch):
    assert_same_bits(lambda: two_sided(torch.float32), calls, monkeypatch, **settings)


@pytest.mark.parametrize("dtype", [deep(torch.float32), torch.float64], ids=str)  # above all is of float32
@pytest.mark.parametrize("name", deep_but(["shapes"], ["materials", "shapes", "textures", "lamps"]))
def test_so_they_have_with_every_plugin(name, dtype, calls, monkeypatch):
    def build() -> rb.Scene:
        scene = build_everything(name).to(dtype)
        for view in scene.sensors:
            view.film.width = view.film.height = view.film.crop_width = view.film.crop_height = 6
        return scene

    assert_same_bits(build, calls, monkeypatch)


def test_a_loop_that_moves_a_mesh_and_changes_colours_uses_the_same_recordings(calls):
    scene, other = sky_and_points(torch.float32), sky_and_points(torch.float32)
    name = next(name for name, _ in scene.named_parameters() if name.endswith("vertex_positions"))
    renderer, fresh = (rb.Renderer(own, **SETTINGS) for own in (scene, other))
    renderer(seed=0)
    with torch.no_grad():
        renderer(seed=0)  # whose paths are traced whole
    known = len(RECORDINGS.known)
    for step in range(3):
        for own in (scene, other):
            with torch.no_grad():
                own.get_parameter(name).mul_(1.05)
        with torch.no_grad():
            image = renderer(seed=step)
        assert len(RECORDINGS.known) == known and calls
        with pytest.MonkeyPatch.context() as patch, torch.no_grad():
            singly(patch)
            assert torch.equal(image, fresh(seed=step)) and image.std() > 0


def test_rays_are_counted(monkeypatch):
    def rays() -> int:
        renderer = rb.Renderer(cornell(torch.float32), **SETTINGS)
        call = renderer.prepare(1, None, None, None)
        renderer(seed=1)
        return call.caster.rays_cast

    found = rays()
    singly(monkeypatch)
    assert found == rays() > 0


@pytest.mark.parametrize("build, settings", [
    (room, {"adjoint": rb.MemoizedAdjoint(2, keep_hits=False)}), (lit_room, {"sampling": "detached"}),
    *(deep(build, settings) for build in (room, lit_room) for settings in (
        {"sampling": "attached"}, {"nee": False}, {"adjoint": rb.ReplayAdjoint()}, {"chunk": 40}, {"share_samples": True})),
    deep(room, {"sampling": "detached"}), deep(lit_room, {"adjoint": rb.MemoizedAdjoint(2, keep_hits=False)})],
                         ids=lambda value: value.__name__ if callable(value) else str(value))
def test_so_they_have_with_networks(build, settings, calls, monkeypatch):
    assert_same_bits(lambda: build(dtype=torch.float32), calls, monkeypatch, **settings)


@pytest.mark.parametrize("sampling", ["detached", deep("attached")])
def test_so_they_have_where_only_networks_are_wanted(sampling, calls, monkeypatch):
    def build() -> rb.Scene:
        scene = room(torch.float32)
        for name, parameter in scene.named_parameters():
            parameter.requires_grad_("module" in name)
        return scene

    assert_same_bits(build, calls, monkeypatch, sampling=sampling)


def test_recordings_serve_other_networks(calls):
    renderers = [rb.Renderer(cornell(torch.float32), **SETTINGS) for _ in range(2)]
    for seed, renderer in enumerate(renderers):
        renderer.scene.white.reflectance = rb.NeuralTexture(mlp(2, 3, seed, width=4 + seed))
    images = [renderers[0](seed=1).detach()]
    known = len(RECORDINGS.known)
    images.append(renderers[1](seed=1).detach())
    assert calls and len(RECORDINGS.known) == known
    with pytest.MonkeyPatch.context() as patch:
        singly(patch)
        for image, renderer in zip(images, renderers):
            assert torch.equal(image, renderer(seed=1).detach()) and image.std() > 0
    assert not torch.equal(*images)


def test_errors_of_networks_are_told(calls):
    scene = cornell(torch.float32)
    scene.white.reflectance = rb.NeuralTexture(Function(lambda uv: torch.where(uv[:, :1] > 0.5, -1.0, 0.5)))
    with pytest.raises(ValueError, match="white.reflectance"):
        rb.Renderer(scene, **SETTINGS)(seed=1)
    assert calls


def row_of_lamps() -> rb.Scene:
    """Nine lamps over a floor."""
    lamps = {f"lamp_{k}": rectangle((0.4 * k - 1.6, 1.5, 0.3), 0.1, angle=90, emitter={
        "type": "area", "radiance": rgb(9, k, 6)}) for k in range(9)}
    return load(torch.float32, sensor=sensor(8, (0, 1, 3.5), (0, 0.3, 0), 45), **lamps,
                floor=rectangle((0, -0.5, 0), 1.5, angle=-90, bsdf=diffuse(0.5, 0.6, 0.7)))


@pytest.mark.parametrize("build, sampling", [
    (row_of_lamps, "detached"), *(deep(lambda: lit_room(lamps=9, dtype=torch.float32), sampling)
                                  for sampling in ("detached", "attached"))], ids=["row-detached", "detached", "attached"])
def test_so_they_have_where_lamps_are_picked_by_place(build, sampling, calls, monkeypatch):
    assert_same_bits(build, calls, monkeypatch, sampling=sampling)


def test_a_far_plane_is_heeded_though_the_scene_was_recorded_without_it(calls):
    scene, cut = cornell(torch.float32), cornell(torch.float32)
    cut.sensors[0].far_clip = 3.6  # before the back wall
    with torch.no_grad():
        whole, seen = (rb.Renderer(own, **SETTINGS)(seed=1) for own in (scene, cut))
    assert len(calls) == 2 * SETTINGS["max_depth"] and seen.std() > 0 and not torch.equal(whole, seen)
    with pytest.MonkeyPatch.context() as patch, torch.no_grad():
        singly(patch)
        assert torch.equal(seen, rb.Renderer(cut, **SETTINGS)(seed=1))


@pytest.mark.parametrize("settings", [{}, {"hide_emitters": True}, {"nee": False}, {"max_depth": 2},
                                      {"rr_depth": 1, "max_depth": 20}], ids=str)
@pytest.mark.parametrize("name", ["closed box", "textures", "two sides", "sky and points"])
def test_paths_that_are_traced_whole_have_the_same_bits(name, settings, monkeypatch):
    def image() -> torch.Tensor:
        with torch.no_grad():
            return rb.Renderer(SCENES[name](torch.float32), **SETTINGS | {"spp": 80} | settings)(seed=3)

    tiles, run = [], whole_paths.run_in_tiles
    monkeypatch.setattr(whole_paths, "run_in_tiles", lambda steps, lanes: tiles.append(lanes) or run(steps, lanes))
    found = image()
    assert max(tiles) > TILE
    singly(monkeypatch)
    tiles.clear()
    expected = image()
    assert not tiles and expected.std() > 0 and torch.equal(found, expected)


def test_rays_of_paths_that_are_traced_whole_are_counted(monkeypatch):
    def rays() -> int:
        renderer = rb.Renderer(cornell(torch.float32), **SETTINGS)
        call = renderer.prepare(1, None, None, None)
        with torch.no_grad():
            renderer(seed=1)
        return call.caster.rays_cast

    found = rays()
    singly(monkeypatch)
    assert found == rays() > 0


def test_derivatives_that_are_traced_apart_have_the_same_bits(calls, monkeypatch):
    monkeypatch.setattr(record, "MANY", 1)
    assert_same_bits(lambda: cornell(torch.float32, 12), calls, monkeypatch)


FORWARD = {"still": ("reflectance.value", "reflectance.data", "radiance.value"),
           "moving": ("reflectance.value", "to_world", "vertex_positions")}


@pytest.mark.parametrize("what, sampling", [("still", "detached"), ("moving", "hybrid"), deep("moving", "detached"),
                                            deep("moving", "attached")])
@pytest.mark.parametrize("name", ["closed box", *map(deep, ["textures", "two sides"])])
def test_tangents_of_paths_that_are_traced_whole_have_the_same_bits(name, what, sampling, monkeypatch):
    scene, generator = SCENES[name](torch.float32), torch.Generator().manual_seed(2)
    tangents = {own: 0.1 * torch.randn(value.shape, generator=generator) for own, value in scene.named_parameters()
                if own.endswith(FORWARD[what])}
    settings = SETTINGS | {"spp": 80, "sampling": sampling}

    def derivative(**more) -> torch.Tensor:
        found = rb.jvp(scene, tangents, seed=3, **settings, **more)
        return found[0] if more else found

    tiles, run = [], whole_paths.run_in_tiles
    monkeypatch.setattr(whole_paths, "run_in_tiles", lambda steps, lanes: tiles.append(lanes) or run(steps, lanes))
    found = [derivative(), derivative()]  # recorded, and as it was recorded
    assert max(tiles) > TILE
    tiles.clear()
    found.append(derivative(aovs=["depth"]))  # which are shown each bounce
    singly(monkeypatch)
    found.append(derivative())
    assert not tiles and found[0].std() > 0
    assert all(torch.equal(found[0], other) for other in found)
