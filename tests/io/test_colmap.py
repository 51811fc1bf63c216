"""Cameras of a COLMAP model in text form."""

import pytest
import torch

import torch_radbp as rb
from tests.sensor.test_opencv import seen_by
from torch_radbp.plugin import SceneError

CAMERAS = """# Camera list with one line of data per camera:
#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]
# Number of cameras: 7
1 SIMPLE_PINHOLE 40 30 33.5 20 15
2 PINHOLE 40 30 33 34 20.5 14.5
3 SIMPLE_RADIAL 40 30 33 20 15 -0.1
4 RADIAL 40 30 33 20 15 -0.1 0.02
5 OPENCV 40 30 33 34 20 15 -0.1 0.02 0.003 -0.004
6 FULL_OPENCV 40 30 33 34 20 15 0.1 0.2 0.003 -0.004 0.3 0.4 0.5 0.6
7 OPENCV_FISHEYE 40 30 13 14 20 15 0.1 0.2 0.3 0.4
"""
IMAGES = """# Image list with two lines of data per image:
#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME
#   POINTS2D[] as (X, Y, POINT3D_ID)
1 1 0 0 0 0.1 0.2 0.3 2 first.jpg
12.5 7.5 -1 3.5 4.5 17
2 0.5 0.5 -0.5 0.5 -1 0.2 2 6 folder/second view.jpg

3 0.9238795 0 0.3826834 0 0 0 4 7 third.png
"""


@pytest.fixture
def model(tmp_path):
    def write(cameras=CAMERAS, images=IMAGES):
        (tmp_path / "cameras.txt").write_text(cameras)
        (tmp_path / "images.txt").write_text(images)
        return tmp_path

    return write


def test_images_come_in_order_with_their_cameras(model):
    found = rb.cameras_from_colmap(model())
    assert list(found) == ["first.jpg", "folder/second view.jpg", "third.png"]
    first, second, third = found.values()
    assert [float(value) for value in (first.fx, first.fy, first.cx, first.cy)] == [33, 34, 20, 14]  # from 20.5 and 14.5
    assert {name for name, _ in first.named_parameters()} == {"to_world", "fx", "fy", "cx", "cy", "skew"}
    values = [float(getattr(second, name)) for name in ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")]
    assert values == pytest.approx([0.1, 0.2, 0.003, -0.004, 0.3, 0.4, 0.5, 0.6])
    assert third.distortion == "fisheye" and float(third.k4) == pytest.approx(0.4)


@pytest.mark.parametrize("camera, expected", [
    (1, {"fx": 33.5, "fy": 33.5, "k1": None}), (3, {"fx": 33, "k1": -0.1, "k2": None}),
    (4, {"fx": 33, "fy": 33, "k1": -0.1, "k2": 0.02, "p1": None}), (5, {"k2": 0.02, "p1": 0.003, "p2": -0.004, "k3": None})])
def test_every_model_says_what_its_numbers_are(model, camera, expected):
    sensor, = rb.cameras_from_colmap(model(images=f"1 1 0 0 0 0 0 0 {camera} a.jpg\n")).values()
    for name, value in expected.items():
        found = getattr(sensor, name)
        assert found is None if value is None else float(found) == pytest.approx(value), name


def test_a_pixel_sees_the_points_that_colmap_projects_there(model):
    """A quarter turn about y (to the right): the world's x is ahead of the camera; COLMAP counts from the corner."""
    half = 0.70710678
    sensor, = rb.cameras_from_colmap(model(images=f"1 {half} 0 {-half} 0 0.1 0.2 0.3 1 a.jpg\n")).values()
    o, d = seen_by(sensor, 25, 10)
    X = o + 2.0 * d
    x, y, z = float(-X[2]) + 0.1, float(X[1]) + 0.2, float(X[0]) + 0.3  # R X + t
    assert z > 1
    assert 33.5 * x / z + 20 == pytest.approx(25.5, abs=1e-4) and 33.5 * y / z + 15 == pytest.approx(10.5, abs=1e-4)


def test_a_scene_is_rendered_from_all_of_them(model):
    scene = rb.load_dict({"type": "scene", "sky": {"type": "constant", "radiance": 2.0}, "ball": {"type": "sphere"},
                          **rb.cameras_from_colmap(model(), scale=0.1, far_clip=50.0)})
    image = rb.render(scene, spp=1, max_depth=1, sensors=[0, 2])
    assert image.shape == (2, 3, 3, 4) and torch.isfinite(image).all() and (image > 1.5).any()
    assert scene.sensors[1].far_clip == 50


BAD = {
    "model": ({"cameras": "1 THIN_PRISM_FISHEYE 4 3 1 1 2 2 0 0 0 0 0 0 0 0\n"},
              "cameras.txt, line 1: the camera model THIN_PRISM_FISHEYE is not supported; .*known: FULL_OPENCV, OPENCV"),
    "parameters": ({"cameras": "# list\n1 PINHOLE 4 3 1 1 2\n"},
                   "cameras.txt, line 2: PINHOLE has the parameters fx fy cx cy, got 3 numbers"),
    "no number": ({"cameras": "1 PINHOLE 4 3 1 one 2 2\n"}, "line 1: parameters must be finite numbers, got '1 one 2 2'"),
    "not finite": ({"cameras": "1 PINHOLE 4 3 1 inf 2 2\n"}, "line 1: parameters must be finite numbers"),
    "not finite in float32": ({"cameras": "1 PINHOLE 4 3 1 1 2 3e39\n"}, "line 1: parameters must be finite numbers, got"),
    "focal length that underflows": ({"cameras": "1 PINHOLE 4 3 1 1e-46 2 2\n"}, "line 1: focal lengths must be greater"),
    "far away": ({"images": "1 1 0 0 0 0 1e40 0 1 a.jpg\n"}, "line 1: rotation and translation must be finite numbers"),
    "size": ({"cameras": "1 PINHOLE 4.5 3 1 1 2 2\n"}, "line 1: width and height must be whole numbers"),
    "focal length": ({"cameras": "1 PINHOLE 4 3 0 1 2 2\n"}, "line 1: focal lengths must be greater than 0"),
    "short": ({"cameras": "1 PINHOLE\n"}, "line 1: expected CAMERA_ID MODEL WIDTH HEIGHT"),
    "twice": ({"cameras": 2 * "1 PINHOLE 4 3 1 1 2 2\n"}, "line 2: a second camera has the id 1"),
    "no camera": ({"images": "1 1 0 0 0 0 0 0 9 a.jpg\n\n"}, "images.txt, line 1: no camera has the id 9; .* has 1, 2, 3"),
    "image": ({"images": "1 1 0 0 0 0 0 0 1\n\n"}, "line 1: expected IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME"),
    "rotation": ({"images": "1 0 0 0 0 0 0 0 1 a.jpg\n\n"}, "line 1: the rotation must be a quaternion"),
    "translation": ({"images": "1 1 0 0 0 0 nan 0 1 a.jpg\n"}, "line 1: rotation and translation must be finite numbers"),
    "points": ({"images": "1 1 0 0 0 0 0 0 1 a.jpg\n2 1 0 0 0 0 0 0 1 b.jpg\n"}, "line 2: expected the points of the"),
    "same name": ({"images": 2 * "1 1 0 0 0 0 0 0 1 a.jpg\n\n"}, "line 3: a second image is called 'a.jpg'"),
    "empty": ({"images": "# nothing\n"}, "images.txt: has no image"),
}


@pytest.mark.parametrize("files, message", BAD.values(), ids=BAD)
def test_what_cannot_be_read_is_named(model, files, message):
    with pytest.raises(SceneError, match=message):
        rb.cameras_from_colmap(model(**files))


def test_a_binary_model_is_to_be_converted(tmp_path):
    with pytest.raises(FileNotFoundError, match="cameras.txt: file not found"):
        rb.cameras_from_colmap(tmp_path)
    (tmp_path / "cameras.bin").write_bytes(b"\0\1")
    with pytest.raises(SceneError, match="colmap model_converter"):
        rb.cameras_from_colmap(tmp_path)
    (tmp_path / "cameras.txt").write_bytes(b"\xff\xfe1 PINHOLE")
    with pytest.raises(SceneError, match="cameras.txt, line 1: is no text"):
        rb.cameras_from_colmap(tmp_path)
