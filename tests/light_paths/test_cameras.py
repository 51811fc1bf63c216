"""Where paths from lamps end: at each kind of camera, at points in view and beside it."""

import pytest
import torch

import torch_radbp as rb
from tests.light_paths.agreement import assert_agree, images
from tests.light_paths.scenes import camera_named
from tests.scenes import diffuse, load, rectangle, rgb, sensor
from torch_radbp.tensors.vec import Vec2, Vec3

LAMP = {"type": "point", "position": [1.0, 1.0, 3.0], "intensity": rgb(10, 12, 14)}
HALF_GLASS = {"type": "principled", "base_color": rgb(0.6, 0.3, 0.2), "roughness": 0.4, "spec_trans": 0.5}


def floor_and_ball(camera: dict, at=(0.3, 0, 0.6), bsdf: dict | None = None) -> rb.Scene:
    return load(torch.float32, integrator={"type": "path", "max_depth": 4}, camera=camera, lamp=LAMP,
                floor=rectangle((0, 0, 0), 3.0, bsdf=diffuse(0.6, 0.5, 0.4)),
                ball={"type": "sphere", "center": list(at), "radius": 0.4, "bsdf": bsdf or diffuse(0.7, 0.6, 0.8)})


def calibrated(**attributes) -> dict:
    seen = sensor(8, (0, -2.5, 4), (0, 0, 0))
    return {"type": "calibrated", "to_world": seen["to_world"], "film": seen["film"], "fx": 9.0, "fy": 11.0, "cx": 3.0,
            "cy": 4.0, "skew": 1.5} | attributes


def test_all_light_reaches_a_calibrated_camera():
    scene = floor_and_ball(calibrated())
    assert_agree(images(scene, "camera"), images(scene, "all"))


@pytest.mark.parametrize("distortion", [{"k1": -0.1}, {"distortion": "fisheye"}])
def test_cameras_with_distortion_are_refused(distortion):
    scene = floor_and_ball(calibrated(**distortion))
    with pytest.raises(ValueError, match="without distortion"):
        rb.Renderer(scene, spp=1, light_paths="all")(seed=0)


def test_a_calibrated_camera_without_skew_sees_points_as_a_perspective_one():
    scene = floor_and_ball(calibrated(fy=9.0, skew=0.0))
    with torch.no_grad():
        found = rb.Renderer(scene, spp=64, light_paths="all")(seed=1)
        scene.add_module("camera", scene.get_submodule("camera").as_perspective())
        expected = rb.Renderer(scene, spp=64, light_paths="all")(seed=1)
    torch.testing.assert_close(found, expected, rtol=1e-4, atol=1e-5)


def test_what_is_behind_a_camera_brings_light_by_way_of_what_it_sees():
    """A direction to the camera is needed there, too: 0 times what a material says of none is no number."""
    scene = floor_and_ball(sensor(8, (0, 0, 1), (0, 0, 0), 80), (0.1, 0, 1.7), HALF_GLASS)
    assert_agree(images(scene, "camera"), images(scene, "all"))


@pytest.mark.parametrize("camera", [sensor(4), camera_named("thinlens"), camera_named("orthographic"), calibrated()])
def test_every_point_has_a_direction_to_the_camera(camera):
    seen = floor_and_ball(camera).get_submodule("camera").tensors()
    p = Vec3(*torch.randn(3, 100, generator=torch.Generator().manual_seed(0)) * 10)
    found = seen.kind.sight(seen.lens, p, Vec2(p.x.abs() % 1, p.y.abs() % 1) if seen.kind.has_aperture else None)
    assert 0 < int(found.ahead.sum()) < 100
    assert (found.target - p).stack().norm(dim=1).min() > 1e-3
