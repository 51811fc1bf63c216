"""Cameras from the matrices of computer vision."""

import pytest
import torch

import torch_radbp as rb
from tests.io.pixel_rays import seen_by
from tests.scenes import GLOW, load
from torch_radbp.io.values.transform import rotate
from torch_radbp.pose import se3
from torch_radbp.tensors.vec import Vec3

K = torch.tensor([[30.0, 0.5, 17.0], [0, 28.0, 14.0], [0, 0, 1]], dtype=torch.float64)
R = torch.as_tensor(rotate((0.3, 1, -0.2), 35)[:3, :3])
T = torch.tensor([0.3, -0.2, 0.7], dtype=torch.float64)


@pytest.mark.parametrize("column, row", [(0, 0), (39, 29), (11, 22)])
def test_a_pixel_sees_the_points_that_are_projected_to_it(column, row):
    """x = K (R X + t), for a point anywhere on the ray."""
    sensor = rb.camera_from_opencv(K, R, T, 40, 30)
    o, d = seen_by(sensor, column, row)
    for t in (0.5, 7.0):
        u = K @ (R @ (o + t * d) + T)
        assert u[2] > 0
        torch.testing.assert_close(u[:2] / u[2], torch.tensor([column, row]).double(), rtol=0, atol=2e-5)


def test_arrays_lists_and_columns_are_taken_and_coefficients_are_in_the_order_of_opencv():
    sensor = rb.camera_from_opencv(K.tolist(), R.numpy(), T[:, None].numpy(), 40, 30, (0.1, 0.2, 0.3, 0.4, 0.5))
    values = [float(getattr(sensor, name)) for name in ("k1", "k2", "p1", "p2", "k3")]
    assert values == pytest.approx([0.1, 0.2, 0.3, 0.4, 0.5])
    assert sensor.k4 is None and sensor.distortion == "brown_conrady"
    fisheye = rb.camera_from_opencv(K, R, T, 40, 30, torch.tensor([0.1, 0.2, 0.3, 0.4]), fisheye=True, near_clip=0.5)
    assert float(fisheye.k4) == pytest.approx(0.4) and fisheye.p1 is None and fisheye.near_clip == 0.5


def test_a_smaller_image_sees_the_same():
    """The corners of the image are where they were: the middle of a block of 2 x 2 pixels is the middle of one."""
    whole, half = (rb.camera_from_opencv(K, R, T, 40, 30, scale=scale) for scale in (1.0, 0.5))
    assert (half.film.width, half.film.height) == (20, 15)
    o, d = seen_by(half, 7, 9)
    u = K @ (R @ (o + 3 * d) + T)
    torch.testing.assert_close(u[:2] / u[2], torch.tensor([14.5, 18.5]).double(), rtol=0, atol=2e-5)
    assert float(whole.fx) == 30 and float(half.fx) == 15


def test_cameras_of_kornia_see_what_kornia_projects():
    kornia = pytest.importorskip("kornia")
    extrinsics = torch.stack([se3(torch.tensor([0.1, 0.4, -0.2]).double() * k, T * k) for k in (1.0, -1.0)])
    intrinsics = torch.eye(4, dtype=torch.float64).repeat(2, 1, 1)
    intrinsics[:, :3, :3] = K * torch.tensor([[[1.0]], [[1.2]]])
    intrinsics[:, 2, 2], intrinsics[:, 0, 1] = 1, 0
    pinhole = kornia.geometry.camera.PinholeCamera(intrinsics, extrinsics, torch.full((2,), 30.0), torch.full((2,), 40.0))
    sensors = rb.cameras_from_kornia(pinhole)
    assert len(sensors) == 2
    for number, sensor in enumerate(sensors):
        assert (sensor.film.width, sensor.film.height) == (40, 30)
        for column, row in ((0, 0), (31, 5)):
            o, d = seen_by(sensor, column, row)
            point = (o + 2.5 * d).expand(2, 1, 3)
            found = pinhole.project(point)[number, 0]
            torch.testing.assert_close(found, torch.tensor([column, row]).double(), rtol=0, atol=2e-5)
    with pytest.raises(TypeError, match="must be a kornia.geometry.camera.PinholeCamera, got Tensor"):
        rb.cameras_from_kornia(intrinsics)


def test_an_image_shows_things_where_opencv_projects_them():
    place = torch.tensor([0.1, 0.2, 3.0], dtype=torch.float64)
    at = R.T @ (place - T)
    sensor = rb.camera_from_opencv(K, R, T, 40, 30, [0.1, 0.0, 0.01, 0.0])
    lamp = {"type": "sphere", "center": at.tolist(), "radius": 0.2, "emitter": GLOW}
    scene = load(camera=sensor, lamp=lamp)
    image = rb.render(scene, spp=64, max_depth=1)[0, 0]
    point = sensor.lens().distortion.distorted(Vec3(*(place[:, None])))
    row, column = torch.meshgrid(torch.arange(30.0), torch.arange(40.0), indexing="ij")
    u, v = 30 * float(point.x) + 0.5 * float(point.y) + 17, 28 * float(point.y) + 14
    assert float((image * column).sum() / image.sum()) == pytest.approx(u, abs=0.1)
    assert float((image * row).sum() / image.sum()) == pytest.approx(v, abs=0.1)


BAD = {
    "shape": ({"K": torch.eye(4)}, r"K must have shape \(3, 3\), got \(4, 4\)"),
    "form": ({"K": torch.ones(3, 3)}, "K must be fx, skew, cx; 0, fy, cy; 0, 0, 1"),
    "focal length": ({"K": torch.diag(torch.tensor([-1.0, 1, 1]))}, "fx must be greater than 0"),
    "rotation": ({"R": 2 * torch.eye(3)}, "R must be a rotation"),
    "mirror": ({"R": -torch.eye(3)}, "R must be a rotation"),
    "translation": ({"t": torch.zeros(4)}, r"t must have shape \(3,\) or \(3, 1\), got \(4,\)"),
    "not finite": ({"t": [0, 0, float("nan")]}, "t must be finite"),
    "no numbers": ({"t": ["a", "b", "c"]}, "t must be numbers"),
    "coefficients": ({"distortion": [0.1, 0.2]}, "0 or 4 or 5 or 8 coefficients .k1, k2, p1, p2, k3, k4, k5, k6., got 2"),
    "fisheye": ({"distortion": [0.1] * 5, "fisheye": True}, "0 or 4 coefficients .k1, k2, k3, k4., got 5"),
    "yes": ({"fisheye": "yes"}, "fisheye must be True or False, got 'yes'"),
    "gradient": ({"K": K.clone().requires_grad_()}, "K requires a gradient, which would not reach it"),
    "width": ({"width": 0}, "width must be an integer of at least 1"),
    "scale": ({"scale": 0.0}, "scale must be greater than 0"),
}


@pytest.mark.parametrize("attributes, message", BAD.values(), ids=BAD)
def test_matrices_that_are_none(attributes, message):
    with pytest.raises(ValueError, match=message):
        rb.camera_from_opencv(**{"K": K, "R": R, "t": T, "width": 40, "height": 30} | attributes)
