"""Images by paths from lamps are those by paths from the camera, and no light counts twice."""

import math
from itertools import product

import pytest
import torch

import torch_radbp as rb
from tests.deep import deep, deep_but
from tests.light_paths.agreement import SEEDS, SPP, assert_agree, images
from tests.light_paths.scenes import CAMERAS, LAMPS, lit_ball
from tests.scenes import diffuse, load, overhead, rectangle, rgb

IDEAL = {"glass": {"type": "dielectric"}, "mirror": {"type": "conductor"}, "plastic": {"type": "plastic"}}
ROUGH = {"rough mirror": {"type": "roughconductor", "alpha": 0.1}, "rough glass": {"type": "roughdielectric", "alpha": 0.1},
         "rough plastic": {"type": "roughplastic", "alpha": 0.2}}
OTHERS = {
    "bumps": {"type": "bumpmap", "arbitrary": {"type": "checkerboard"}, "bsdf": diffuse(0.5, 0.6, 0.7)},
    "half glass": {"type": "principled", "base_color": rgb(0.6, 0.3, 0.2), "roughness": 0.4, "spec_trans": 0.5},
    "blend of glass": {"type": "blendbsdf", "weight": 0.4, "bsdf_0": IDEAL["glass"], "bsdf_1": diffuse(0.5, 0.6, 0.7)},
    "wide glass": {"type": "roughdielectric", "alpha": 0.4},
}

# Roughness decides whether a lobe's light is a caustic: of what has one such lobe both, of the others one kind each.
SHARED = {("rough mirror", "caustics"), ("rough mirror", "all"), ("glass", "caustics"), ("plastic", "caustics"),
          ("bumps", "all")}


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("camera", deep_but(["perspective"], CAMERAS))
@pytest.mark.parametrize("lamp", LAMPS)
def test_all_light_of_a_lamp_is_that_of_paths_from_the_camera(lamp, camera):
    scene = lit_ball(lamp, camera)
    # Paths from the camera find light that leaves its lamp in one direction so rarely that few would say nothing of errors.
    spp = 16 * SPP if lamp == "directionalarea" else SPP
    assert_agree(images(scene, "camera", spp), images(scene, "all", spp))


@pytest.mark.parametrize("camera", ["thinlens", "orthographic"])
def test_all_light_reaches_each_kind_of_camera(camera):
    scene = lit_ball("point", camera)
    assert_agree(images(scene, "camera"), images(scene, "all"))


@pytest.mark.parametrize("name, light_paths", [case if case in SHARED else deep(*case)
                                               for case in product(IDEAL | ROUGH | OTHERS, ("caustics", "all"))])
def test_light_is_shared_so_that_none_counts_twice(name, light_paths):
    """By way of mirrors, glass and rough surfaces: the lamp has an extent, so that paths from the camera find all."""
    scene = lit_ball("area", bsdf=(IDEAL | ROUGH | OTHERS)[name])
    assert_agree(images(scene, "camera"), images(scene, light_paths))


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", deep_but(["mirror"], IDEAL))
def test_caustics_of_a_point_are_those_of_all_light(name):
    """Paths from the camera, which are the same ones in both images, lack them."""
    scene = lit_ball("point", bsdf=IDEAL[name])
    caustics, every = images(scene, "caustics"), images(scene, "all")
    assert_agree(caustics, every)
    gained = (caustics - images(scene, "camera")).mean((1, 2, 3))
    assert gained.mean() > 20 * gained.std() / math.sqrt(SEEDS)


def test_a_point_over_a_floor_has_its_closed_form():
    """L = rho / pi I cos / r^2, seen from straight above."""
    scene = load(torch.float32, camera=overhead(4), floor=rectangle((0, 0, 0), 5.0, bsdf=diffuse(0.6, 0.5, 0.4)),
                 lamp={"type": "point", "position": [0, 0, 2.0], "intensity": rgb(1, 2, 3)}, integrator={"type": "ptracer"})
    with torch.no_grad():
        image = rb.Renderer(scene, spp=4096)(seed=0)[0].mean((1, 2))
    x = (torch.arange(256, dtype=torch.float64) + 0.5) / 128 - 1
    squared = x[:, None] ** 2 + x**2 + 4
    mean = (2 / squared**1.5).mean() / math.pi
    torch.testing.assert_close(image.double(), mean * torch.tensor([0.6, 1.0, 1.2], dtype=torch.float64), rtol=5e-3, atol=0)


def test_fog_takes_from_paths_of_lamps_what_it_takes_from_others():
    fog = {"type": "homogeneous", "sigma_t": 0.2, "albedo": rgb(0.5, 0.6, 0.7)}
    scene = lit_ball("point")
    foggy = load(torch.float32, integrator={"type": "path", "max_depth": 4}, camera=overhead(8, 3.0) | {"medium": fog},
                 floor=rectangle((0, 0, 0), 3.0, bsdf=diffuse(0.6, 0.5, 0.4)), lamp=LAMPS["point"])
    assert images(foggy, "camera").mean() != images(scene, "camera").mean()
    assert_agree(images(foggy, "camera"), images(foggy, "all"))


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("compile", [True, False])
def test_an_image_is_the_same_whatever_is_traced_at_a_time(compile):
    """Sums are made in float64; in float32 they differ in a last bit of few pixels, if at all."""
    scene = lit_ball("point", bsdf=IDEAL["glass"], rfilter="gaussian")
    with torch.no_grad():
        whole, parts = (rb.Renderer(scene, spp=16, light_paths="all", chunk=chunk, compile=compile)(seed=1)
                        for chunk in (None, 512))
    assert whole.max() > 0
    torch.testing.assert_close(whole, parts, rtol=1e-6, atol=0)


def test_a_window_of_the_film_is_what_one_cuts_out():
    scene = lit_ball("point")
    assert_agree(images(scene, "all")[:, :, 2:6, 1:5], torch.cat([
        rb.Renderer(scene, light_paths="all")(seed=seed, spp=SPP, window=(1, 2, 4, 4)).detach() for seed in range(SEEDS)]))


def test_ptracer_traces_all_light_from_the_lamps():
    scene = lit_ball("area", integrator="ptracer")
    assert scene.integrator.light_paths == "all" and rb.Renderer(scene).light_paths == "all"
    with torch.no_grad():
        expected = rb.Renderer(lit_ball("area"), spp=4, light_paths="all")(seed=0)
        assert torch.equal(rb.Renderer(scene, spp=4)(seed=0), expected)


def test_lamps_that_begin_no_paths_are_refused():
    class Glow(torch.nn.Module):
        def forward(self, uv):
            return torch.ones(len(uv), 3)

    scene = lit_ball("area")
    scene.get_submodule("lamp").emitter.radiance = rb.NeuralTexture(Glow())
    with pytest.raises(ValueError, match="network"):
        rb.Renderer(scene, spp=1, light_paths="all")(seed=0)


def test_an_unknown_choice_is_refused():
    with pytest.raises(ValueError, match="light_paths='lamps' is not known"):
        rb.Renderer(lit_ball("area"), light_paths="lamps")
