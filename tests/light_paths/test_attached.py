"""Caustics with attached sampling: what would be wrong is refused, and nothing else."""

import pytest
import torch

import torch_radbp as rb
from tests.light_paths.scenes import BALL, LAMPS, camera_named, lit_ball
from tests.scenes import diffuse, load, rectangle

pytestmark = pytest.mark.filterwarnings("ignore")
MIRROR = {"type": "conductor", "material": "none"}
SETTINGS = {"spp": 4, "max_depth": 3, "sampling": "attached", "compile": False}


def scene_of(lamp: str, name: str | None) -> rb.Scene:
    scene = lit_ball(lamp, rfilter="gaussian", bsdf=MIRROR)
    if name is not None:
        scene.get_parameter(name).requires_grad_()
    return scene


@pytest.mark.parametrize("name", ["ball.to_world", "lamp.to_world"])
def test_edges_would_be_counted_twice_beside_lamps_of_some_extent(name):
    scene = scene_of("area", name)
    with pytest.raises(ValueError, match="count edges twice"):
        rb.Renderer(scene, light_paths="caustics", **SETTINGS)()
    with torch.no_grad():
        assert rb.Renderer(scene, light_paths="caustics", **SETTINGS)().any()


@pytest.mark.parametrize("lamp, name, settings", [
    ("area", "floor.bsdf.reflectance.value", {}), ("point", "ball.to_world", {}),
    ("area", "ball.to_world", {"terms": ("interior", "primary")}), ("area", "ball.to_world", {"sampling": "hybrid"})])
def test_all_else_has_derivatives(lamp, name, settings):
    scene = scene_of(lamp, name)
    rb.Renderer(scene, light_paths="caustics", **SETTINGS | settings)().sum().backward()
    assert scene.get_parameter(name).grad.isfinite().all() and scene.get_parameter(name).grad.any()


def test_by_default_attached_sampling_has_light_by_paths_from_the_camera():
    """Of lamps with an extent, which these find, if by chance."""
    found = {}
    for way in ("auto", "camera"):
        scene = scene_of("area", "ball.to_world")
        rb.Renderer(scene, light_paths=way, **SETTINGS)(seed=2).sum().backward()
        found[way] = scene.get_parameter("ball.to_world").grad
    assert found["auto"].any() and torch.equal(found["auto"], found["camera"])


@pytest.mark.parametrize("needed", [False, True])
def test_by_default_it_is_said_that_caustics_of_a_point_are_missing_beside_a_lamp_of_some_extent(needed):
    """The same light with and without a derivative."""
    scene = load(torch.float32, camera=camera_named("perspective", 8, "gaussian"), ball=BALL | {"bsdf": MIRROR},
                 floor=rectangle((0, 0, 0), 3.0, bsdf=diffuse(0.6, 0.5, 0.4)), point=LAMPS["point"], panel=LAMPS["area"])
    scene.get_parameter("ball.to_world").requires_grad_(needed)
    with pytest.warns(rb.SceneWarning, match="the image lacks them"):
        image = rb.Renderer(scene, **SETTINGS)(seed=2)
    with torch.no_grad():
        assert torch.equal(image, rb.Renderer(scene, light_paths="camera", **SETTINGS)(seed=2))
