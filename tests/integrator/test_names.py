"""Mitsuba's integrators by name: what each is rendered as, and what is said where that differs."""

import pytest
import torch

import torch_radbp as rb
from tests.scenes import diffuse, load, rectangle, rgb, sensor


def scene_of(dtype=torch.float64, material=None, **integrator):
    """A lamp above two walls, all in view."""
    return load(dtype, integrator=integrator, sensor=sensor(6, (0, 0.5, 3.5), (0, 0, 0), 45),
                floor=rectangle((0, -0.6, 0), 1.3, angle=-90, bsdf=diffuse(0.5, 0.6, 0.7)),
                back=rectangle((0, 0, -0.8), 0.9, bsdf=material or diffuse(0.3, 0.8, 0.4)),
                lamp=rectangle((0, 0.8, 0.2), 0.4, angle=60, emitter={"type": "area", "radiance": rgb(5, 4, 3)}))


# What Mitsuba 3.9.1 answers: path's default depth is unlimited, that of the differentiable integrators 6.
DEPTHS = {"path": -1, "volpath": -1, "volpathmis": -1, "prb": 6, "prb_basic": 6, "prbvolpath": 6, "prb_projective": 6}


@pytest.mark.filterwarnings("ignore:prb_projective is rendered as")
@pytest.mark.parametrize("name", DEPTHS)
def test_an_integrator_is_path_tracing_with_the_depth_of_its_name(name):
    renderer = rb.Renderer(scene_of(type=name), spp=2)
    assert (renderer.max_depth, renderer.rr_depth, renderer.hide_emitters, renderer.nee) == (DEPTHS[name], 5, False, True)
    renderer = rb.Renderer(scene_of(type=name, max_depth=3, rr_depth=2, hide_emitters=True), spp=2)
    assert (renderer.max_depth, renderer.rr_depth, renderer.hide_emitters) == (3, 2, True)
    expected = rb.render(scene_of(type="path"), spp=2, max_depth=3, rr_depth=2, hide_emitters=True)
    assert expected.max() > 0
    assert torch.equal(renderer(seed=0), expected)


def test_direct_is_a_depth_of_two():
    image = rb.render(scene_of(type="direct"), spp=4)
    expected = rb.render(scene_of(type="path"), spp=4, max_depth=2)
    deeper = rb.render(scene_of(type="path"), spp=4, max_depth=4)
    assert torch.equal(image, expected) and not torch.equal(image, deeper)


def test_direct_without_samples_of_emitters_has_no_next_event_estimation():
    renderer = rb.Renderer(scene_of(type="direct", emitter_samples=0), spp=4)
    assert not renderer.nee
    assert torch.equal(renderer(seed=0), rb.render(scene_of(type="path"), spp=4, max_depth=2, nee=False))
    assert rb.Renderer(renderer.scene, nee=True).nee  # who says otherwise is obeyed


@pytest.mark.parametrize("samples", [{"shading_samples": 4}, {"emitter_samples": 4}, {"bsdf_samples": 2}])
def test_more_samples_of_direct_are_warned_of(samples):
    with pytest.warns(UserWarning, match="takes one of each for every camera ray"):
        scene_of(type="direct", **samples)


@pytest.mark.parametrize("name, plain", [("prb_projective", "prb"), ("direct_projective", "direct")])
def test_projective_integrators_say_once_which_terms_there_are(name, plain, tmp_path):
    settings = {"sppc": 4, "sppp": 2, "sppi": 0, "guiding": "grid", "guiding_proj": False, "guiding_rounds": 2,
                "project_seed": "bsdf"}
    with pytest.warns(UserWarning) as found:
        scene = scene_of(torch.float32, type=name, hide_emitters=True, **settings)
    assert [str(each.message) for each in found] == [
        f"{name} is rendered as {plain}: derivatives have the interior, the edges in view and the borders of shadows, as "
        "Renderer(terms=) says; what edges contribute that surfaces see by reflection is missing, and Renderer warns "
        "where it does; sppc, sppp, sppi, guiding and project_seed are without effect"]
    same = scene_of(torch.float32, type=plain, hide_emitters=True)
    assert torch.equal(rb.render(scene, spp=2), rb.render(same, spp=2))
    assert (scene.integrator.max_depth, scene.integrator.alpha()) == (same.integrator.max_depth, same.integrator.alpha())
    rb.save(scene, tmp_path / "scene.xml")
    with pytest.warns(UserWarning, match=f"{name} is rendered as {plain}"):
        again = rb.load(tmp_path / "scene.xml").integrator
    assert {key: getattr(again, key) for key in settings} == settings


def test_volpath_says_that_passing_straight_through_counts():
    with pytest.warns(UserWarning, match="counts towards max_depth=4, which it does not in Mitsuba's volpath"):
        scene_of(type="volpath", max_depth=4, material={"type": "mask", "opacity": 0.5, "b": diffuse(0.5, 0.5, 0.5)})
    scene_of(type="volpath", material={"type": "null"})  # unlimited: there is nothing to say


@pytest.mark.parametrize("attributes, message", [
    ({"type": "prb_projective", "guiding": "kd"}, "guiding 'kd' is not known"),
    ({"type": "direct_projective", "project_seed": "light"}, "project_seed 'light' is not known"),
    ({"type": "prb_projective", "sppi": -1}, "sppi must be an integer of at least 0"),
    ({"type": "direct_projective", "max_depth": 3}, "no attribute 'max_depth'"),
    ({"type": "depth"}, "aovs=\"dd:depth\""), ({"type": "stokes"}, "no polarisation"),
    ({"type": "pathh"}, "did you mean 'path'"), ({"type": "direct", "max_depth": 3}, "no attribute 'max_depth'"),
    ({"type": "direct", "bsdf_samples": 0}, "mirrors and glass would be black"),
    ({"type": "direct", "shading_samples": 2, "bsdf_samples": 1}, "stands for both"),
    ({"type": "direct", "emitter_samples": -1}, "emitter_samples must be an integer of at least 0"),
    ({"type": "path", "timeout": 3.0}, "always takes all of its samples"),
    ({"type": "aov"}, "aov needs 'aovs'"), ({"type": "aov", "aovs": "depth"}, "name:quantity pairs"),
    ({"type": "aov", "aovs": "d:dept"}, "did you mean 'depth'"), ({"type": "aov", "aovs": "d:duv_dx"}, "not supported"),
    ({"type": "aov", "aovs": "d:depth,d:uv"}, "'d' is given twice"),
    ({"type": "moment", "a": {"type": "path"}, "b": {"type": "direct"}}, "keep one"),
    ({"type": "moment", "a": {"type": "diffuse"}}, "a bsdf, which cannot stand here"),
])
def test_what_is_not_done_is_said(attributes, message):
    with pytest.raises(rb.SceneError, match=message):
        scene_of(**attributes)


def test_blocks_and_passes_of_mitsuba_change_nothing():
    image = rb.render(scene_of(type="path", block_size=8, samples_per_pass=2), spp=2)
    assert torch.equal(image, rb.render(scene_of(type="path"), spp=2))


def test_no_depth_is_black_and_depth_one_is_emission():
    lit = rb.render(scene_of(type="path", max_depth=1), spp=4, nee=False)
    assert torch.equal(rb.render(scene_of(type="path", max_depth=0), spp=4), torch.zeros_like(lit))
    assert lit.max() > 0
    assert torch.equal(rb.render(scene_of(type="path", max_depth=1), spp=4, hide_emitters=True), torch.zeros_like(lit))


def test_an_integrator_in_another_sets_the_depth_and_names_the_outputs():
    inner = {"type": "aov", "aovs": "dd.y:depth, nn:sh_normal", "img": {"type": "direct", "hide_emitters": True}}
    scene = scene_of(type="moment", i=inner)
    assert scene.integrator.outputs() == {"i.dd.y": "depth", "i.nn": "sh_normal", "i": "xyz", "m2_i.dd.y": "m2_depth",
                                          "m2_i.nn": "m2_sh_normal", "m2_i": "m2_xyz"}
    renderer = rb.Renderer(scene)
    assert renderer.max_depth == 2 and renderer.hide_emitters


@pytest.mark.parametrize("integrator", [
    {"type": "direct", "emitter_samples": 0, "hide_emitters": True}, {"type": "prbvolpath", "max_depth": 3},
    {"type": "volpathmis", "use_spectral_mis": False},
    {"type": "moment", "i": {"type": "aov", "aovs": "d:depth", "img": {"type": "prb", "rr_depth": 9}}}])
def test_integrators_are_written_and_read_again(tmp_path, integrator):
    scene = scene_of(torch.float32, **integrator)
    rb.save(scene, tmp_path / "scene.xml")
    integrator, read = scene.integrator, rb.load(tmp_path / "scene.xml").integrator
    assert read.outputs() == integrator.outputs() and read.type == integrator.type
    for name in ("max_depth", "rr_depth", "nee", "hide_emitters"):
        assert getattr(read, name) == getattr(integrator, name)
