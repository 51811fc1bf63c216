"""A medium that scatters: flights of paths that end in it are vertices.

A furnace and single scattering in closed form; lights found by chance and by connection; the gradient of every strategy,
stride and way of running against the tape's; forward mode as the transpose of backward; differences.
"""

from __future__ import annotations

import math
import warnings

import pytest
import torch

import torch_radbp as rb
from tests.deep import deep
from tests.gradients import EXACT, FEW, REPLAY, assert_transposed, gradients_by_seed, image_and_gradients, relative_error
from tests.scenes import diffuse, load, overhead, rectangle, rgb
from tests.scenes.media import BLACK, DULL, assert_chance_and_connection_agree, haze

ALL = (*EXACT[:-1], *REPLAY)
SAMPLINGS = ("detached", "hybrid", "attached")
NEAR = 0.01  # from the camera to where its rays begin, the near plane
SETTINGS = {"spp": 8, "max_depth": 5, "rr_depth": 2}
NAMES = [f"camera.medium.{name}" for name in ("sigma_t.value.value", "albedo.value.value", "phase_function.g")]


def furnace(fill: dict, radiance=(1, 1, 1), **more):
    """A box whose walls send light, filled with a medium."""
    return load(torch.float64, camera=overhead(4, 4.0, 1.0) | {"medium": fill}, box={
        "type": "cube", "to_world": torch.diag(torch.tensor([5.0, 5.0, 5.0, 1.0])), "flip_normals": True, "bsdf": BLACK,
        "emitter": {"type": "area", "radiance": rgb(*radiance)}}, **more)


CLEAR = haze((0.2, 0.2, 0.2), (1, 1, 1), 0.3)  # absorbs nothing


def room(**more):
    """A floor under a lamp and a point light, from above, in haze."""
    return load(torch.float64, camera=overhead(4, 4.0, 1.0) | {"medium": haze()},
                floor=rectangle((0, 0, 0), 3.0, bsdf=diffuse(0.6, 0.5, 0.4)),
                lamp=rectangle((0.3, -0.8, 2.0), 0.4, (1, 0, 0), 170, bsdf=BLACK,
                               emitter={"type": "area", "radiance": rgb(3, 2, 1)}),
                bulb={"type": "point", "position": [-0.5, 0.6, 1.5], "intensity": rgb(2, 3, 4)}, **more)


@pytest.mark.parametrize("compile", [deep(False, id="eager"), pytest.param(True, id="compiled")])
def test_in_a_furnace_radiance_is_1_everywhere(compile):
    """On every path but those with ways so thin that flights are sampled by more extinction than there is."""
    image = rb.render(furnace(CLEAR), spp=4095, max_depth=64, rr_depth=100, nee=False, compile=compile, seed=1)
    error = image.mean((0, 1)).flatten() - 1.0  # pixels are independent
    assert abs(float(error.mean())) < 4 * float(error.std()) / math.sqrt(len(error)) < 4e-4
    assert (error.abs() < 1e-3).all()


def test_in_a_furnace_radiance_is_1_by_connections_too():
    image = rb.render(furnace(CLEAR), spp=4095, max_depth=64, rr_depth=8, seed=1)
    error = image.mean((0, 1)).flatten() - 1.0  # pixels are independent
    assert abs(float(error.mean())) < 4 * float(error.std()) / math.sqrt(len(error)) < 0.01


def test_lamps_found_by_chance_and_by_connection_agree():
    """In colours that differ, so that distances are sampled by one of three."""
    assert_chance_and_connection_agree(room(), 12, 4095)


def single_scattering(sigma_t, albedo, g, count: int = 20001) -> torch.Tensor:
    """The light of a point light 1 beside the axis of a camera 4 above a black floor, scattered once along that axis."""
    t = torch.linspace(0, 4 - NEAR, count, dtype=torch.float64)
    height, step = 4 - NEAR - t - 1.5, float(t[1] - t[0])
    distance = (1 + height**2).sqrt()
    cosine = height / distance  # between the direction of light, from the lamp, and that towards the camera
    phase = (1 - g * g) / (4 * math.pi * (1 + g * g - 2 * g * cosine)**1.5)
    value = sigma_t * albedo * (-sigma_t * (t + distance)).exp() * phase / distance**2
    weights = torch.ones_like(t)
    weights[0] = weights[-1] = 0.5
    return (value * weights).sum() * step


def test_single_scattering_and_its_derivatives_are_those_of_the_integral():
    """By extinction, albedo and mean cosine, one colour."""
    values = torch.tensor([0.5, 0.8, 0.3], dtype=torch.float64, requires_grad=True)
    expected = single_scattering(*values)
    wanted, = torch.autograd.grad(expected, values)
    scene = load(torch.float64, camera=overhead(2, 4.0, 1e-4) | {"medium": haze((0.5,) * 3, (0.8,) * 3, 0.3)},
                 floor=rectangle((0, 0, 0), 3.0, bsdf=BLACK),
                 bulb={"type": "point", "position": [1.0, 0.0, 1.5], "intensity": rgb(1, 1, 1)})
    images, found = [], []
    for seed in range(16):
        image, gradients = image_and_gradients(scene, NAMES, seed=seed, spp=1024, max_depth=2,
                                               adj_image=torch.full((1, 3, 2, 2), 1 / 12, dtype=torch.float64))
        images.append(image.mean())
        found.append(torch.stack([gradient.sum() for gradient in gradients]))
    for samples, exact in ((torch.stack(images)[:, None], expected.detach()[None]), (torch.stack(found), wanted)):
        error = samples.std(0) / math.sqrt(len(samples))
        assert (error < 0.02 * exact.abs()).all()
        assert ((samples.mean(0) - exact).abs() < 4 * error + 2e-5 * exact.abs()).all()  # pixels are not quite on the axis


@pytest.mark.parametrize("depth, shared", [
    deep(2, False, id="2-own samples"), pytest.param(3, False, id="3-own samples"),
    pytest.param(2, True, id="2-shared samples"), deep(3, True, id="3-shared samples")])
def test_where_rays_meet_nothing_derivatives_at_no_extinction_are_those_of_the_integral(depth, shared):
    """A point light 1 beside the axis of a camera: albedo / (4 pi) times the angle under which it sees that axis."""
    along, albedo = 4 - NEAR - 1.5, torch.tensor([0.9, 0.6, 0.3], dtype=torch.float64)
    wanted = albedo / (4 * math.pi) * (math.pi / 2 + math.atan(along))
    scene = load(torch.float64, camera=overhead(2, 4.0, 1e-4) | {"medium": haze((0, 0, 0), tuple(albedo.tolist()), 0.0)},
                 pebble={"type": "sphere", "center": [8.0, 0.0, 0.0], "radius": 0.1, "bsdf": BLACK},
                 bulb={"type": "point", "position": [1.0, 0.0, 1.5], "intensity": rgb(1, 1, 1)})
    assert not rb.render(scene, spp=64, max_depth=depth).any()
    gradients = gradients_by_seed(scene, NAMES[:1], range(16), torch.full((1, 3, 2, 2), 1 / 4, dtype=torch.float64),
                                  spp=1024, max_depth=depth, share_samples=shared)
    found = torch.stack([gradient.flatten() for gradient, in gradients])
    error = found.std(0) / math.sqrt(len(found))
    assert (error < 0.02 * wanted).all()
    assert ((found.mean(0) - wanted).abs() < 4 * error).all()


@pytest.mark.parametrize("compile, sampling, strategies", [
    (True, "hybrid", ALL), (True, "detached", FEW), (True, "attached", FEW), deep(True, "detached", ALL),
    deep(True, "attached", ALL), *(deep(False, sampling, ALL) for sampling in SAMPLINGS)],
    ids=lambda value: f"{len(value)} strategies" if type(value) is tuple else str(value))
def test_every_strategy_and_stride_gives_the_gradient_of_the_tape(compile, sampling, strategies):
    """Of what scatters, and of what moves in it."""
    names = [*NAMES, "floor.bsdf.reflectance.value", "lamp.emitter.radiance.value", "bulb.position", "floor.to_world"]
    settings = SETTINGS | {"sampling": sampling}
    scene = room()
    image, expected = image_and_gradients(scene, names, **settings | {"adjoint": rb.TapeAdjoint()})
    for name, gradient in zip(names, expected):
        assert torch.isfinite(gradient).all() and gradient.abs().max() > 0, name
    for adjoint in strategies:
        found, gradients = image_and_gradients(scene, names, compile=compile, **settings | {"adjoint": adjoint})
        assert relative_error(found, image) < 1e-12
        for name, gradient, wanted in zip(names, gradients, expected):
            assert relative_error(gradient, wanted) < 1e-10, (adjoint, name)


@pytest.mark.parametrize("compile", [False, True], ids=["eager", "compiled"])
def test_forward_mode_is_the_transpose_of_backward(compile):
    assert_transposed(room(), NAMES[0], "floor.to_world", **SETTINGS | {"terms": ("interior",), "compile": compile})


@pytest.mark.parametrize("name, step, spp", zip(NAMES, (0.05, 0.05, 0.15), (4096, 1024, 16384)))
def test_derivatives_are_those_of_differences(name, step, spp):
    """Independent samples, among walls that send light."""
    scene = furnace(DULL, (0.3, 0.6, 1.0), floor=rectangle((0, 0, 0), 3.0, bsdf=diffuse(0.6, 0.5, 0.4)))
    check = rb.check_gradient(scene, name, step=step, spp=spp, max_depth=4, seed=3)
    assert check.agrees, str(check)


@pytest.mark.parametrize("name, empty, spp", [(NAMES[0], haze((0, 0, 0)), 2048), (NAMES[1], haze(albedo=(0, 0, 0)), 8192)])
def test_derivatives_at_zero_are_those_of_one_sided_differences(name, empty, spp):
    """Of an extinction of 0, by which nothing scatters yet, and an albedo of 0; differences of 0, h and 2 h."""
    scene = furnace(empty, (0.3, 0.6, 1.0), floor=rectangle((0, 0, 0), 3.0, bsdf=diffuse(0.6, 0.5, 0.4)))
    check = rb.check_gradient(scene, name, step=0.008, spp=spp, max_depth=4, seed=3)
    assert check.agrees, str(check)


@pytest.mark.parametrize("sampling, spp", [("hybrid", 32768), ("attached", 4096), deep("detached", 32768)])
def test_flights_fill_the_way_to_walls_that_move(sampling, spp):
    """The whole box grows; its walls look alike, so that nothing jumps where they meet."""
    grows = torch.diag(torch.tensor([1.0, 1.0, 1.0, 0.0], dtype=torch.float64))
    check = rb.check_gradient(furnace(DULL, (0.3, 0.6, 1.0)), "box.to_world", direction=grows, step=0.4, spp=spp,
                              max_depth=4, seed=3, sampling=sampling)
    assert check.agrees, str(check)


def test_moving_a_shape_in_it_warns_of_the_edges_that_it_sees_if_they_are_left_out():
    scene = room()
    for name, sampling, warned in ((NAMES[0], "attached", False), ("floor.to_world", "attached", True),
                                   ("bulb.position", "attached", True), ("bulb.position", "hybrid", False)):
        scene.requires_grad_(False)
        scene.get_parameter(name).requires_grad_()
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            rb.Renderer(scene, spp=1, max_depth=3, sampling=sampling)(seed=1)
        found = [each for each in caught if issubclass(each.category, rb.SilhouetteWarning)]
        assert any("edges that surfaces and media see" in str(each.message) and name in str(each.message)
                   for each in found) == bool(found) == warned


def test_one_medium_fills_the_scene():
    with pytest.raises(rb.SceneError, match="sensors stand in different media: `camera` in homogeneous, `other` in none"):
        room(other=overhead(2))
    with pytest.raises(rb.SceneError, match="`lost` is a medium in which no sensor stands"):
        room(lost=haze())
    shared = load(torch.float64, air=haze(), first=overhead(2) | {"medium": {"type": "ref", "id": "air"}},
                  second=overhead(2) | {"medium": {"type": "ref", "id": "air"}}, sky={"type": "constant"})
    assert shared.media == [shared.air] and "air.sigma_t.value.value" in dict(shared.named_parameters())


XML = """<scene version="3.0.0">
    <sensor type="perspective">
        <transform name="to_world"><lookat origin="0, -4, 1" target="0, 0, 0" up="0, 0, 1"/></transform>
        <film type="hdrfilm"><integer name="width" value="4"/><integer name="height" value="4"/></film>
        <medium type="homogeneous">
            <rgb name="sigma_t" value="0.3, 0.2, 0.1"/>
            <volume name="albedo" type="constvolume"><rgb name="value" value="0.9, 0.8, 0.7"/></volume>
            <float name="scale" value="1.5"/>
            <phase type="hg"><float name="g" value="0.25"/></phase>
        </medium>
    </sensor>
    <shape type="sphere"><bsdf type="diffuse"/></shape>
    <emitter type="point"><point name="position" x="0" y="-2" z="3"/></emitter>
</scene>"""


def test_xml_is_read_and_written(tmp_path):
    (tmp_path / "scene.xml").write_text(XML)
    scene = rb.load(tmp_path / "scene.xml")
    medium, = scene.media
    assert float(medium.phase_function.g) == 0.25 and float(medium.scale) == 1.5
    assert medium.albedo.value.value.tolist() == pytest.approx([0.9, 0.8, 0.7])
    rb.save(scene, tmp_path / "again.xml")
    again = rb.load(tmp_path / "again.xml")
    for name, value in scene.named_parameters():
        torch.testing.assert_close(dict(again.named_parameters())[name], value)
    image, other = (rb.render(each, spp=4, max_depth=3, seed=1, compile=False) for each in (scene, again))
    assert image.min() > 0 and torch.equal(image, other)
