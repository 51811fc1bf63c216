"""The camera without perspective, as Mitsuba 3.9.1 defines it."""

import math
import warnings

import pytest
import torch

import torch_radbp as rb
from tests.scenes import GLOW, load, look_at, overhead, rectangle
from torch_radbp.boundary.terms.jump_watch import SilhouetteWarning
from torch_radbp.film.box import Box
from torch_radbp.film.hdrfilm import HDRFilm
from torch_radbp.io.values.transform import rotate, scale, translate
from torch_radbp.sensor.orthographic import Orthographic
from torch_radbp.tensors.vec import Vec2

HALF = torch.tensor([0.5], dtype=torch.float64)
POSE = translate((1, 2, 3)) @ rotate((0, 1, 0), 30) @ scale((2, 3, 4))


def camera(width=16, height=8, crop=None, **attributes) -> Orthographic:
    """A camera in float64 with a box filter, so that u = v = 0.5 is the centre of the pixel."""
    return Orthographic(film=HDRFilm(width=width, height=height, rfilter=Box(), **(crop or {})), **attributes).double()


def ray(sensor: Orthographic, column: float, row: float) -> tuple[torch.Tensor, torch.Tensor]:
    """(origin, direction) of the ray through the centre of a pixel, (3,) each."""
    column, row = torch.tensor([[column], [row]], dtype=torch.int32)
    found, _ = sensor.tensors().sample_ray(column, row, Vec2(HALF, HALF))
    return found.o.stack()[0].detach(), found.d.stack()[0].detach()


def test_rays_start_on_a_scaled_rectangle_and_are_parallel():
    """`sample_ray` of Mitsuba 3.9.1 for this camera gives the origins (3.73205, 3.5, 3.73205) at the upper left corner,
    (0.26795, 0.5, 5.73205) at the lower right one, and the direction (0.5, 0, 0.866025) at both."""
    sensor = camera(to_world=torch.as_tensor(POSE), near_clip=0.5, far_clip=9.0)
    first, last = torch.tensor([3.73205, 3.5, 3.73205]).double(), torch.tensor([0.26795, 0.5, 5.73205]).double()
    for column, row in ((0, 0), (15, 7), (4, 6)):
        o, d = ray(sensor, column, row)
        x, y = (column + 0.5) / 16, (row + 0.5) / 8
        assert torch.allclose(d, torch.tensor([0.5, 0, math.sqrt(3) / 2]).double(), rtol=0, atol=1e-6)
        across = torch.tensor([-math.sqrt(3) / 2, 0, 0.5]).double() * 4  # from left to right
        assert torch.allclose(o, first + x * across + y * torch.tensor([0, -3.0, 0]).double(), rtol=0, atol=2e-5)
    assert torch.allclose(first + across + torch.tensor([0, -3.0, 0]).double(), last, rtol=0, atol=2e-5)


def test_a_crop_shows_that_part_of_the_whole_image():
    window = {"crop_offset_x": 4, "crop_offset_y": 3, "crop_width": 4, "crop_height": 4}
    whole, part = camera(), camera(crop=window)
    for column, row in ((0, 0), (3, 2)):
        torch.testing.assert_close(ray(part, column, row)[0], ray(whole, column + 4, row + 3)[0], rtol=0, atol=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_rays_are_those_of_mitsuba(seed):
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    generator = torch.Generator().manual_seed(seed)
    matrix = torch.eye(4, dtype=torch.float64)
    matrix[:3] = torch.randn(3, 4, generator=generator, dtype=torch.float64)
    film = {"type": "hdrfilm", "width": 12, "height": 7 + seed, "crop_offset_x": seed, "crop_width": 5,
            "rfilter": {"type": "box"}}
    theirs = mi.load_dict({"type": "orthographic", "to_world": mi.ScalarTransform4f(matrix.numpy()), "film": film,
                           "near_clip": 0.3, "far_clip": 5.0})
    ours = camera(12, 7 + seed, {"crop_offset_x": seed, "crop_width": 5}, to_world=matrix, near_clip=0.3, far_clip=5.0)
    for column, row in ((0, 0), (4, 6), (2, 3)):
        expected, _ = theirs.sample_ray(0, 0.5, mi.Point2f((column + 0.5) / 5, (row + 0.5) / (7 + seed)), mi.Point2f(0.5))
        o, d = ray(ours, column, row)
        torch.testing.assert_close(o, torch.tensor(list(expected.o), dtype=torch.float64), rtol=0, atol=1e-5)
        torch.testing.assert_close(d, torch.tensor(list(expected.d), dtype=torch.float64), rtol=0, atol=1e-5)
        end = ours.tensors().lens.depth
        assert float(end) == pytest.approx(float(expected.maxt), rel=1e-6)


def seen(**attributes) -> float:
    """Mean radiance of a poster at z = 0 that fills the view of a camera at z = 2."""
    pose = look_at((0, 0, 2), (0, 0, 0), (0, 1, 0))
    sensor = {"type": "orthographic", "to_world": pose, "film": {"type": "hdrfilm", "width": 4, "height": 4}} | attributes
    return float(rb.render(load(sensor=sensor, poster=rectangle((0, 0, 0), 10.0, emitter=GLOW)), spp=4, max_depth=1).mean())


def test_what_is_before_the_near_plane_or_behind_the_far_plane_is_not_seen():
    assert [seen(near_clip=near) for near in (1.9, 2.1)] == [1, 0]
    assert [seen(far_clip=far) for far in (2.1, 1.9)] == [1, 0]
    # The far plane lies far_clip - near_clip behind the near one, whose distance is scaled with the pose.
    stretched = look_at((0, 0, 2), (0, 0, 0), (0, 1, 0)) @ scale((1, 1, 3))
    assert [seen(to_world=stretched, near_clip=0.5, far_clip=far) for far in (1.1, 0.9)] == [1, 0]


def test_size_does_not_depend_on_distance():
    images = []
    for z in (0.0, -5.0):
        scene = load(sensor=overhead(8, 2.0), lamp=rectangle((0, 0, z), 0.5, emitter=GLOW))
        images.append(rb.render(scene, spp=16, max_depth=1))
    assert torch.equal(*images)
    assert float(images[0].mean()) == pytest.approx(0.25, abs=1e-6)  # edges of the lamp fall on edges of pixels


def warned(**shapes) -> list[str]:
    pose = look_at((2, 3, 4), (0, 0, 0), (0, 1, 0))
    scene = load(sensor={"type": "orthographic", "to_world": pose, "film": {"type": "hdrfilm", "width": 4, "height": 4}},
                 sky={"type": "constant"}, **shapes)
    scene.get_parameter("sensor.to_world").requires_grad_()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        rb.render(scene, spp=1, max_depth=1, terms=["interior"])
    return [str(warning.message) for warning in caught if issubclass(warning.category, SilhouetteWarning)]


def test_silhouettes_are_those_of_parallel_rays():
    """The outline of a cube is a hexagon wherever it stands; beside the view it does not count, however far away."""
    for depth in (0.0, -4.0):
        place = look_at((2, 3, 4), (0, 0, 0), (0, 1, 0))[:3, 2] * -depth
        message, = warned(box={"type": "cube", "to_world": translate(place) @ scale((0.3, 0.3, 0.3))})
        assert "`sensor.to_world`" in message and "6 edges" in message
    beside = look_at((2, 3, 4), (0, 0, 0), (0, 1, 0)) @ translate((1.6, 0, 40)) @ scale((0.3, 0.3, 0.3))
    assert warned(box={"type": "cube", "to_world": beside}) == []


@pytest.mark.parametrize("attributes, message", [
    ({"near_clip": 0.0}, "near_clip must be positive"), ({"near_clip": 2.0, "far_clip": 1.0}, "less than far_clip"),
    ({"to_world": torch.zeros(4, 4)}, "to_world must be affine")], ids=["near", "far", "flat"])
def test_a_camera_that_cannot_be(attributes, message):
    with pytest.raises(ValueError, match=message):
        Orthographic(**attributes)


def test_a_field_of_view_is_refused():
    with pytest.raises(rb.SceneError, match="no attribute 'fov'"):
        load(sensor={"type": "orthographic", "fov": 40.0}, lamp=rectangle((0, 0, 0), emitter=GLOW))
