"""Derivatives of paths from lamps: every strategy, both modes, and differences."""

import math
import warnings
from itertools import product

import pytest
import torch
from torch import Tensor

import torch_radbp as rb
from tests.deep import deep, deep_but
from tests.gradients import (
    FEW,
    SOME,
    assert_informative,
    assert_transposed,
    image_and_gradients,
    relative_error,
    unwarned_renderer,
)
from tests.light_paths.scenes import BALL, LAMPS, camera_named, lit_ball
from tests.scenes import diffuse, load, look_at, overhead, rectangle, rgb

GLASS, ROUGH, PLASTIC = {"type": "dielectric"}, {"type": "roughdielectric", "alpha": 0.3}, {"type": "plastic"}
ROWS = {
    "point over a diffuse ball": ("point", {}, ["lamp.position", "lamp.intensity.value", "floor.bsdf.reflectance.value",
                                                "floor.to_world", "camera.to_world", "ball.to_world"]),
    "spot through glass": ("spot", {"bsdf": GLASS}, ["lamp.to_world", "lamp.cutoff_angle", "floor.to_world", "ball.to_world",
                                                     "camera.to_world", "camera.x_fov", "ball.bsdf.eta"]),
    "area through rough glass": ("area", {"bsdf": ROUGH}, ["lamp.to_world", "lamp.emitter.radiance.data",
                                                           "ball.bsdf.alpha.value"]),
    "projector beside plastic": ("projector", {"bsdf": PLASTIC}, ["lamp.to_world", "lamp.irradiance.data"]),
    "directional by a beam": ("directionalarea", {"bsdf": GLASS}, ["lamp.emitter.radiance.value", "ball.to_world"]),
    "sun": ("directional", {"bsdf": GLASS}, ["lamp.to_world", "lamp.irradiance.value", "ball.to_world"]),
    "sky over plastic": ("envmap", {"bsdf": PLASTIC}, ["lamp.data", "ball.bsdf.diffuse_reflectance.value"]),
}
# All light, by a lamp without mirrors and by one with, and caustics; each sampling once.
QUICK = [("point over a diffuse ball", "detached", "all", FEW), ("spot through glass", "hybrid", "all", SOME),
         ("spot through glass", "attached", "caustics", FEW)]
# Plain torch, which is quicker here, of all lamps; compiled code, and attached sampling, through glass.
TRANSPOSED = {*((row, "hybrid", False) for row in ROWS),
              ("spot through glass", "attached", False), ("spot through glass", "hybrid", True)}
pytestmark = pytest.mark.filterwarnings("ignore")


def scene_of(row: str) -> tuple[rb.Scene, list[str]]:
    lamp, ball, names = ROWS[row]
    return lit_ball(lamp, dtype=torch.float64, size=6, rfilter="gaussian", **ball), names


def result(row: str, light_paths: str, **settings) -> tuple[Tensor, list[Tensor]]:
    scene, names = scene_of(row)
    return image_and_gradients(scene, names, spp=48, light_paths=light_paths, terms=("interior",), max_depth=4, **settings)


@pytest.mark.parametrize("row, sampling, light_paths, strategies", [
    *QUICK, *(deep(*case, SOME) for case in product(ROWS, ("hybrid", "detached", "attached"), ("caustics", "all"))
              if (*case, SOME) not in QUICK)],
    ids=lambda value: f"{len(value)} strategies" if type(value) is tuple else value)
def test_every_strategy_and_stride_gives_the_gradient_of_the_tape(row, sampling, light_paths, strategies):
    image, expected = result(row, light_paths, sampling=sampling, adjoint=rb.TapeAdjoint(), compile=False)
    if light_paths == "all":
        assert_informative(image, expected)
    for adjoint in strategies:
        for compile in (True, False)[:1 + (adjoint == strategies[0])]:
            found, gradients = result(row, light_paths, sampling=sampling, adjoint=adjoint, compile=compile)
            assert relative_error(found, image) < 1e-12
            for name, gradient, wanted in zip(ROWS[row][2], gradients, expected):
                assert (gradient - wanted).abs().max() <= 1e-10 * wanted.abs().max().clamp_min(1e-6), (adjoint, name)


@pytest.mark.parametrize("row, sampling, compile", [case if case in TRANSPOSED else deep(*case) for case in product(
    ROWS, ("hybrid", "attached"), (False, True))])
def test_forward_mode_and_the_backward_pass_are_transposed(row, sampling, compile):
    scene, names = scene_of(row)
    assert_transposed(scene, names[0], spp=4, max_depth=4 if row == "spot through glass" else 3, light_paths="all",
                      terms=("interior",), sampling=sampling, compile=compile)


def over_a_floor(lamp: dict, height: float = 1.0, **objects) -> rb.Scene:
    """A lamp over a floor at which a camera looks down from below all else: no edge is lit, none is in view."""
    return load(torch.float64, integrator={"type": "path", "max_depth": 5}, camera=overhead(16, height, 0.5, "gaussian"),
                floor=rectangle((0, 0, 0), 20.0, bsdf=diffuse(0.6, 0.5, 0.4)), lamp=lamp, **objects)


def pane(height: float, **bsdf) -> dict:
    return rectangle((0, 0, height), 9.0, bsdf={"type": "dielectric", "specular_reflectance": 0.0} | bsdf)


def plate(lamp: dict, **bsdf) -> rb.Scene:
    """A half space of glass, in which the camera is."""
    return over_a_floor(lamp, glass=pane(1.5, **bsdf))


SPOT = {"type": "spot", "to_world": look_at((0.2, 0.1, 2.5), (0, 0, 0), (0, 1, 0)), "cutoff_angle": 40.0,
        "intensity": rgb(9, 9, 9)}
PANEL = rectangle((0, 0, 2.5), 0.3, (1, 0, 0), 180, emitter={"type": "area", "radiance": rgb(9, 9, 9)})
BULB = {"type": "point", "position": [0.1, 0, 1.6], "intensity": rgb(9, 9, 9)}
SUN = {"type": "directional", "direction": [0.1, 0.2, -1.0], "irradiance": rgb(3, 4, 5)}
ACROSS = torch.linspace(-1.0, 1.0, 64) ** 2
PARABOLA = -(ACROSS + ACROSS[:, None])[..., None].numpy()
BUMPS = {"type": "bumpmap", "scale": 0.3,
         "arbitrary": {"type": "bitmap", "data": PARABOLA, "raw": True, "wrap_mode": "clamp"},
         "bsdf": {"type": "dielectric", "specular_reflectance": 0.0}}


def bumpy_plate() -> rb.Scene:
    """A lens of bumps, wider than the light."""
    return over_a_floor(SPOT | {"to_world": look_at((0, 0, 2.5), (0, 0, 0), (0, 1, 0))},
                        glass=rectangle((0, 0, 1.5), 1.5, bsdf=BUMPS))


def bulb_in_a_ball() -> rb.Scene:
    return over_a_floor(BULB, 0.9, glass={"type": "sphere", "center": [0, 0, 1.5], "radius": 0.5, "bsdf": GLASS})


def ball_below_a_bulb() -> rb.Scene:
    """Rays slide over the triangles of the ball where they leave it, and their bulb sees its outline."""
    return over_a_floor(BULB | {"position": [0.1, 0, 2.6]}, 0.9,
                        glass={"type": "sphere", "center": [0, 0, 1.5], "radius": 0.4, "bsdf": GLASS})


def bulb_below_a_mirror(**bsdf) -> rb.Scene:
    mirror = {"type": "sphere", "center": [0, 0, 2.5], "radius": 0.5, "bsdf": {"type": "conductor"} | bsdf}
    return over_a_floor(BULB, mirror=mirror)


def two_panes() -> rb.Scene:
    """Light enters water through a sheet of glass on it."""
    return over_a_floor(SPOT, upper=pane(1.8, int_ior=1.5, ext_ior=1.0), lower=pane(1.5, int_ior=1.33, ext_ior=1.5))


DOWN = (2, 3)  # of a pose
MOVES = {  # parameters, entries of them that move, and how far; by scenes, of which each is rendered for all at once
    "glass before a spot": (lambda: plate(SPOT), [
        ("glass.to_world", DOWN, 0.01), ("glass.bsdf.eta", (), 0.01)]),
    "camera before glass": (lambda: plate(SPOT), [("camera.to_world", (0, 0), 0.01)]),
    "spot before glass": (lambda: plate(SPOT), [
        ("glass.bsdf.specular_transmittance.value", (), 0.05), ("lamp.to_world", DOWN, 0.01),
        ("lamp.intensity.value", (1,), 0.5), ("floor.to_world", DOWN, 0.01), ("floor.bsdf.reflectance.value", (2,), 0.05)]),
    "width of a spot": (lambda: plate(SPOT | {"cutoff_angle": 14.0}), [("lamp.cutoff_angle", (), 0.5)]),
    "glass before a panel": (lambda: plate(PANEL), [
        ("lamp.to_world", DOWN, 0.02), ("lamp.to_world", (0, 0), 0.02), ("lamp.emitter.radiance.value", (0,), 0.5),
        ("glass.to_world", DOWN, 0.02), ("glass.bsdf.eta", (), 0.02)]),
    "glass under the sun": (lambda: plate(SUN), [
        ("lamp.irradiance.value", (0,), 0.2), ("glass.bsdf.specular_transmittance.value", (), 0.05)]),
    "bumps": (bumpy_plate, [
        ("glass.bsdf.scale", (), 0.03), ("glass.bsdf.nested_texture.data", (slice(28, 36), slice(28, 36), 0), 0.004),
        ("glass.bsdf.nested_bsdf.eta", (), 0.01)]),
    "glass around a bulb": (bulb_in_a_ball, [
        ("glass.to_world", DOWN, 0.01), ("glass.to_world", (2, 2), 0.01), ("lamp.position", (2,), 0.01),
        ("glass.bsdf.eta", (), 0.01), ("floor.to_world", DOWN, 0.01)]),
    "ball below a bulb": (ball_below_a_bulb, [("glass.to_world", DOWN, 0.01), ("glass.bsdf.eta", (), 0.01)]),
    "bulb above a ball": (ball_below_a_bulb, [
        ("glass.to_world", (0, 3), 0.005), ("glass.to_world", (2, 2), 0.01), ("lamp.position", (2,), 0.01)]),
    "mirror over a bulb": (bulb_below_a_mirror, [
        ("mirror.to_world", DOWN, 0.01), ("mirror.to_world", (2, 2), 0.01), ("lamp.position", (2,), 0.01)]),
    "glass on water": (two_panes, [
        ("upper.to_world", DOWN, 0.01), ("lower.to_world", DOWN, 0.01), ("upper.bsdf.eta", (), 0.01),
        ("lower.bsdf.eta", (), 0.01)]),
    "rough mirror over a bulb": (lambda: bulb_below_a_mirror(type="roughconductor", alpha=0.15), [
        ("mirror.to_world", DOWN, 0.01)]),
}


@pytest.mark.parametrize("name, sampling", [case if case in (
    ("glass before a spot", "attached"), ("ball below a bulb", "hybrid")) else deep(*case)
    for case in product(MOVES, ("hybrid", "attached"))])
def test_derivatives_are_those_of_differences(name, sampling):
    """Of means over seeds, by their standard errors."""
    build, moves = MOVES[name]
    scene = build()
    spp, seeds = (32, 6) if name in ("glass before a spot", "ball below a bulb") else (64, 12)  # they have the least noise
    settings = {"spp": spp, "light_paths": "caustics", "terms": ("interior",), "max_depth": 5, "sampling": sampling}
    renderer, wanted = unwarned_renderer(scene, **settings), {name: scene.get_parameter(name) for name, *_ in moves}
    ramp = torch.linspace(0.0, 2.0, 16, dtype=torch.float64)
    w = 0.5 + ramp + ramp[:, None] ** 2
    expected = torch.empty(len(moves), seeds)
    for row, (parameter, place, step) in zip(expected, moves):
        for seed in range(seeds):
            sides = []
            for sign in (1, -1):
                with torch.no_grad():
                    wanted[parameter][place] += sign * step
                    sides.append(renderer(seed=seed))
                    wanted[parameter][place] -= sign * step
            row[seed] = ((sides[0] - sides[1]) * w).sum() / (2 * step)
    found = torch.empty_like(expected)
    for parameter in wanted.values():
        parameter.requires_grad_()
    for seed in range(seeds):
        gradients = dict(zip(wanted, torch.autograd.grad((renderer(seed=seed + 100) * w).sum(), list(wanted.values()))))
        found[:, seed] = torch.stack([gradients[parameter][place].sum() for parameter, place, _ in moves])
    for (parameter, place, _), own, difference in zip(moves, found, expected):
        error = math.sqrt(float(own.var() + difference.var()) / len(own))
        size = abs(float(difference.mean()))
        assert error < 0.2 * size, (parameter, place)  # enough to tell a wrong one
        assert abs(float(own.mean() - difference.mean())) < max(3.5 * error, 0.03 * size), (parameter, place)


def test_a_mirror_that_moves_beside_a_lamp_is_right_by_default():
    """Paths from the camera alone slide over the lamp's edge in the mirror: the last derivative has the wrong sign then."""
    lamp = rectangle((-0.9, 0, 1.0), 0.1, (0, 1, 0), 98, emitter={"type": "area", "radiance": rgb(60, 54, 48)})
    mirror = rectangle((0.9, 0, 0.8), 0.3, (0, 1, 0), -112, bsdf={"type": "conductor", "material": "none"})
    scene = over_a_floor(lamp, mirror=mirror)
    renderer, wanted = unwarned_renderer(scene, spp=32), scene.get_parameter("mirror.to_world").requires_grad_()
    places = [(0, 3), (2, 0), (2, 3)]
    ramp = torch.linspace(0.0, 2.0, 16, dtype=torch.float64)
    w = 0.5 + ramp + ramp[:, None] ** 2
    found, expected = torch.empty(2, len(places), 8)
    for seed in range(8):
        for place, row in zip(places, expected):
            sides = []
            for sign in (1, -1):
                with torch.no_grad():
                    wanted[place] += sign * 0.03
                    sides.append(renderer(seed=seed))
                    wanted[place] -= sign * 0.03
            row[seed] = ((sides[0] - sides[1]) * w).sum() / 0.06
        gradient, = torch.autograd.grad((renderer(seed=seed + 100) * w).sum(), [wanted])
        found[:, seed] = torch.stack([gradient[place] for place in places])
    for place, own, difference in zip(places, found, expected):
        error, size = math.sqrt(float(own.var() + difference.var()) / len(own)), abs(float(difference.mean()))
        assert error < 0.15 * size, place  # enough to tell a wrong one
        assert abs(float(own.mean() - difference.mean())) < max(3.5 * error, 0.03 * size), place


@pytest.mark.parametrize("name, moves", [("glass.to_world", True), ("glass.bsdf.eta", False)])
def test_edges_that_light_from_lamps_passes_are_said_to_be_missing_where_anything_moves(name, moves):
    scene = plate(SPOT)
    scene.get_parameter(name).requires_grad_()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        rb.Renderer(scene, spp=1, light_paths="caustics")(seed=0)
    assert moves == any("paths from lamps bring caustics" in str(warning.message) for warning in caught)


def test_a_box_filter_is_said_to_see_nothing_of_where_light_lands():
    scene = plate(SPOT)
    scene.get_parameter("glass.bsdf.eta").requires_grad_()
    with warnings.catch_warnings(record=True) as smooth:
        warnings.simplefilter("always")
        rb.Renderer(scene, spp=1, light_paths="caustics")(seed=0)
    scene.sensors[0].film.rfilter = lit_ball("point").sensors[0].film.rfilter
    with pytest.warns(rb.SilhouetteWarning, match="box filter"):
        rb.Renderer(scene, spp=1, light_paths="caustics")(seed=0)
    assert not any("box filter" in str(warning.message) for warning in smooth)


MOVED = {
    "ball": ("ball.to_world", (0, 3), 0.03),
    "receiver": ("floor.to_world", (2, 3), 0.03),
    "receiver grows": ("floor.to_world", (0, 0), 0.03),
    "camera": ("camera.to_world", (0, 3), 0.03),
}


@pytest.mark.parametrize("name", deep_but(["camera"], MOVED))
def test_edges_and_shadows_in_view_count_where_all_light_comes_from_lamps(name):
    parameter, place, step = MOVED[name]
    spp = 128 if name == "camera" else 512  # by which there is the least noise
    camera = camera_named("perspective", 16, "gaussian") | {"fov": 85}
    scene = load(torch.float64, integrator={"type": "path", "max_depth": 3}, camera=camera, lamp=LAMPS["point"],
                 floor=rectangle((0, 0, 0), 3.0, bsdf=diffuse(0.6, 0.5, 0.4)),
                 ball=BALL | {"center": [0.3, 0, 0.9]})
    wanted, found, expected = scene.get_parameter(parameter), [], []
    renderer = unwarned_renderer(scene, light_paths="all")
    ramp = torch.linspace(0.0, 2.0, 16, dtype=torch.float64)
    w = 0.5 + ramp + ramp[:, None] ** 2
    for seed in range(8):
        wanted.requires_grad_(False)
        sides = []
        for sign in (1, -1):
            with torch.no_grad():
                wanted[place] += sign * step
                sides.append(renderer(seed=seed, spp=spp))
                wanted[place] -= sign * step
        expected.append(float(((sides[0] - sides[1]) * w).sum()) / (2 * step))
        wanted.requires_grad_()
        gradient, = torch.autograd.grad((renderer(seed=seed, spp=spp // 4) * w).sum(), [wanted])
        found.append(float(gradient[place]))
    found, expected = torch.tensor(found), torch.tensor(expected)
    error = math.sqrt(float(found.var() + expected.var()) / len(found))
    assert error < 0.1 * abs(float(expected.mean()))  # enough to tell a wrong one
    assert abs(float(found.mean() - expected.mean())) < max(3.5 * error, 0.05 * abs(float(expected.mean())))
