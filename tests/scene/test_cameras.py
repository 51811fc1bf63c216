"""A scene may have hundreds of cameras: a call looks at those that it renders."""

import cProfile
import pstats

import pytest
import torch

import torch_radbp as rb
from tests.scenes import cornell, sensor

MANY = 100


def cameras(count: int) -> rb.Scene:
    return cornell(sensors={f"v{number:03}": sensor(4) for number in range(count)})


def calls_of_a_step(count: int) -> int:
    """The calls of Python functions that a rendering of one of so many cameras makes, once all is known."""
    renderer = rb.Renderer(cameras(count), spp=1, max_depth=2)
    for seed in range(3):
        renderer(seed=seed, sensors=0)
    profile = cProfile.Profile()
    profile.enable()
    renderer(seed=3, sensors=0)
    profile.disable()
    return pstats.Stats(profile).total_calls


def test_cameras_that_are_not_rendered_cost_next_to_nothing():
    few, many = calls_of_a_step(1), calls_of_a_step(MANY)
    # What is left is the walk over all modules of the scene, some 75 calls for each camera.
    assert many - few < 90 * MANY


def test_the_parameters_of_a_camera_are_checked_when_it_is_rendered():
    scene = cameras(3)
    renderer = rb.Renderer(scene, spp=1, max_depth=2)
    with torch.no_grad():
        scene.get_parameter("v001.to_world")[0, 0] = torch.nan
    assert torch.isfinite(renderer(seed=1, sensors=[0, 2])).all()
    for sensors in (1, "v001", [0, 1], None):
        with pytest.raises(ValueError, match=r"'v001\.to_world'"):
            renderer(seed=1, sensors=sensors)


def test_only_cameras_that_are_rendered_have_gradients():
    scene = cameras(3)
    poses = [scene.get_parameter(f"v{number:03}.to_world").requires_grad_() for number in range(3)]
    rb.Renderer(scene, spp=4, max_depth=2)(seed=1, sensors=[0, 2]).square().mean().backward()
    assert poses[1].grad is None
    for pose in (poses[0], poses[2]):
        assert torch.isfinite(pose.grad).all() and pose.grad.abs().max() > 0


def test_a_misspelt_name_is_found_in_a_camera_that_is_not_rendered():
    scene = cameras(2)
    renderer = rb.Renderer(scene, spp=1, max_depth=2)
    pose = scene.get_parameter("v001.to_world").detach()
    with pytest.raises(AttributeError, match=r"'scene\.v001\.to_wrld'"):
        torch.func.functional_call(renderer, {"scene.v001.to_wrld": pose}, kwargs={"seed": 1, "sensors": 0})
