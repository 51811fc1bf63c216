"""Resolution pyramids: averages over areas, and cameras that see the same."""

import pytest
import torch
from torch.nn.utils import parametrize

import torch_radbp as rb
from tests.io.pixel_rays import seen_by
from tests.photographs.nerf_folder import ball_in_the_open
from tests.scenes import load, look_at, sensor
from torch_radbp.photographs.area_average import area_average

K = torch.tensor([[30.0, 0.5, 17.0], [0, 28.0, 14.0], [0, 0, 1]], dtype=torch.float64)
EYE, FAR = torch.eye(3, dtype=torch.float64), (0.0, 0.0, 3.0)


def test_averages_over_whole_blocks_are_their_means():
    image = torch.rand(3, 12, 8, dtype=torch.float64)
    expected = torch.nn.functional.avg_pool2d(image, (3, 2))
    torch.testing.assert_close(area_average(image, 4, 4), expected, rtol=1e-12, atol=0)


def test_parts_of_pixels_count_by_their_area():
    """5 pixels on 2: 1, 1 and a half each; by the matrix of overlaps."""
    image = torch.rand(1, 5, 7, dtype=torch.float64)

    def overlaps(small: int, large: int) -> torch.Tensor:
        a, b = torch.arange(small)[:, None] * (large / small), torch.arange(large)[None, :]
        return (torch.minimum(a + large / small, b + 1) - torch.maximum(a, b)).clamp_min(0).double() * (small / large)

    expected = overlaps(2, 5) @ image[0] @ overlaps(3, 7).T
    torch.testing.assert_close(area_average(image, 3, 2)[0], expected, rtol=1e-6, atol=0)
    assert float(area_average(image, 3, 2).mean()) == pytest.approx(float(image.mean()), rel=1e-12)


def test_light_is_averaged_and_not_its_code(tmp_path):
    """Black and white pixels side by side are half as bright, which sRGB codes as 0.735 and not as 0.5."""
    from PIL import Image

    board = Image.new("L", (4, 2))
    board.putdata([0, 255, 0, 255, 255, 0, 255, 0])
    board.save(tmp_path / "a.png")
    camera = rb.camera_from_opencv(K, EYE, FAR, 4, 2)
    half = rb.Photographs([tmp_path / "a.png"], [camera]).at_scale(0.5)[0]
    torch.testing.assert_close(half.image, torch.full((3, 1, 2), 0.5), rtol=1e-6, atol=0)
    assert half.mask.shape == (1, 1, 2)


def test_a_camera_at_a_scale_sees_the_same():
    whole = rb.Photographs([torch.rand(3, 30, 40)], [rb.camera_from_opencv(K, EYE, FAR, 40, 30, [0.1, 0.0, 0.0, 0.0])])
    direct = rb.camera_from_opencv(K, EYE, FAR, 40, 30, [0.1, 0.0, 0.0, 0.0], scale=0.3).double()
    camera = whole.at_scale(0.3).cameras["view_0"].double()
    assert (camera.film.width, camera.film.height) == (12, 9) and camera.film.crop_width == 12
    for one, other in zip(seen_by(camera, 7, 4), seen_by(direct, 7, 4)):
        torch.testing.assert_close(one, other, rtol=1e-6, atol=1e-6)
    assert whole.cameras["view_0"].film.width == 40 and float(whole.cameras["view_0"].fx) == 30


def test_what_is_refined_at_a_small_size_goes_on_at_a_larger_one():
    """The pose is one parameter, held by the optimizer; focal lengths begin where they are, in pixels of the new size."""
    photographs = rb.Photographs([torch.rand(3, 12, 16)], [rb.camera_from_opencv(K, EYE, FAR, 16, 12)])
    photographs = photographs.at_scale(0.5)
    scene = rb.load_dict({"type": "scene", **photographs.cameras, **ball_in_the_open(0.5, 0.5, 0.5)})
    scene.get_parameter("view_0.fx").data.fill_(20.0)
    pose = scene.get_parameter("view_0.to_world").requires_grad_()
    renderer = rb.Renderer(scene, spp=1, max_depth=2, compile=False)
    assert renderer(sensors=photographs.names).shape == (1, 3, 6, 8)
    photographs = photographs.at_scale(1.0)
    photographs.place_cameras(scene)
    assert scene.get_parameter("view_0.to_world") is pose and float(scene.get_parameter("view_0.fx")) == 40
    image = renderer(sensors=photographs.names)
    assert image.shape == photographs.batch().image.shape == (1, 3, 12, 16)
    image.sum().backward()
    assert pose.grad.isfinite().all() and pose.grad.abs().max() > 0


def test_the_middle_of_a_scaled_rendering_is_that_of_the_whole():
    """Averages of a rendering, and the rendering of a camera at half the size, by the same box filter."""
    camera = rb.camera_from_opencv(K, EYE, FAR, 32, 24, rfilter="box")
    photographs = rb.Photographs([torch.zeros(3, 24, 32)], [camera])
    scene = rb.load_dict({"type": "scene", **photographs.cameras, **ball_in_the_open(0.6, 0.3, 0.1)})
    with torch.no_grad():
        whole = rb.render(scene, spp=64, max_depth=2)
        photographs = photographs.at_scale(0.5)
        photographs.place_cameras(scene)
        half = rb.render(scene, spp=256, max_depth=2)
    assert whole.std() > 0.05
    assert (area_average(whole, 16, 12) - half).abs().max() < 0.05  # at the silhouette; noise of 64 samples
    assert (area_average(whole, 16, 12) - half).abs().mean() < 0.003


def test_other_cameras_are_resized_where_their_pixels_stay_square():
    scene = load(torch.float32, camera=sensor(8), sky={"type": "constant"}, ball={"type": "sphere"})
    half = scene.camera.resized(4, 4)
    assert half.film.width == 4 and half.to_world is scene.camera.to_world and scene.camera.film.width == 8
    with pytest.raises(ValueError, match="a perspective camera of 8 x 8 pixels cannot be one of 4 x 3"):
        scene.camera.resized(4, 3)


def test_what_cannot_be_resized_is_told():
    camera = rb.camera_from_opencv(K, EYE, FAR, 16, 12)
    photographs = rb.Photographs([torch.zeros(3, 12, 16)], [camera])
    for scale in (0, 1.5):
        with pytest.raises(ValueError, match="scale must be"):
            photographs.at_scale(scale)
    parametrize.register_parametrization(camera, "fx", rb.optim.Log())
    with pytest.raises(ValueError, match="fx has a parametrization, which would not fit another size"):
        photographs.at_scale(0.5)
    cropped = load(torch.float32, sky={"type": "constant"}, ball={"type": "sphere"}, camera=sensor(8) | {
        "to_world": look_at((0, 0, 3), (0, 0, 0), (0, 1, 0)),
        "film": {"type": "hdrfilm", "width": 8, "height": 8, "crop_width": 4}}).camera
    with pytest.raises(ValueError, match="a camera with a crop window, 4 x 8 of 8 x 8, cannot be resized"):
        cropped.resized(4, 4)


def test_cameras_are_put_in_the_place_of_those_of_their_name_only():
    photographs = rb.Photographs([torch.zeros(3, 12, 16)], [rb.camera_from_opencv(K, EYE, FAR, 16, 12)])
    scene = load(torch.float32, camera=sensor(8), sky={"type": "constant"}, ball={"type": "sphere"})
    with pytest.raises(ValueError, match="the scene has no sensor 'view_0' to put a camera in the place of; .*camera"):
        photographs.place_cameras(scene)
