"""Media that surfaces enclose: invisible boundaries, and those of glass.

Slabs in closed form, and single scattering beside a point light; next-event estimation through boundaries against chance;
the gradient of every strategy, stride and way of running against the tape's; forward mode; differences; what is refused.
"""

from __future__ import annotations

import math
from itertools import product

import pytest
import torch

import torch_radbp as rb
from tests.deep import deep
from tests.gradients import FEW, MOVED, SOME, assert_informative, assert_transposed, image_and_gradients, relative_error
from tests.medium.compared import Move, compared
from tests.rendering.taped import assert_recorded_alike
from tests.scenes import diffuse, load, look_at, overhead, rectangle, rgb
from tests.scenes.media import (
    BLACK,
    DULL,
    MOVING,
    NAMES,
    NULL,
    SETTINGS,
    assert_chance_and_connection_agree,
    ball,
    haze,
    room,
    slab,
)

GLASS = {"type": "dielectric", "int_ior": 1.3}
ROUGH = {"type": "roughdielectric", "int_ior": 1.3, "alpha": 0.3}
CLEAR = haze((0.5, 0.5, 0.5), (1, 1, 1), 0.3)  # absorbs nothing


@pytest.mark.parametrize("compile", [False, True], ids=["eager", "compiled"])
def test_light_through_slabs_is_left_by_their_extinction(compile):
    """Two slabs that only absorb, one in the other, before a floor that sends light; seen, and along shadow rays."""
    dark, darker = haze((0.2, 0.4, 0.8), (0, 0, 0)), haze((1, 2, 3), (0, 0, 0))
    scene = load(torch.float64, camera=overhead(2, 4.0, 1e-4), outer=slab(2, 1.5, interior=dark),
                 inner=slab(2, 0.5, interior=darker, exterior=dark),
                 floor=rectangle((0, 0, 0), 3.0, bsdf=diffuse(0.5, 0.5, 0.5), emitter={"type": "area", "radiance": 1.0}),
                 bulb={"type": "point", "position": [0, 0, 4.5], "intensity": rgb(math.pi * 20.25, 0, 0)})
    image = rb.render(scene, spp=1 << 12, max_depth=2, compile=compile, seed=1).mean((0, 2, 3))
    left = (-torch.tensor([0.2 + 0.5, 0.4 + 1, 0.8 + 1.5])).exp()
    expected = left * torch.tensor([1 + 0.5 * float(left[0]), 1, 1])
    assert ((image / expected - 1).abs() < 0.02).all()


def test_in_a_furnace_radiance_is_1_behind_all_boundaries():
    """Media that absorb nothing under a sky of 1, in boundaries of null and of glass, nested, around a surface."""
    scene = load(torch.float64, camera=overhead(4, 4.0, 1.0), sky={"type": "constant"}, ball=ball(bsdf=NULL, interior=CLEAR),
                 core=ball(0.4, bsdf=GLASS, interior=haze((2, 2, 2), (1, 1, 1), -0.3), exterior=CLEAR),
                 stone=ball(0.1, bsdf=diffuse(1, 1, 1)))
    image = rb.render(scene, spp=4095, max_depth=200, rr_depth=200, nee=False, seed=1)
    error = image.mean((0, 1)).flatten() - 1.0
    assert abs(float(error.mean())) < 4 * float(error.std()) / math.sqrt(len(error)) < 0.01


@pytest.mark.parametrize("bsdf", [deep(NULL, id="null"), pytest.param(ROUGH, id="rough")])
def test_lamps_seen_through_boundaries_by_chance_and_by_connection_agree(bsdf):
    """That of the core, within, is null."""
    assert_chance_and_connection_agree(room(bsdf))


@pytest.mark.parametrize("nee", [False, True])
def test_invisible_surfaces_change_nothing(nee):
    """A veil that bounds nothing, and a boundary with the same medium on both sides: the same image to rounding."""
    air = {"type": "ref", "id": "air"}
    plain, veiled = (load(torch.float64, air=DULL, camera=overhead(4, 4.0, 1.0) | {"medium": air},
                          floor=rectangle((0, 0, 0), 3.0, bsdf=diffuse(0.6, 0.5, 0.4), interior=air, exterior=air),
                          lamp=rectangle((0.3, -0.8, 2.5), 0.4, (1, 0, 0), 170, bsdf=BLACK,
                                         emitter={"type": "area", "radiance": 20.0}), **more)
                     for more in ({}, {"veil": rectangle((0, 0, 1.5), 9.0, bsdf=NULL),
                                       "ball": ball(bsdf=NULL, interior=air, exterior=air)}))
    images = [rb.render(scene, spp=4095, max_depth=4, nee=nee, seed=2).mean((0, 2, 3)) for scene in (plain, veiled)]
    assert images[0].min() > 0.01 and ((images[1] / images[0] - 1).abs() < 0.01).all()


@pytest.mark.parametrize("compile, bsdf, strategies", [
    pytest.param(True, GLASS, FEW, id="few"), *(deep(*case, SOME, id=f"{case[0]}-{case[1]['type']}")
                                                for case in product((False, True), (NULL, GLASS, ROUGH)))])
def test_every_strategy_and_stride_gives_the_gradient_of_the_tape(compile, bsdf, strategies):
    scene = room(bsdf)
    image, expected = image_and_gradients(scene, NAMES, **SETTINGS | {"adjoint": rb.TapeAdjoint()})
    assert_informative(image, expected)
    for adjoint in strategies:
        found, gradients = image_and_gradients(scene, NAMES, compile=compile, **SETTINGS | {"adjoint": adjoint})
        assert relative_error(found, image) < 1e-12
        for name, gradient, wanted in zip(NAMES, gradients, expected):
            assert relative_error(gradient, wanted) < 1e-10, (adjoint, name)


@pytest.mark.parametrize("compile", [pytest.param(False, id="eager"), deep(True, id="compiled")])
def test_paths_from_lamps_that_pass_boundaries_give_the_gradient_of_the_tape(compile):
    """A ball of glass behind the boundary of a haze, and its caustic: rays of the bulb are glued to the glass."""
    glass = ball(0.4, bsdf=GLASS, interior=haze((2, 1, 3), (0.3, 0.6, 0.9), -0.3), exterior=haze())
    names, found = ["ball.to_world", "glass.to_world", "bulb.position"], []
    for adjoint in (rb.TapeAdjoint(), rb.MemoizedAdjoint()):
        scene = load(torch.float64, camera=overhead(4, 4.0, 1.0), ball=ball(bsdf=NULL, interior=haze()), glass=glass,
                     floor=rectangle((0, 0, 0), 3.0, bsdf=diffuse(0.6, 0.5, 0.4)),
                     bulb={"type": "point", "position": [-0.5, 0.6, 2.5], "intensity": rgb(2, 3, 4)})
        found.append(image_and_gradients(scene, names, adjoint=adjoint, compile=compile, light_paths="caustics",
                                         **SETTINGS | {"max_depth": 4}))
    (image, expected), (again, gradients) = found
    assert_informative(image, expected)
    assert relative_error(again, image) < 1e-12
    for name, gradient, wanted in zip(names, gradients, expected):
        assert relative_error(gradient, wanted) < 1e-10, name


@pytest.mark.parametrize("compile", [deep(False, id="eager"), pytest.param(True, id="compiled")])
def test_forward_mode_is_the_transpose_of_backward(compile):
    assert_transposed(room(), *NAMES[:5], **SETTINGS | {"compile": compile})


@pytest.mark.parametrize("bsdf, which", [
    deep(NULL, range(6), id="null"), pytest.param(ROUGH, (0, 2), id="rough"), deep(ROUGH, (1, 3, 4, 5), id="rough, others")])
def test_derivatives_are_those_of_differences(bsdf, which):
    """Before a floor that sends light, in the mean over the image. The boundary of the core is null."""
    scene = load(torch.float64, camera=overhead(2, 4.0, 0.7),
                 floor=rectangle((0, 0, 0), 1.5, bsdf=BLACK, emitter={"type": "area", "radiance": 1.0}),
                 ball=ball(0.9, bsdf=bsdf, interior=haze((0.6, 0.8, 1.0), (0.5, 0.4, 0.3), 0.4)),
                 core=ball(0.7, bsdf=NULL, interior=haze((1, 2, 1.5), (0.3, 0.6, 0.5), -0.3)))
    moves = [Move(name, step) for name, step in zip(NAMES[:6], (0.1, 0.1, 0.25, 0.1, 0.1, 0.1))]
    for found in compared(scene, [moves[number] for number in which], spp=1 << 13, max_depth=5):
        found.assert_agrees(0.1)


@pytest.mark.deep  # quick within panes, in test_panes.py
@pytest.mark.parametrize("compile, bsdf, sampling", [
    pytest.param(*case, id=f"{case[0]}-{case[1]['type']}-{case[2]}")
    for case in product((False, True), (NULL, GLASS, ROUGH), ("detached", "hybrid", "attached"))])
def test_every_strategy_gives_the_gradient_of_the_tape_of_what_moves(compile, bsdf, sampling):
    """Of boundaries, surfaces behind them, lamps and the camera, and of a boundary's roughness. That of the core is null."""
    names = [*MOVING, NAMES[0], *(["ball.bsdf.alpha.value"] if bsdf is ROUGH else [])]
    settings = SETTINGS | {"sampling": sampling}
    image, expected = image_and_gradients(room(bsdf), names, **settings | {"adjoint": rb.TapeAdjoint()})
    assert_informative(image, [each for name, each in zip(names, expected) if name != "bulb.position" or bsdf is NULL])
    for adjoint in MOVED:
        found, gradients = image_and_gradients(room(bsdf), names, compile=compile, **settings | {"adjoint": adjoint})
        assert relative_error(found, image) < 1e-12
        for name, gradient, wanted in zip(names, gradients, expected):
            assert (gradient - wanted).abs().max() <= 1e-10 * wanted.abs().max(), (adjoint, name)


@pytest.mark.parametrize("compile", [pytest.param(False, id="eager"), deep(True, id="compiled")])
def test_forward_mode_is_the_transpose_of_backward_of_what_moves(compile):
    assert_transposed(room(), *MOVING[:4], **SETTINGS | {"terms": ("interior",), "max_depth": 3, "compile": compile})


@pytest.mark.parametrize("depth, moving", [
    (2, ["ball", "camera"]), *(deep(depth, ["ball", "core", "camera"]) for depth in (1, 3))],
    ids=["few", "1", "3"])
def test_derivatives_by_boundaries_that_move_are_those_of_differences(depth, moving):
    """Of light that passes them straight, and of light that is scattered; projected on the derivative itself."""
    scene = load(torch.float64, air=haze((0.6, 0.8, 1.0), (0.5, 0.4, 0.3), 0.4), camera=overhead(2, 4.0, 1.3),
                 floor=rectangle((0, 0, 0), 9.0, bsdf=BLACK, emitter={"type": "area", "radiance": 1.0}),
                 ball=ball(0.9, bsdf=NULL, interior={"type": "ref", "id": "air"}),
                 core=ball(0.6, bsdf=NULL, interior=haze((1, 2, 1.5), (0.3, 0.6, 0.5), -0.3),
                           exterior={"type": "ref", "id": "air"}))
    moves = [Move(f"{name}.to_world", 0.05) for name in moving]
    gradient_spp = 1 << (14 if depth == 2 else 16)  # that of the core has the most noise
    for found in compared(scene, moves, spp=1 << 14, gradient_spp=gradient_spp, along=True, max_depth=depth):
        found.assert_agrees(0.05)


@pytest.mark.parametrize("compile", [deep(False, id="eager"), pytest.param(True, id="compiled")])
def test_derivatives_by_lights_that_alone_move_are_those_of_differences(compile):
    """Of the same samples: what they meet does not depend on where a light is, and how long its way is in the box does."""
    scene = load(torch.float64, camera=overhead(2, 4.0, 0.5), floor=rectangle((0, 0, 0), 0.9, bsdf=diffuse(0.6, 0.5, 0.4)),
                 box={"type": "cube", "bsdf": NULL, "interior": haze((0.5, 1, 1.5), (0.3, 0.6, 0.9))},
                 bulb={"type": "point", "position": [0.9, 1.2, 2.4], "intensity": 9.0},
                 spot={"type": "spot", "to_world": look_at((0.9, 1.2, 2.4), (0, 0, 0), (0, 0, 1)), "intensity": 9.0},
                 sun={"type": "directional", "direction": [-0.3, -0.4, -1.0], "irradiance": 2.0})
    settings, step = {"spp": 64, "max_depth": 3, "rr_depth": 9, "seed": 1, "compile": compile, "share_samples": True}, 1e-5
    parameters = {name: scene.get_parameter(name) for name in ("bulb.position", "spot.to_world", "sun.to_world")}
    tangents = {}
    for name, parameter in parameters.items():
        tangent = torch.linspace(0.5, 1.0, parameter.numel(), dtype=torch.float64).view_as(parameter)
        tangent[3:] = 0.0  # the last row of a pose
        tangents[name] = tangent
    for moving in parameters:  # the others have a tangent of 0
        found, images = rb.jvp(scene, {name: tangent if name == moving else torch.zeros_like(tangent)
                                       for name, tangent in tangents.items()}, **settings), []
        for sign in (1, -1):
            with torch.no_grad():
                parameters[moving] += sign * step * tangents[moving]
                images.append(rb.render(scene, **settings))
                parameters[moving] -= sign * step * tangents[moving]
        difference = (images[0] - images[1]) / (2 * step)
        assert found.abs().max() > 0.01 and relative_error(found, difference) < 1e-6, moving


def test_a_medium_of_a_shape_is_called_interior_or_exterior():
    with pytest.raises(rb.SceneError, match="sphere has a medium in each of interior, exterior: call it by one"):
        room(other=ball(fog=haze()))


def test_a_boundary_cannot_be_instanced():
    with pytest.raises(rb.SceneError, match="'leaf' is the boundary of a medium, which cannot be instanced"):
        room(group={"type": "shapegroup", "leaf": ball(interior=haze())})


def test_boundaries_are_read_and_written(tmp_path):
    scene = room(GLASS).float()
    rb.save(scene, tmp_path / "scene.xml")
    again = rb.load(tmp_path / "scene.xml")
    assert [medium.type for medium in again.media] == ["homogeneous"] * 2
    for name, value in scene.named_parameters():
        torch.testing.assert_close(dict(again.named_parameters())[name], value)
    image, other = (rb.render(each, spp=4, max_depth=3, seed=1, compile=False) for each in (scene, again))
    assert image.max() > 0 and torch.equal(image, other)


@pytest.mark.parametrize("settings", [{}, {"nee": False, "spp": 99}, deep({"sampling": "detached"}), deep({"chunk": 40}),
                                      deep({"adjoint": rb.MemoizedAdjoint(2, keep_hits=False)})], ids=str)
def test_bounces_that_are_recorded_have_the_bits_of_single_operations(settings, monkeypatch):
    assert_recorded_alike(lambda: room(GLASS).to(torch.float32), NAMES, monkeypatch, **SETTINGS | settings)
