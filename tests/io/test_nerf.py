"""Cameras of a NeRF data set."""

import json
import math
import warnings

import pytest
import torch
from PIL import Image

import torch_radbp as rb
from tests.io.nerf_files import BLENDER, OPENCV, POSE
from tests.io.pixel_rays import seen_by
from torch_radbp.plugin import SceneError


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
    assert float(second.fx) == float(second.fy) == 50 and second.film.width == 44
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


@pytest.mark.parametrize("frame, expected", [
    ({"camera_angle_x": 0.8}, (20 / math.tan(0.4),) * 2),  # beside fl_x and fl_y of the document
    ({"fl_x": 50}, (50, 50)), ({"fl_y": 60}, (60, 60)), ({"fl_x": 50, "fl_y": 60}, (50, 60)),
    ({"fl_x": None}, (33, 34)), ({"camera_angle_y": 0.8, "fl_x": 7}, (7, 15 / math.tan(0.4)))])
def test_what_a_frame_says_of_its_focal_lengths_wins_as_a_whole(tmp_path, frame, expected):
    """As instant-ngp reads them: what one frame says is not mixed with what all others have."""
    sensor, = read(tmp_path, OPENCV | {"frames": [OPENCV["frames"][0] | frame]}).values()
    assert (float(sensor.fx), float(sensor.fy)) == pytest.approx(expected)


def test_what_a_frame_says_of_its_lens_wins_as_a_whole(tmp_path):
    document = OPENCV | {"p1": 0, "p2": 0, "frames": [OPENCV["frames"][0] | {"is_fisheye": True}, OPENCV["frames"][1]]}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        first, second = read(tmp_path, document).values()
    assert (first.distortion, second.distortion) == ("fisheye", "brown_conrady")
    first, = read(tmp_path, OPENCV | {"frames": [OPENCV["frames"][0] | {"k2": 0.5, "cx": 10}]}).values()
    assert float(first.k2) == 0.5 and float(first.cx) == 9.5 and float(first.cy) == 14  # other things are said one by one


@pytest.mark.parametrize("model, coefficients, distortion", [
    ("SIMPLE_RADIAL", {"k1": -0.1}, "brown_conrady"), ("RADIAL", {"k1": -0.1, "k2": 0.02}, "brown_conrady"),
    ("SIMPLE_RADIAL_FISHEYE", {"k1": -0.1}, "fisheye"), ("RADIAL_FISHEYE", {"k1": -0.1, "k2": 0.02}, "fisheye")])
def test_radial_models(tmp_path, model, coefficients, distortion):
    document = OPENCV | {"k1": 0, "k2": 0, "p1": 0, "p2": 0} | coefficients | {"camera_model": model}
    sensor = next(iter(read(tmp_path, document).values()))
    assert sensor.distortion == distortion and sensor.p1 is None and sensor.k3 is None
    for name, value in coefficients.items():
        assert float(getattr(sensor, name)) == pytest.approx(value)
    with pytest.raises(SceneError, match=f"k3 = 0.1 is no coefficient of the camera_model {model}; known: k1"):
        read(tmp_path, document | {"k3": 0.1})


@pytest.mark.parametrize("model, is_fisheye", [("OPENCV", True), ("PINHOLE", True), ("OPENCV_FISHEYE", False)])
def test_a_model_that_contradicts_is_fisheye_counts_and_that_is_told(tmp_path, model, is_fisheye):
    document = OPENCV | {"k1": 0, "k2": 0, "p1": 0, "p2": 0, "camera_model": model, "is_fisheye": is_fisheye}
    message = (f"images/a.jpg, images/b.jpg: camera_model {model} counts in .*transforms.json, not is_fisheye "
               f"{str(is_fisheye).lower()} beside it")
    with pytest.warns(UserWarning, match=message):
        sensor = next(iter(read(tmp_path, document).values()))
    assert sensor.distortion == ("fisheye" if model == "OPENCV_FISHEYE" else "brown_conrady")
    with pytest.raises(SceneError, match=message):
        read(tmp_path, document, strict=True)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read(tmp_path, document | {"is_fisheye": not is_fisheye})


def skewed(by: float) -> list:
    """A pose whose x axis leans towards its y axis by so many radians."""
    pose = torch.tensor(POSE, dtype=torch.float64)
    x, y = pose[:3, 0].clone(), pose[:3, 1]
    pose[:3, 0] = math.cos(by) * x + math.sin(by) * y
    return pose.tolist()


def test_axes_that_are_skewed_a_little_are_made_orthogonal_and_by_how_much_is_told(tmp_path):
    """The nearest rotation turns each of the two axes by half of the angle between them."""
    document = OPENCV | {"frames": [{"file_path": f"{n}.jpg", "transform_matrix": skewed(by)}
                                    for n, by in enumerate((2e-3, 0.0, 5e-3, 9e-3, 3e-3))]}
    message = (r"0.jpg \(0.11 degrees\), 2.jpg \(0.29 degrees\), 3.jpg \(0.52 degrees\) and 1 more: the axes of "
               r"transform_matrix in .*transforms.json are skewed, and made orthogonal")
    with pytest.warns(UserWarning, match=message) as caught:
        found = list(read(tmp_path, document).values())
    assert len(caught) == 1
    for camera, by in zip(found, (2e-3, 0.0, 5e-3)):
        axes = camera.to_world[:3, :3].double()
        torch.testing.assert_close(axes.T @ axes, torch.eye(3, dtype=torch.float64), rtol=0, atol=1e-6)
        x = -axes[:, 0] @ torch.tensor(POSE, dtype=torch.float64)[:3, :3]  # ours points to the left
        assert float(torch.atan2(x[1], x[0])) == pytest.approx(by / 2, abs=1e-6)
    with pytest.raises(SceneError, match="0.jpg"):
        read(tmp_path, document, strict=True)


def test_axes_within_rounding_are_not_spoken_of_and_skewed_more_they_are_refused(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        camera, = read(tmp_path, with_frame(transform_matrix=skewed(5e-4)), strict=True).values()
    axes = camera.to_world[:3, :3].double()
    torch.testing.assert_close(axes.T @ axes, torch.eye(3, dtype=torch.float64), rtol=0, atol=1e-6)
    with pytest.raises(SceneError, match="its axes must be orthogonal and right-handed"):
        read(tmp_path, with_frame(transform_matrix=skewed(2e-2)))


@pytest.mark.parametrize("name", ["r_0.webp", "r_0.tif", "r_0.JPG", "r_0.bmp"])
def test_the_size_may_be_that_of_any_kind_of_image_and_names_may_lack_the_extension(tmp_path, name):
    (tmp_path / "train").mkdir()
    Image.new("RGB", (16, 12)).save(tmp_path / "train" / name, format="JPEG" if name.endswith("JPG") else None)
    sensor, = read(tmp_path, BLENDER).values()
    assert (sensor.film.width, sensor.film.height) == (16, 12)
    document = BLENDER | {"frames": [BLENDER["frames"][0] | {"file_path": ".\\train\\" + name}]}  # as Windows has it
    sensor, = read(tmp_path, document).values()
    assert (sensor.film.width, sensor.film.height) == (16, 12)


def test_frames_whose_size_no_image_says_are_left_out_and_told(tmp_path):
    Image.new("RGB", (16, 12)).save(tmp_path / "2.png")
    document = BLENDER | {"frames": [{"file_path": str(n), "transform_matrix": POSE} for n in range(6)]}
    with pytest.warns(UserWarning, match="0, 1, 3 and 2 more: left out of .*transforms.json: the image is not there"):
        assert list(read(tmp_path, document)) == ["2"]
    for insisting in ({"missing": "error"}, {"strict": True}):
        with pytest.raises(SceneError, match="the size of the image is not known|left out of"):
            read(tmp_path, document, **insisting)
    assert len(read(tmp_path, document, width=16, height=12)) == 6  # for cameras alone no image is needed
    with pytest.raises(ValueError, match="missing must be 'skip' or 'error', got 'raise'"):
        read(tmp_path, document, missing="raise")


def test_keys_that_are_not_read_are_told(tmp_path):
    with pytest.warns(UserWarning, match="rolling_shutter: not read in .*transforms.json; read are w, h, fl_x"):
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
    "huge": (OPENCV | {"w": 2**64}, "an image may have 1 to 134217728 pixels, w and h are 1.84467e.19 and 30"),
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
