"""Cameras of a NeRF data set."""

import json
import math
import warnings

import pytest
import torch
from PIL import Image

import torch_radbp as rb
from tests.io.test_opencv import seen_by
from torch_radbp.io.transform import rotate, translate
from torch_radbp.plugin import SceneError

POSE = (translate((1, 2, 3)) @ rotate((0.3, 1, 0.2), 50)).tolist()
BLENDER = {"camera_angle_x": 0.7, "frames": [{"file_path": "./train/r_0", "rotation": 0.01, "transform_matrix": POSE}]}
OPENCV = {"camera_model": "OPENCV", "fl_x": 33, "fl_y": 34, "cx": 20.5, "cy": 14.5, "w": 40, "h": 30, "k1": -0.1, "k2": 0.02,
          "p1": 0.003, "p2": -0.004, "aabb_scale": 16,
          "frames": [{"file_path": "images/a.jpg", "transform_matrix": POSE},
                     {"file_path": "images/b.jpg", "transform_matrix": POSE[:3], "fl_x": 50, "w": 44}]}


def read(folder, document, **options):
    path = folder / "transforms.json"
    path.write_text(document if isinstance(document, str) else json.dumps(document))
    return rb.cameras_from_nerf(path, **options)


def test_intrinsics_are_those_of_all_frames_or_of_one(tmp_path):
    found = read(tmp_path, OPENCV)
    assert list(found) == ["images/a.jpg", "images/b.jpg"]
    first, second = found.values()
    assert [float(value) for value in (first.fx, first.fy, first.cx, first.cy)] == [33, 34, 20, 14]  # from 20.5 and 14.5
    assert [float(getattr(first, name)) for name in ("k1", "k2", "p1", "p2")] == pytest.approx([-0.1, 0.02, 0.003, -0.004])
    assert first.k3 is None and (first.film.width, first.film.height) == (40, 30)
    assert float(second.fx) == 50 and float(second.fy) == 34 and second.film.width == 44
    torch.testing.assert_close(first.to_world, second.to_world, rtol=0, atol=0)


@pytest.mark.parametrize("column, row", [(0, 0), (30, 5)])
def test_axes_are_those_of_opengl_and_pixels_are_counted_from_the_corner(tmp_path, column, row):
    """x to the right, y up, z back; the middle of the image is at half its width."""
    sensor, = read(tmp_path, BLENDER, width=40, height=30).values()
    o, d = seen_by(sensor, column, row)
    pose = torch.tensor(POSE, dtype=torch.float64)
    x, y, z = pose[:3, :3].T @ (o + 2 * d - pose[:3, 3])
    focal = 20 / math.tan(0.35)
    assert z < 0
    assert float(x / -z) * focal + 20 == pytest.approx(column + 0.5, abs=1e-4)
    assert 15 - float(y / -z) * focal == pytest.approx(row + 0.5, abs=1e-4)


def test_the_size_is_that_of_the_image_if_nothing_says_it(tmp_path):
    (tmp_path / "train").mkdir()
    Image.new("RGB", (16, 12)).save(tmp_path / "train" / "r_0.png")
    found = read(tmp_path, BLENDER, scale=0.5)
    assert list(found) == ["train/r_0"]
    assert (found["train/r_0"].film.width, found["train/r_0"].film.height) == (8, 6)


@pytest.mark.parametrize("says", [{"camera_model": "OPENCV_FISHEYE"}, {"camera_model": None, "is_fisheye": True}])
def test_a_fisheye(tmp_path, says):
    document = {key: value for key, value in (OPENCV | says | {"k3": 0.3, "k4": 0.4, "p1": 0, "p2": 0}).items()
                if value is not None}
    sensor = next(iter(read(tmp_path, document).values()))
    assert sensor.distortion == "fisheye" and float(sensor.k4) == pytest.approx(0.4)


def test_a_scene_is_rendered(tmp_path):
    scene = rb.load_dict({"type": "scene", "sky": {"type": "constant", "radiance": 2.0}, "ball": {"type": "sphere"},
                          **read(tmp_path, BLENDER, width=8, height=6)})
    image = rb.render(scene, spp=1, max_depth=1)
    assert image.shape == (1, 3, 6, 8) and (image == 2).any()


def test_keys_that_are_not_read_are_told(tmp_path):
    with pytest.warns(UserWarning, match="not read: rolling_shutter; read are w, h, fl_x"):
        read(tmp_path, OPENCV | {"rolling_shutter": [0, 0, 0]})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read(tmp_path, OPENCV)


def with_frame(**changes):
    return OPENCV | {"frames": [OPENCV["frames"][0] | changes]}


BAD = {
    "no JSON": ('{"frames": [\n1,\n}', "transforms.json, line 3: is no JSON"),
    "a list": ("[1]", "must be a JSON object with \"frames\", got a list"),
    "no frames": ({"frames": []}, "must have \"frames\", a list"),
    "frame": ({"frames": [3]}, r"frames\[0\]: must be an object, got 3"),
    "name": (with_frame(file_path=None), r"frames\[0\].file_path: must be the name"),
    "fisheye": (OPENCV | {"is_fisheye": "false"}, "is_fisheye must be true or false, got 'false'"),
    "same name": (OPENCV | {"frames": 2 * OPENCV["frames"][:1]}, r"frames\[1\].file_path: a second"),
    "model": (OPENCV | {"camera_model": "EQUIRECTANGULAR"}, "'EQUIRECTANGULAR' is not supported; .*OPENCV_FI"),
    "coefficient": (OPENCV | {"k4": 0.1}, "k4 = 0.1 is no coefficient of the camera_model OPENCV; known: k1, k2, k3"),
    "pinhole": (OPENCV | {"camera_model": "PINHOLE"}, "k1 = -0.1 is no coefficient of the camera_model PINHOLE; known: no"),
    "number": (OPENCV | {"fl_x": "33"}, "fl_x must be a finite number, got '33'"),
    "not finite": (OPENCV | {"cx": math.nan}, "cx must be a finite number, got nan"),
    "focal length": (OPENCV | {"fl_x": 0}, "fl_x must be greater than 0 and finite, got 0"),
    "no focal length": (BLENDER | {"camera_angle_x": None, "w": 4, "h": 3}, "the focal length is missing: give fl_x"),
    "angle": (BLENDER | {"camera_angle_x": 3.2, "w": 4, "h": 3}, "camera_angle_x must be between 0 and pi"),
    "size": (OPENCV | {"w": 40.5}, "w and h must be whole numbers"),
    "no size": (BLENDER, "the size of the image is not known.*give width= and height="),
    "matrix": (with_frame(transform_matrix=[[1, 2], [3, 4]]), r"frames\[0\].transform_matrix: must be a 4 x 4 matrix"),
    "no matrix": (with_frame(transform_matrix=None), r"frames\[0\].transform_matrix: must be a 4 x 4 matrix"),
    "matrix beyond float64": (with_frame(transform_matrix=[[10**400, 0, 0, 0], *POSE[1:]]), "must be a 4 x 4 matrix of fin"),
    "matrix beyond float32": (with_frame(transform_matrix=[[1e39, 0, 0, 0], *POSE[1:]]), "must be a 4 x 4 matrix of fin"),
    "focal length beyond float32": (OPENCV | {"fl_x": 1e-46}, "fl_x must be greater than 0 and finite, got 1e-46"),
    "flat": (with_frame(transform_matrix=[[1, 0, 0, 0], [0, 1, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]]),
             "axes must be orthogonal and right-handed"),
}


@pytest.mark.parametrize("document, message", BAD.values(), ids=BAD)
def test_what_cannot_be_read_is_named(tmp_path, document, message):
    with pytest.raises(SceneError, match=message):
        read(tmp_path, document)


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(FileNotFoundError, match="transforms.json: file not found"):
        rb.cameras_from_nerf(tmp_path / "transforms.json")
