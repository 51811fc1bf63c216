"""Media that emit light: closed forms and integrals; the gradient of every strategy, stride and way of running against the
tape's; forward mode; differences, also where extinction or emission is 0."""

from __future__ import annotations

import math
from itertools import product

import pytest
import torch

import torch_radbp as rb
from tests.deep import deep, deep_but
from tests.gradients import (
    FEW,
    MOVED,
    SOME,
    assert_informative,
    assert_transposed,
    gradients_by_seed,
    image_and_gradients,
    relative_error,
)
from tests.medium.compared import Move, compared
from tests.rendering.taped import assert_recorded_alike
from tests.scenes import diffuse, load, overhead, rectangle, rgb
from tests.scenes.media import BLACK
from tests.scenes.smoke import MOVING, NAMES, NULL, SETTINGS, box, grid, placed, room, varied

KINDS = ("homogeneous", "heterogeneous")
E, SIGMA, LENGTH = (0.5, 1.0, 2.0), (0.7, 0.35, 1.4), 2.0
EMISSION = "box.interior.emission"


def glowing(kind: str, sigma=SIGMA, emission=E, albedo: float = 0.0, **more) -> dict:
    """A medium that is the same everywhere."""
    even = torch.tensor(sigma, dtype=torch.float64).expand(9, 5, 12, 3).contiguous()
    sigma_t = rgb(*sigma) if kind == "homogeneous" else {"type": "gridvolume", "data": even, "to_world": placed()}
    return {"type": kind, "albedo": albedo, "sigma_t": sigma_t, "emission": rgb(*emission), **more}


def alone(medium: dict, width: int = 2):
    """A box of it, of which a camera from afar sees the middle; there is no other light."""
    return load(torch.float64, camera=overhead(width, 40.0, 0.04), box=box(medium))


def pixels(medium: dict, **settings) -> torch.Tensor:
    """(64, 3) the colours of pixels of it alone: they are independent, and their means are alike."""
    return rb.render(alone(medium, 8), spp=1023, seed=1, **settings)[0].flatten(1).T


def assert_mean(samples: torch.Tensor, wanted, most: float = 0.02) -> None:
    """The mean of independent colours is as wanted, and known well enough to tell. Rays begin a little off surfaces: by
    1e-5 at most."""
    wanted = torch.as_tensor(wanted, dtype=samples.dtype)
    error = samples.std(0) / math.sqrt(len(samples))
    assert bool((wanted != 0).all()) and bool((error < most * wanted.abs()).all())
    assert bool(((samples.mean(0) - wanted).abs() <= 4 * error + 1e-5 * wanted.abs()).all()), samples.mean(0)


@pytest.mark.parametrize("compile", [deep(False, id="eager"), pytest.param(True, id="compiled")])
@pytest.mark.parametrize("depth", [1, 3], ids=["last", "flies"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_slab_that_absorbs_emits_what_the_integral_says(kind, depth, compile):
    """e (1 - exp(-sigma l)) / sigma."""
    wanted = [e * (1 - math.exp(-s * LENGTH)) / s for e, s in zip(E, SIGMA)]
    assert_mean(pixels(glowing(kind), max_depth=depth, compile=compile), wanted)


@pytest.mark.parametrize("depth", [1, 3], ids=["last", "flies"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_slab_that_absorbs_nothing_emits_by_its_length(kind, depth):
    assert_mean(pixels(glowing(kind, (0.0, 0.0, 0.0)), max_depth=depth), [e * LENGTH for e in E])


def test_of_one_colour_an_even_medium_emits_without_noise():
    image = rb.render(alone(glowing("homogeneous", (0.7, 0.7, 0.7))), spp=4, max_depth=1, seed=1)
    wanted = torch.tensor(E, dtype=torch.float64) * (1 - math.exp(-0.7 * LENGTH)) / 0.7
    torch.testing.assert_close(image, wanted[:, None, None].expand(1, 3, 2, 2), rtol=1e-5, atol=0)


def flame(emission=None, kind: str = "heterogeneous") -> dict:
    """Smoke, or fog, that glows from point to point; nowhere without extinction, since replay is wrong there."""
    if emission is None:
        emission = {"type": "gridvolume", "data": 1.5 * grid(3, (4, 6, 5)), "to_world": placed()}
    if kind == "heterogeneous":
        dense = {"type": "gridvolume", "data": 0.1 + grid(3), "to_world": placed()}
        return {**varied(3), "sigma_t": dense, "emission": emission}
    return {"type": kind, "albedo": rgb(0.9, 0.6, 0.3), "sigma_t": rgb(0.7, 0.4, 0.9), "scale": 2.0, "emission": emission,
            "phase": {"type": "hg", "g": 0.4}}


def both(kind: str) -> list[str]:
    own = {"heterogeneous": ["sigma_t.data", "albedo.data"], "homogeneous": ["sigma_t.value.value", "albedo.value.value"]}
    return [f"{EMISSION}.data", *(f"box.interior.{name}" for name in own[kind]), *NAMES[2:]]


@pytest.mark.parametrize("compile, kind, strategies", [
    pytest.param(False, "homogeneous", FEW, id="few"), *(deep(*case, SOME) for case in product((False, True), KINDS))])
def test_every_strategy_and_stride_gives_the_gradient_of_the_tape(compile, kind, strategies):
    names, scene = both(kind), room(flame(kind=kind))
    image, expected = image_and_gradients(scene, names, **SETTINGS | {"adjoint": rb.TapeAdjoint()})
    assert_informative(image, expected)
    for adjoint in strategies:
        found, gradients = image_and_gradients(scene, names, compile=compile, **SETTINGS | {"adjoint": adjoint})
        assert relative_error(found, image) < 1e-12
        for name, gradient, wanted in zip(names, gradients, expected):
            assert relative_error(gradient, wanted) < 1e-10, (adjoint, name)


@pytest.mark.parametrize("compile, kind", [
    deep(False, "heterogeneous"), (False, "homogeneous"), deep(True, "heterogeneous"), deep(True, "homogeneous")])
def test_forward_mode_is_the_transpose_of_backward(compile, kind):
    """By emission, extinction and albedo."""
    assert_transposed(room(flame(kind=kind)), *both(kind)[:3], **SETTINGS | {"compile": compile})


@pytest.mark.parametrize("compile, sampling, kind, strategies", [
    pytest.param(True, "hybrid", "heterogeneous", FEW, id="few"),
    *(deep(*case, MOVED) for case in product((False, True), ("detached", "hybrid", "attached"), KINDS))])
def test_every_strategy_gives_the_gradient_of_the_tape_of_what_moves(compile, sampling, kind, strategies):
    names, settings = [*MOVING, *both(kind)[:3]], SETTINGS | {"sampling": sampling}
    scene = room(flame(kind=kind), half=0.9)
    image, expected = image_and_gradients(scene, names, **settings | {"adjoint": rb.TapeAdjoint()})
    assert_informative(image, expected)
    for adjoint in strategies:
        found, gradients = image_and_gradients(scene, names, compile=compile, **settings | {"adjoint": adjoint})
        assert relative_error(found, image) < 1e-12
        for name, gradient, wanted in zip(names, gradients, expected):
            assert (gradient - wanted).abs().max() <= 1e-10 * wanted.abs().max(), (adjoint, name)


@pytest.mark.parametrize("compile, kind", [
    (False, "heterogeneous"), deep(False, "homogeneous"), deep(True, "heterogeneous"), deep(True, "homogeneous")])
def test_forward_mode_is_the_transpose_of_backward_of_what_moves(compile, kind):
    assert_transposed(room(flame(kind=kind), half=0.9), *MOVING,
                      **SETTINGS | {"terms": ("interior",), "max_depth": 3, "compile": compile})


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("settings", [{}, deep({"adjoint": rb.MemoizedAdjoint(2, keep_hits=False)}), deep({"chunk": 40}),
                                      deep({"nee": False, "spp": 99})], ids=str)
def test_bounces_that_are_recorded_have_the_bits_of_single_operations(settings, kind, monkeypatch):
    assert_recorded_alike(lambda: room(flame(kind=kind)).to(torch.float32), both(kind), monkeypatch, **SETTINGS | settings)


@pytest.mark.parametrize("channels", [1, 3])
def test_a_grid_emits_what_the_integral_over_rays_says(channels):
    """Along z, in which alone extinction and emission change: int T e dt by the trapezoidal rule."""
    sigma, emission = 1.3 * grid(channels)[:, :1, :1], 2.0 * grid(3, (6, 1, 1))
    medium = {"type": "heterogeneous", "albedo": 0.0, "scale": 1.5,
              "sigma_t": {"type": "gridvolume", "data": sigma, "to_world": placed()},
              "emission": {"type": "gridvolume", "data": emission, "to_world": placed()}}
    steps = 1 << 14
    z = 1.0 - (torch.arange(steps + 1, dtype=torch.float64) / steps)  # from the top, in the unit cube

    def along(data: torch.Tensor) -> torch.Tensor:
        place = (z * len(data) - 0.5).clamp(0, len(data) - 1)
        low = place.long().clamp_max(len(data) - 2)
        values = data.reshape(len(data), -1)
        return torch.lerp(values[low], values[low + 1], (place - low)[:, None])

    thickness = torch.cumulative_trapezoid(1.5 * along(sigma), dx=LENGTH / steps, dim=0)
    thickness = torch.cat([torch.zeros_like(thickness[:1]), thickness])
    wanted = torch.trapezoid(torch.exp(-thickness) * along(emission), dx=LENGTH / steps, dim=0)
    for depth in (1, 3):
        assert_mean(pixels(medium, max_depth=depth), wanted)


@pytest.mark.parametrize("kind", deep_but(["heterogeneous"], KINDS))
def test_in_thermal_equilibrium_radiance_is_1(kind):
    """Where a medium emits what it absorbs at a radiance of 1 (Kirchhoff), all that light passes has that radiance: a stone
    that reflects all light in smoke in fog, under a sky."""
    albedo, sigma = torch.tensor([0.9, 0.6, 0.3]), torch.tensor([0.3, 0.5, 0.9])
    fog = {"type": "homogeneous", "albedo": rgb(*albedo.tolist()), "sigma_t": rgb(*sigma.tolist()),
           "emission": rgb(*(sigma * (1 - albedo)).tolist())}
    inner = {"type": "homogeneous", "albedo": 0.5, "sigma_t": 2.0, "emission": 1.0}
    if kind == "heterogeneous":
        inner = {**inner, "type": kind, "sigma_t": {"type": "gridvolume", "data": 3.0 * grid(), "to_world": placed(0.5)},
                 "emission": {"type": "gridvolume", "data": 1.5 * grid(), "to_world": placed(0.5)}}
    core = {**box(inner, 0.5), "exterior": {"type": "ref", "id": "fog"}}
    scene = load(torch.float64, fog=fog, camera=overhead(4, 4.0, 1.0), sky={"type": "constant"},
                 box=box({"type": "ref", "id": "fog"}), core=core,
                 stone={"type": "sphere", "center": [0, 0, 1.5], "radius": 0.2, "bsdf": diffuse(1, 1, 1)})
    image = rb.render(scene, spp=1 << 13, max_depth=64, rr_depth=100, nee=False, seed=1)
    error = image.mean((0, 1)).flatten() - 1.0
    assert abs(float(error.mean())) < 4 * float(error.std()) / math.sqrt(len(error)) < 0.01


@pytest.mark.parametrize("emission, sigma", [(0.0, 0.7), (1.0, 0.0), (1.0, 0.7)],
                         ids=["emits nothing", "absorbs nothing", "emits and absorbs"])
@pytest.mark.parametrize("kind", KINDS)
def test_derivatives_are_those_of_the_closed_form(kind, emission, sigma):
    """By emission int T dt = (1 - exp(-x)) / sigma with x = sigma l, by extinction e int -t T dt."""
    scene = alone(glowing(kind, (sigma,) * 3, (emission,) * 3))
    x, length = sigma * LENGTH, LENGTH
    own = "sigma_t.value.value" if kind == "homogeneous" else "sigma_t.data"
    by_sigma = -length**2 / 2 if sigma == 0 else (length * math.exp(-x) - (1 - math.exp(-x)) / sigma) / sigma
    wanted = {f"{EMISSION}.value.value": length if sigma == 0 else (1 - math.exp(-x)) / sigma,
              f"box.interior.{own}": emission * by_sigma}
    gradients = gradients_by_seed(scene, list(wanted), range(8), torch.full((1, 3, 2, 2), 1 / 4, dtype=torch.float64),
                                  spp=2048, max_depth=3)
    for each, derivative in zip(zip(*gradients), wanted.values()):
        found = torch.stack([gradient.reshape(-1, 3).sum(0) for gradient in each])
        if derivative == 0.0:
            assert not found.any()
        else:
            assert_mean(found, [derivative] * 3, 0.03)


@pytest.mark.parametrize("kind, which, spp", [
    ("homogeneous", slice(4), 1 << 12), ("heterogeneous", slice(0, 4, 2), 1 << 10),
    deep("heterogeneous", slice(1, 4, 2), 1 << 18)], ids=["homogeneous", "heterogeneous", "grid of extinction"])
def test_derivatives_are_those_of_differences(kind, which, spp):
    """By emission, extinction, albedo and scale, of light that is scattered on its way, too; along the derivative of the
    image, which differences tell well enough. By extinctions of grids they have the most noise."""
    moves = [Move(name, step) for name, step in zip(both(kind), (0.3, 0.1, 0.1, 0.3))]
    for found in compared(alone(flame(kind=kind)), moves[which], spp=spp, along=True, max_depth=4):
        found.assert_agrees(0.1)


@pytest.mark.parametrize("moves", [[("box.to_world", 0.05), ("core.to_world", 0.05)], deep([("camera.to_world", 0.02)])],
                         ids=["boxes", "camera"])
def test_derivatives_by_what_moves_are_those_of_differences(moves):
    """Boxes of flames in fog that glows, with edges out of view, over a floor without end; the grids stand still. Directions
    follow no point that rays meet: where flights end decides what that is, and light is emitted before."""
    pose = torch.diag(torch.tensor([9.0, 9.0, 0.7, 1.0], dtype=torch.float64))
    pose[2, 3] = 1.5
    inner = torch.diag(torch.tensor([7.0, 7.0, 0.3, 1.0], dtype=torch.float64))
    inner[2, 3] = 1.5
    wide = placed(3.0, 1.5)
    fog = {"type": "homogeneous", "sigma_t": rgb(0.5, 0.4, 0.3), "albedo": 0.4,
           "emission": {"type": "gridvolume", "data": 0.2 + grid(3, (8, 4, 5)), "to_world": wide}}
    sigma_t = {"type": "gridvolume", "data": 0.5 + 2.0 * grid(1, (9, 5, 3)), "to_world": wide}
    dust = {"type": "heterogeneous", "sigma_t": sigma_t, "albedo": 0.5,
            "emission": {"type": "gridvolume", "data": 3.0 * grid(3, (5, 4, 6)), "to_world": wide}}
    scene = load(torch.float64, fog=fog, camera=overhead(2, 4.0, 1.3),
                 floor=rectangle((0, 0, 0), 2e3, bsdf=diffuse(0.5, 0.4, 0.3)),
                 box={"type": "cube", "to_world": pose, "bsdf": NULL, "interior": {"type": "ref", "id": "fog"}},
                 core={"type": "cube", "to_world": inner, "bsdf": NULL, "interior": dust,
                       "exterior": {"type": "ref", "id": "fog"}})
    for found in compared(scene, [Move(*move) for move in moves], spp=1 << 10, along=True, max_depth=3):
        found.assert_agrees(0.1)


def test_where_a_slab_of_glowing_fog_is_does_not_matter():
    """Over a reflecting floor without end it does; over a black one the derivative by a shift is 0, also of light that is
    scattered twice. Directions that follow what rays meet would tell that by what flights end before."""
    pose = torch.diag(torch.tensor([9.0, 9.0, 0.7, 1.0], dtype=torch.float64))
    pose[2, 3] = 1.5
    fog = {"type": "homogeneous", "sigma_t": rgb(0.5, 0.4, 0.3), "albedo": 0.4, "emission": 1.0}
    shift = torch.zeros(4, 4, dtype=torch.float64)
    shift[2, 3] = 1.0
    found = []
    for bsdf in (diffuse(0.5, 0.4, 0.3), BLACK):
        scene = load(torch.float64, camera=overhead(8, 4.0, 1.3), floor=rectangle((0, 0, 0), 2e3, bsdf=bsdf),
                     box={"type": "cube", "to_world": pose, "bsdf": NULL, "interior": fog})
        found.append(rb.jvp(scene, {"box.to_world": shift}, seed=1, spp=1 << 9, max_depth=3, terms=("interior",)).mean(1))
    error = found[0].std() / found[0].numel()**0.5
    assert found[0].mean().abs() > 20 * error > 0 and found[1].abs().max() < 1e-10 * found[0].mean().abs()


def test_what_emits_is_read_and_written(tmp_path):
    for kind in KINDS:
        scene = room(flame(kind=kind)).float()
        rb.save(scene, tmp_path / "scene.xml")
        again = rb.load(tmp_path / "scene.xml")
        assert kind in (tmp_path / "scene.xml").read_text() and both(kind)[0] in dict(again.named_parameters())
        image, other = (rb.render(each, spp=4, max_depth=3, seed=1, compile=False) for each in (scene, again))
        assert image.max() > 0 and torch.equal(image, other)


@pytest.mark.parametrize("kind", KINDS)
def test_a_network_emits_with_gradients_of_its_weights(kind):
    network = torch.nn.Sequential(torch.nn.Linear(3, 3), torch.nn.Softplus()).double()
    scene = alone(glowing(kind))
    scene.box.interior.emission = rb.NeuralVolume(network, 8, placed()).double()
    names = [f"{EMISSION}.module.0.{name}" for name in ("weight", "bias")]
    image, expected = image_and_gradients(scene, names, **SETTINGS | {"adjoint": rb.TapeAdjoint()})
    assert_informative(image, expected)
    _, gradients = image_and_gradients(scene, names, **SETTINGS)
    assert all(relative_error(gradient, wanted) < 1e-10 for gradient, wanted in zip(gradients, expected))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("emission, message", [
    (-1.0, "emission must be at least 0, got -1"),
    (math.nan, "emission must be finite"), (math.inf, "emission must be finite"),
    ({"type": "gridvolume", "data": -torch.ones(2, 2, 2)}, "data must be at least 0, got -1"),
    ({"type": "gridvolume", "data": torch.ones(2, 2, 2, 6)}, "emission of .* must have 1 or 3 channels"),
    ({"type": "gridvolume", "data": torch.full((2, 2, 2), math.nan)}, "NaN or infinite")], ids=str)
def test_emission_that_makes_no_sense_is_refused_by_name(kind, emission, message):
    with pytest.raises(rb.SceneError, match=message):
        alone({**glowing(kind), "emission": emission})


def test_without_emission_a_scene_in_the_dark_is_refused():
    with pytest.raises(rb.SceneError, match="no emitter"):
        alone({"type": "homogeneous"})


def test_paths_from_lamps_leave_the_light_of_media_to_the_camera():
    """A mirror beside the lamp, so that there is light of both."""
    scene = room(flame(), mirror=rectangle((-2.0, 0, 1.5), 0.8, (0, 1, 0), 60, bsdf={"type": "conductor"}))
    renderers = [rb.Renderer(scene, spp=128, max_depth=4, light_paths=each) for each in ("camera", "caustics", "all")]
    of_cameras, *others = (torch.stack([renderer(seed=seed).mean((0, 2, 3)) for seed in range(6)]) for renderer in renderers)
    for found in others:
        difference, error = of_cameras.mean(0) - found.mean(0), ((of_cameras.var(0) + found.var(0)) / 6).sqrt()
        assert (difference.abs() < 4 * error).all() and (error < 0.05 * of_cameras.mean(0)).all()
