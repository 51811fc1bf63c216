"""Media that vary in space: rays are followed from collision to collision.

Where extinction is the same everywhere they are homogeneous media; a furnace; bounds that hold; the gradient of every
strategy, stride and way of running against the tape's; forward mode; differences, also where extinction is 0.
"""

from __future__ import annotations

import math
from itertools import product

import pytest
import torch

import torch_radbp as rb
from tests.deep import deep, deep_but
from tests.gradients import (
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
from tests.scenes.smoke import MOVING, NAMES, NULL, SETTINGS, box, grid, placed, room, smoke, varied
from torch_radbp.medium.coarse_grid import COARSER, bounds_of
from torch_radbp.volume.gridvolume import GridVolume

CHANNELS = (1, 3)
ROUGH = {"type": "roughdielectric", "int_ior": 1.3, "alpha": 0.3}
BOUNDARIES = {"null": NULL, "glass": {"type": "dielectric", "int_ior": 1.3}}


@pytest.mark.parametrize("compile", [deep(False, id="eager"), pytest.param(True, id="compiled")])
@pytest.mark.parametrize("channels, thickness, boundary", [case if case in (
    (1, 1.0, "glass"), (3, 1.0, "null")) else deep(*case) for case in product(CHANNELS, (1.0, 0.01), BOUNDARIES)])
def test_where_extinction_is_even_the_medium_is_homogeneous(compile, channels, thickness, boundary):
    """In as many cells as the coarse grid has."""
    colour = [thickness * each for each in ((0.5, 0.5, 0.5) if channels == 1 else (0.3, 0.5, 0.9))]
    even = torch.tensor(colour[:channels], dtype=torch.float64).expand(20, 9, 17, channels).contiguous()
    other = {"type": "homogeneous", "scale": 2.0, "albedo": rgb(0.9, 0.6, 0.3), "sigma_t": rgb(*colour),
             "phase": {"type": "hg", "g": 0.4}}
    renderers = [rb.Renderer(room(medium, BOUNDARIES[boundary]), spp=512, max_depth=4, compile=compile)
                 for medium in (smoke(even), other)]
    samples = torch.stack([torch.stack([renderer(seed=seed).mean((0, 2, 3)) for seed in range(8)])
                           for renderer in renderers])
    difference, error = samples.mean(1).diff(dim=0)[0], (samples.var(1) / 8).sum(0).sqrt()
    assert (difference.abs() < 4 * error).all() and (error < 0.02 * samples.mean((0, 1))).all()


@pytest.mark.parametrize("channels", CHANNELS)
def test_in_a_furnace_radiance_is_1(channels):
    scene = load(torch.float64, camera=overhead(4, 4.0, 1.0), sky={"type": "constant"},
                 box=box(smoke(grid(channels), (1, 1, 1), 4.0)),
                 stone={"type": "sphere", "radius": 0.4, "bsdf": diffuse(1, 1, 1)})
    image = rb.render(scene, spp=4095, max_depth=64, rr_depth=100, nee=False, seed=1)
    error = image.mean((0, 1)).flatten() - 1.0
    assert abs(float(error.mean())) < 4 * float(error.std()) / math.sqrt(len(error)) < 0.01


def test_around_the_sensors_it_is_the_same_as_in_its_boundary():
    """Outside of its box there is nothing."""
    pair = []
    for around in (False, True):
        camera, more = overhead(4, 4.0, 1.0), {}
        if around:
            camera["medium"] = smoke()
        else:
            more["box"] = box(smoke(), 1.2)
        scene = load(torch.float64, camera=camera, floor=rectangle((0, 0, 1.0), 3.0, bsdf=diffuse(0.6, 0.5, 0.4)),
                     sky={"type": "constant"}, **more)
        renderer = rb.Renderer(scene, spp=256, max_depth=4)
        pair.append(torch.stack([renderer(seed=seed).mean((0, 2, 3)) for seed in range(8)]))
    difference, error = pair[0].mean(0) - pair[1].mean(0), ((pair[0].var(0) + pair[1].var(0)) / 8).sqrt()
    assert (difference.abs() < 4 * error).all() and (error < 0.01 * pair[0].mean(0)).all()


@pytest.mark.parametrize("compile, channels", [deep(False, 1), deep(False, 3), deep(True, 1), (True, 3)])
def test_every_strategy_and_stride_gives_the_gradient_of_the_tape(compile, channels):
    scene = room(varied(channels))
    image, expected = image_and_gradients(scene, NAMES, **SETTINGS | {"adjoint": rb.TapeAdjoint()})
    assert_informative(image, expected)
    for adjoint in SOME:
        found, gradients = image_and_gradients(scene, NAMES, compile=compile, **SETTINGS | {"adjoint": adjoint})
        assert relative_error(found, image) < 1e-12
        for name, gradient, wanted in zip(NAMES, gradients, expected):
            assert relative_error(gradient, wanted) < 1e-10, (adjoint, name)


@pytest.mark.parametrize("compile", [deep(False, id="eager"), pytest.param(True, id="compiled")])
def test_forward_mode_is_the_transpose_of_backward(compile):
    assert_transposed(room(varied()), *NAMES[:4], **SETTINGS | {"compile": compile})


def before_a_lamp(medium: dict):
    """Smoke before a floor that sends light."""
    return load(torch.float64, camera=overhead(2, 4.0, 0.9), box=box(medium),
                floor=rectangle((0, 0, 0), 1.5, bsdf=BLACK, emitter={"type": "area", "radiance": 1.0}))


@pytest.mark.parametrize("channels", deep_but([3], CHANNELS))
def test_derivatives_are_those_of_differences(channels):
    moves = [Move(name, step) for name, step in zip(NAMES[:4], (0.1, 0.1, 0.3, 0.2))]
    for found in compared(before_a_lamp(varied(channels)), moves, spp=1 << 10, max_depth=4):
        found.assert_agrees(0.1)


def test_where_extinction_is_0_derivatives_are_those_of_one_sided_differences():
    """Of the cells that are empty, alone, beside others that are not."""
    empty = grid() == 0
    assert empty.any() and not empty.all()

    scene, step, images = before_a_lamp(smoke()), 0.05, []
    gradients = gradients_by_seed(scene, NAMES[:1], range(8), torch.full((1, 3, 2, 2), 1 / 12, dtype=torch.float64),
                                  spp=1 << 8, max_depth=4)
    renderer = rb.Renderer(scene.requires_grad_(False), spp=1 << 10, max_depth=4)
    for extinction in (0.0, step, 2 * step):
        scene.get_parameter(NAMES[0]).copy_(torch.where(empty, extinction, grid()))
        images.append(torch.stack([renderer(seed=seed).mean() for seed in range(100, 108)]))
    found = torch.stack([(gradient * empty).sum() for gradient, in gradients])
    wanted = (4 * images[1] - 3 * images[0] - images[2]) / (2 * step)
    error = ((found.var() + wanted.var()) / len(found)).sqrt()
    assert 0 < error < 0.1 * wanted.mean().abs() and (found.mean() - wanted.mean()).abs() < 4 * error


def test_boundaries_and_grids_are_read_and_written(tmp_path):
    scene = room(varied()).float()
    rb.save(scene, tmp_path / "scene.xml")
    again = rb.load(tmp_path / "scene.xml")
    for name, value in scene.named_parameters():
        torch.testing.assert_close(dict(again.named_parameters())[name], value)
    image, other = (rb.render(each, spp=4, max_depth=3, seed=1, compile=False) for each in (scene, again))
    assert image.max() > 0 and torch.equal(image, other)


def test_smoke_so_thin_that_flights_are_sampled_by_more_scatters_as_much_as_it_should():
    """What it adds to a black scene grows with its extinction: by the same share in a box of even smoke and of fog."""
    def light(medium: dict) -> torch.Tensor:
        scene = load(torch.float64, camera=overhead(2, 4.0, 0.9), box=box(medium),
                     bulb={"type": "point", "position": [0, 0, 4.0], "intensity": 30.0})
        renderer = rb.Renderer(scene, spp=1 << 11, max_depth=2)
        return torch.stack([renderer(seed=seed).mean() for seed in range(8)])

    even = light(smoke(torch.full((3, 3, 3, 1), 0.002, dtype=torch.float64), (0.9, 0.9, 0.9)))
    fog = light({"type": "homogeneous", "sigma_t": 0.002, "scale": 2.0, "albedo": 0.9, "phase": {"type": "hg", "g": 0.4}})
    error = ((even.var() + fog.var()) / 8).sqrt()
    assert 0 < error < 0.05 * fog.mean() and (even.mean() - fog.mean()).abs() < 4 * error


@pytest.mark.parametrize("kind", ["homogeneous", "heterogeneous"])
def test_in_a_furnace_of_flakes_radiance_is_1(kind):
    """Extinction and scattering depend on direction, by the same factor. Mitsuba 3.9.1 loses up to 4 % of the light here."""
    flakes = {"type": "sggx", "S": [0.9, 0.3, 0.5, 0.2, -0.1, 0.15]}
    medium = smoke(albedo=(1, 1, 1)) if kind == "heterogeneous" else {
        "type": kind, "albedo": 1.0, "sigma_t": rgb(1.0, 0.5, 2.0), "phase": {}}
    medium["phase"] = flakes
    scene = load(torch.float64, camera=overhead(4, 4.0, 1.0), sky={"type": "constant"}, box=box(medium))
    image = rb.render(scene, spp=4095, max_depth=64, rr_depth=100, nee=False, seed=1)
    error = image.mean((0, 1)).flatten() - 1.0
    assert abs(float(error.mean())) < 4 * float(error.std()) / math.sqrt(len(error)) < 0.015


def test_a_constant_extinction_fills_the_cube_of_its_pose():
    """As Mitsuba's `constvolume` does."""
    sky, camera = {"type": "constant"}, overhead(2, 4.0, 0.9)
    value = {"type": "constvolume", "value": 0.6, "to_world": placed(0.5)}
    even = {"type": "heterogeneous", "albedo": 0.0, "sigma_t": value}
    floor = rectangle((0, 0, 0), 3.0, bsdf=BLACK, emitter={"type": "area", "radiance": 1.0})
    image = rb.render(load(torch.float64, camera=camera, sky=sky, floor=floor, box=box(even)), spp=1 << 14, max_depth=1)
    seen = (1.0 / 1.8)**2  # the share of the image that the cube covers
    assert float(image.mean()) == pytest.approx(1 - seen * (1 - math.exp(-0.6)), abs=0.005)


@pytest.mark.parametrize("settings", [{}, {"adjoint": rb.MemoizedAdjoint(2, keep_hits=False)}, {"sampling": "detached"},
                                      deep({"chunk": 40}), deep({"nee": False, "spp": 99})], ids=str)
def test_bounces_that_are_recorded_have_the_bits_of_single_operations(settings, monkeypatch):
    assert_recorded_alike(lambda: room(varied(3)).to(torch.float32), NAMES, monkeypatch, **SETTINGS | settings)


def test_samples_of_the_derivative_alone_tell_more_of_empty_cells_and_the_same_in_the_mean():
    """The light that half of a grid, which is empty, would scatter: gradients of 6 renderings."""
    data = grid(size=(8, 8, 8))
    data[:4] = 0.0
    scene, name = room(smoke(data)).to(torch.float32), "box.interior.sigma_t.data"
    spread, mean = {}, {}
    for shared in (False, True):
        gradients = torch.stack([gradient for gradient, in gradients_by_seed(
            scene, [name], range(6), torch.ones(1, 3, 4, 4), spp=256, max_depth=4, share_samples=shared)])
        gradients = gradients.double()[:, :4].flatten(1)
        spread[shared], mean[shared] = gradients.var(0).sum(), gradients.sum(1)
    assert 0 < spread[False] < 0.4 * spread[True]
    error = ((mean[False].var() + mean[True].var()) / 6).sqrt()
    assert (mean[False].mean() - mean[True].mean()).abs() < 3 * error < 0.5 * mean[False].mean().abs()


@pytest.mark.deep  # quick of the same smoke that emits light, in test_emission.py
@pytest.mark.parametrize("compile, bsdf, sampling", [
    pytest.param(*case, id=f"{case[0]}-{case[1]['type']}-{case[2]}")
    for case in product((False, True), (NULL, ROUGH), ("detached", "hybrid", "attached"))])
def test_every_strategy_gives_the_gradient_of_the_tape_of_what_moves(compile, bsdf, sampling):
    """Of the box, a stone in it, the floor, the camera and a lamp, and of the grid at the same time."""
    names, settings = [*MOVING, *NAMES[:2]], SETTINGS | {"sampling": sampling}
    image, expected = image_and_gradients(room(varied(3), bsdf, 0.9), names, **settings | {"adjoint": rb.TapeAdjoint()})
    assert_informative(image, expected)
    for adjoint in MOVED:
        found, gradients = image_and_gradients(room(varied(3), bsdf, 0.9), names, compile=compile,
                                               **settings | {"adjoint": adjoint})
        assert relative_error(found, image) < 1e-12
        for name, gradient, wanted in zip(names, gradients, expected):
            assert (gradient - wanted).abs().max() <= 1e-10 * wanted.abs().max(), (adjoint, name)


@pytest.mark.deep  # quick of the same smoke that emits light, in test_emission.py
@pytest.mark.parametrize("compile", [False, True], ids=["eager", "compiled"])
def test_forward_mode_is_the_transpose_of_backward_of_what_moves(compile):
    assert_transposed(room(varied(), half=0.9), *MOVING, **SETTINGS | {"terms": ("interior",), "compile": compile})


@pytest.mark.parametrize("depth, moving, spp", [(1, ["box.to_world", "core.to_world", "camera.to_world"], 1 << 10),
                                                (3, ["bulb.position"], 1 << 11),
                                                deep(3, ["core.to_world"], 1 << 12),
                                                deep(3, ["camera.to_world"], 1 << 16)], ids=["1", "3", "core", "camera"])
def test_derivatives_by_what_moves_are_those_of_differences(depth, moving, spp):
    """Boxes of smoke in smoke, with edges out of view, over a floor that shines; the grids stand still."""
    pose = torch.diag(torch.tensor([9.0, 9.0, 0.7, 1.0], dtype=torch.float64))
    pose[2, 3] = 1.5
    inner = pose.clone()
    inner[2, 2] = 0.3
    wide = placed(3.0, 1.5)
    outer_grid = {"type": "gridvolume", "data": 0.2 + grid(3, (8, 4, 5)), "to_world": wide}
    inner_grid = {"type": "gridvolume", "data": 1.5 + 2.0 * grid(1, (9, 5, 3)), "to_world": wide}
    air = {"type": "heterogeneous", "sigma_t": outer_grid, "albedo": rgb(0.5, 0.4, 0.3), "phase": {"type": "hg", "g": 0.4}}
    dust = {"type": "heterogeneous", "sigma_t": inner_grid, "albedo": rgb(0.3, 0.6, 0.5)}
    scene = load(torch.float64, air=air, camera=overhead(2, 4.0, 1.3),
                 floor=rectangle((0, 0, 0), 9.0, bsdf=diffuse(0.5, 0.4, 0.3), emitter={"type": "area", "radiance": 1.0}),
                 box={"type": "cube", "to_world": pose, "bsdf": NULL, "interior": {"type": "ref", "id": "air"}},
                 core={"type": "cube", "to_world": inner, "bsdf": NULL, "interior": dust,
                       "exterior": {"type": "ref", "id": "air"}},
                 bulb={"type": "point", "position": [-0.5, 0.6, 3.0], "intensity": rgb(8, 9, 7)})
    moves = [Move(name, 0.01 if name == "camera.to_world" else 0.05) for name in moving]
    for found in compared(scene, moves, spp=spp, along=True, max_depth=depth):
        found.assert_agrees(0.05)


@pytest.mark.parametrize("shape", [(16, 9, 8), (17, 18, 19), (1, 5, 33), (8, 8, 24)], ids=str)
def test_bounds_of_a_coarse_cell_are_those_of_all_values_in_and_beside_it(shape):
    values = torch.rand(*shape, generator=torch.Generator().manual_seed(3))
    bound, least, _ = bounds_of(GridVolume(data=values))
    assert bound.shape == least.shape == tuple(-(-count // COARSER) for count in shape)
    for cell in torch.cartesian_prod(*map(torch.arange, bound.shape)).tolist():
        near = values[tuple(slice(max(0, COARSER * at - 1), COARSER * at + COARSER + 1) for at in cell)]
        assert (bound[tuple(cell)], least[tuple(cell)]) == (near.max(), near.min())
