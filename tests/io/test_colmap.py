"""Cameras of a COLMAP model, text and binary."""

import math
import random
import struct
import tracemalloc

import pytest
import torch

import torch_radbp as rb
from tests.io.colmap_files import CAMERAS, IMAGES, binary
from tests.io.pixel_rays import seen_by
from torch_radbp.plugin import SceneError


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
    (4, {"fx": 33, "fy": 33, "k1": -0.1, "k2": 0.02, "p1": None}), (5, {"k2": 0.02, "p1": 0.003, "p2": -0.004, "k3": None}),
    (8, {"fx": 21, "fy": 21, "k1": -0.04, "k2": None}), (9, {"fy": 21, "k1": -0.04, "k2": 0.01, "k3": None}),
    (10, {"fx": 26, "fy": 27, "omega": 0.9, "k1": None}), (12, {"fx": 21, "fy": 21, "k1": None}), (13, {"fy": 22}),
    (11, {"fy": 22, "k1": -0.04, "k2": 0.01, "p1": 0.01, "p2": -0.02, "k3": 0.003, "k4": -0.001, "sx1": 0.015,
          "sy1": -0.01})])
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


def theta_of(x, y, z):
    """What COLMAP calls the fisheye's normal form: a direction as its angle to the axis times its way around it."""
    return math.atan2(math.hypot(x, y), z) * complex(x, y) / math.hypot(x, y)


def prism(x, y, z):
    """THIN_PRISM_FISHEYE in complex numbers: 2 (p2 Re + p1 Im) z + |z|^2 (p2 + i p1) is its tangential part."""
    place = theta_of(x, y, z)
    s = abs(place)**2
    return (place * (1 - 0.04 * s + 0.01 * s**2 + 0.003 * s**3 - 0.001 * s**4)
            + 2 * (-0.02 * place.real + 0.01 * place.imag) * place + s * complex(-0.02 + 0.015, 0.01 - 0.01))


def fov(x, y, z):
    return math.atan(2 * math.hypot(x, y) / z * math.tan(0.45)) / 0.9 * complex(x, y) / math.hypot(x, y)


PROJECTED = {  # by the formulas of COLMAP's models.h, in plain numbers: the image plane as complex numbers
    8: (21, 21, lambda x, y, z: theta_of(x, y, z) * (1 - 0.04 * abs(theta_of(x, y, z))**2)),
    9: (21, 21, lambda x, y, z: theta_of(x, y, z) * (1 - 0.04 * abs(theta_of(x, y, z))**2
                                                     + 0.01 * abs(theta_of(x, y, z))**4)),
    10: (26, 27, fov), 11: (21, 22, prism), 12: (21, 21, theta_of), 13: (21, 22, theta_of),
}


@pytest.mark.parametrize("column, row", [(0, 0), (39, 4), (22, 28)])
@pytest.mark.parametrize("camera", PROJECTED)
def test_wide_angle_models_project_as_colmap_does(model, camera, column, row):
    """The camera at the origin looks along +z; ours has x to the left and y up where COLMAP has them right and down."""
    fx, fy, plane = PROJECTED[camera]
    sensor, = rb.cameras_from_colmap(model(images=f"1 1 0 0 0 0 0 0 {camera} a.jpg\n")).values()
    _, d = seen_by(sensor, column, row)
    place = plane(*(float(part) for part in d))  # the world's axes are COLMAP's
    assert fx * place.real + 20 == pytest.approx(column + 0.5, abs=1e-4)
    assert fy * place.imag + 15 == pytest.approx(row + 0.5, abs=1e-4)


@pytest.mark.parametrize("omega, kept", [("-0.9", 0.9), ("0", 1e-6), ("1e-3", 1e-3)])
def test_the_sign_of_omega_does_not_matter_and_zero_is_a_pinhole(model, omega, kept):
    sensor, = rb.cameras_from_colmap(model(f"1 FOV 40 30 26 27 20 15 {omega}\n", "1 1 0 0 0 0 0 0 1 a.jpg\n")).values()
    assert float(sensor.omega) == pytest.approx(kept)
    if omega == "0":
        _, d = seen_by(sensor, 0, 0)
        assert 26 * float(d[0] / d[2]) + 20 == pytest.approx(0.5, abs=1e-4)


def test_a_scene_is_rendered_from_all_of_them(model):
    scene = rb.load_dict({"type": "scene", "sky": {"type": "constant", "radiance": 2.0}, "ball": {"type": "sphere"},
                          **rb.cameras_from_colmap(model(), scale=0.1, far_clip=50.0)})
    image = rb.render(scene, spp=1, max_depth=1, sensors=[0, 2])
    assert image.shape == (2, 3, 3, 4) and torch.isfinite(image).all() and (image > 1.5).any()
    assert scene.sensors[1].far_clip == 50


BAD = {
    "model": ({"cameras": "1 RAD_TAN_THIN_PRISM_FISHEYE 4 3 1 1 2 2 0 0 0 0 0 0 0 0 0 0 0 0\n"},
              "cameras.txt, line 1: the camera model RAD_TAN_THIN_PRISM_FISHEYE is not supported; .*THIN_PRISM_FISHEYE"),
    "omega": ({"cameras": "1 FOV 4 3 1 1 2 2 3.2\n"}, "line 1: omega must be less than pi radians, got 3.2"),
    "parameters": ({"cameras": "# list\n1 PINHOLE 4 3 1 1 2\n"},
                   "cameras.txt, line 2: PINHOLE has the parameters fx fy cx cy, got 3 numbers"),
    "no number": ({"cameras": "1 PINHOLE 4 3 1 one 2 2\n"}, "line 1: parameters must be finite numbers, got '1 one 2 2'"),
    "not finite": ({"cameras": "1 PINHOLE 4 3 1 inf 2 2\n"}, "line 1: parameters must be finite numbers"),
    "not finite in float32": ({"cameras": "1 PINHOLE 4 3 1 1 2 3e39\n"}, "line 1: parameters must be finite numbers, got"),
    "focal length that underflows": ({"cameras": "1 PINHOLE 4 3 1 1e-46 2 2\n"}, "line 1: focal lengths must be greater"),
    "far away": ({"images": "1 1 0 0 0 0 1e40 0 1 a.jpg\n"}, "line 1: rotation and translation must be finite numbers"),
    "size": ({"cameras": "1 PINHOLE 4.5 3 1 1 2 2\n"}, "line 1: width and height must be whole numbers"),
    "huge": ({"cameras": "1 PINHOLE 2e9 2e9 1 1 2 2\n"}, "line 1: an image may have 1 to 134217728 pixels, this one has 2e"),
    "focal length": ({"cameras": "1 PINHOLE 4 3 0 1 2 2\n"}, "line 1: focal lengths must be greater than 0"),
    "short": ({"cameras": "1 PINHOLE\n"}, "line 1: expected CAMERA_ID MODEL WIDTH HEIGHT"),
    "twice": ({"cameras": 2 * "1 PINHOLE 4 3 1 1 2 2\n"}, "line 2: a second camera has the id 1"),
    "no camera": ({"images": "1 1 0 0 0 0 0 0 99 a.jpg\n\n"}, "images.txt, line 1: no camera has the id 99; .* has 1, 2, 3"),
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


def test_a_binary_model_is_what_its_text_is(model, tmp_path):
    as_text = rb.cameras_from_colmap(model())
    (tmp_path / "binary").mkdir()
    found = rb.cameras_from_colmap(binary(tmp_path / "binary"))
    assert list(found) == list(as_text) == ["first.jpg", "folder/second view.jpg", "third.png"]
    for name, camera in found.items():
        values, expected = dict(camera.named_parameters()), dict(as_text[name].named_parameters())
        assert set(values) == set(expected) and camera.distortion == as_text[name].distortion
        for key, value in values.items():
            assert torch.equal(value, expected[key]), (name, key)


def test_text_is_read_where_both_are(model):
    folder = binary(model(), images=IMAGES.replace("first", "other"))
    assert list(rb.cameras_from_colmap(folder))[0] == "first.jpg"


BAD_BINARY = {
    "empty": ("cameras.bin", lambda data: b"", "cameras.bin, record 0: the file ends after 0 bytes; is it cut short"),
    "cut short": ("cameras.bin", lambda data: data[:-1], "cameras.bin, record 13: the file ends after .*; is it cut short"),
    "no model": ("cameras.bin", lambda data: data[:12] + b"\x63" + data[13:], "record 1: the camera model 99 is not known"),
    "not supported": ("cameras.bin", lambda data: data[:12] + b"\x10" + data[13:], "record 1: the camera model EUCM is not"),
    "many": ("images.bin", lambda data: b"\xff" * 8 + data[8:], "images.bin, record 4: the file ends after"),
    "points": ("images.bin", lambda data: data[:-8] + b"\xff" * 8, "images.bin, record 3: the file ends after"),
    "no end of a name": ("images.bin", lambda data: data[:72] + b"a" * 9999, "more than 4096 bytes; is the file damaged"),
    "no name": ("images.bin", lambda data: data[:72] + data[data.index(b"\0", 72):], "record 1: an image must have a name"),
    "no text": ("images.bin", lambda data: data[:72] + b"\xff\xfe" + data[74:], "the name of an image is no text"),
    "not finite": ("images.bin", lambda data: data[:12] + b"\xff" * 8 + data[20:], "record 1: rotation and translation"),
}


@pytest.mark.hostile
@pytest.mark.parametrize("name, damaged, message", BAD_BINARY.values(), ids=BAD_BINARY)
def test_a_damaged_binary_model_is_named(tmp_path, name, damaged, message):
    path = binary(tmp_path) / name
    path.write_bytes(damaged(path.read_bytes()))
    with pytest.raises(SceneError, match=message):
        rb.cameras_from_colmap(tmp_path)


@pytest.mark.hostile
@pytest.mark.parametrize("name", ["cameras.bin", "images.bin"])
def test_a_binary_model_that_is_cut_anywhere_is_said_to_be_cut(tmp_path, name):
    path = binary(tmp_path) / name
    content = path.read_bytes()
    for length in range(len(content)):
        path.write_bytes(content[:length])
        with pytest.raises(SceneError, match=rf"{name}, record \d+: the file ends after {length} bytes; is it cut short"):
            rb.cameras_from_colmap(tmp_path)


@pytest.mark.hostile
@pytest.mark.parametrize("name", ["cameras.bin", "images.bin"])
def test_random_bytes_are_refused_with_little_memory(tmp_path, name):
    """Whatever they count: 200 files whose first number says that there are records."""
    path, source = binary(tmp_path) / name, random.Random(name)
    tracemalloc.start()
    for _ in range(200):
        content = struct.pack("<Q", source.choice((1, 3, 2**32, 2**64 - 1))) + source.randbytes(source.randrange(2000))
        path.write_bytes(content)
        with pytest.raises(SceneError, match=f"{name}, record 1: "):
            rb.cameras_from_colmap(tmp_path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2**20


def test_a_model_that_is_not_there_is_told(tmp_path):
    with pytest.raises(FileNotFoundError, match="cameras.txt: file not found"):
        rb.cameras_from_colmap(tmp_path)
    (tmp_path / "cameras.txt").write_bytes(b"\xff\xfe1 PINHOLE")
    with pytest.raises(SceneError, match="cameras.txt, line 1: is no text"):
        rb.cameras_from_colmap(tmp_path)
