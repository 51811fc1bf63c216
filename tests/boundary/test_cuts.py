"""Curves along which the near and the far plane of a camera cut surfaces, against closed forms."""

import math

import pytest

from tests.boundary.closed_forms import DARK, GLOW, JUMP, SIZE, along, assert_close, derivative, parallel
from tests.scenes import load, rectangle, sensor

HALF = math.tan(math.radians(20))
FISHEYE = {"type": "calibrated", "distortion": "fisheye", "fx": 12.0}


@pytest.mark.parametrize("plane, sign", [("near_clip", -1), ("far_clip", 1)])
@pytest.mark.parametrize("kind", ["orthographic", "perspective", "thinlens"])
def test_a_cut_moves_with_the_surface(kind, plane, sign):
    """A sheet through the middle of the plane z = 1, 45 degrees steep, higher on the right: raised by d, it is cut by d
    further left, where it is seen 2 away."""
    view = parallel() if kind == "orthographic" else sensor(SIZE, (0, 0, 3))
    view |= {"type": kind, plane: 2.0} | ({"aperture_radius": 0.2, "focus_distance": 2.0} if kind == "thinlens" else {})
    scene = load(camera=view, sky=DARK, sheet=rectangle((0, 0, 1), 9, (0, 1, 0), -45, **GLOW))
    pixel = 2 / SIZE if kind == "orthographic" else 2 * 2 * HALF / SIZE
    assert_close(derivative(scene, "sheet.to_world", along(2), spp=256), sign * JUMP * SIZE / pixel, 0.03)


@pytest.mark.parametrize("plane, sign", [("near_clip", -1), ("far_clip", 1)])
def test_a_camera_that_comes_nearer_cuts_elsewhere(plane, sign):
    view = parallel() | {plane: 2.0}
    scene = load(camera=view, sky=DARK, sheet=rectangle((0, 0, 1), 9, (0, 1, 0), -45, **GLOW))
    assert_close(derivative(scene, "camera.to_world", along(2), spp=256), -sign * JUMP * SIZE / (2 / SIZE), 0.02)


def test_the_planes_of_a_fisheye_are_spheres():
    """Around the eye, of radius 2; a sheet at z = 1.8 is cut in a circle, and moved away it is seen in a wider one."""
    view = {key: value for key, value in sensor(SIZE, (0, 0, 3)).items() if key != "fov"} | FISHEYE | {"near_clip": 2.0}
    scene = load(camera=view, sky=DARK, sheet=rectangle((0, 0, 1.2), 9, **GLOW))
    # Seen at pixels fx theta from the middle, cos(theta) = 1.8 / 2; nothing within.
    theta = math.acos(0.9)
    expected = -2 * math.pi * 12.0**2 * theta * (0.5 / math.sin(theta)) * JUMP  # of theta by the height above the sheet
    assert_close(derivative(scene, "sheet.to_world", along(2), spp=256), expected, 0.02)
