"""Camera rays against the geometry of a pinhole, as Mitsuba 3 defines it: +z forward, +x to the left, row 0 at the top."""

import math
import warnings
from pathlib import Path

import pytest
import torch

import torch_radbp as rb
from tests.gradients import assert_informative, image_and_gradients, relative_error
from tests.scenes import CASES, GLOW, cornell, load, look_at, rectangle, rgb, sensor
from torch_radbp.emitter.projector import Projector
from torch_radbp.emitter.spot import Spot
from torch_radbp.film.box import Box
from torch_radbp.film.hdrfilm import HDRFilm
from torch_radbp.io.values.transform import rotate, scale, translate
from torch_radbp.sensor.perspective import Perspective
from torch_radbp.sensor.thinlens import ThinLens
from torch_radbp.tensors.vec import Vec2

HALF = torch.tensor([0.5], dtype=torch.float64)


def camera(width=24, height=16, crop=None, **attributes):
    """A camera in float64, with a box filter, so that u = v = 0.5 is the centre of the pixel."""
    film = HDRFilm(width=width, height=height, rfilter=Box(), **(crop or {}))
    return Perspective(film=film, **attributes).double()


def ray(sensor, column, row, u=HALF, v=HALF):
    """(origin, direction) of one ray, each (3,)."""
    column, row = torch.tensor([[column], [row]], dtype=torch.int32)
    found, _ = sensor.tensors().sample_ray(column, row, Vec2(u, v))
    return found.o.stack()[0].detach(), found.d.stack()[0].detach()


def slopes(sensor, column, row, **numbers):
    """x / z and y / z of a ray's direction."""
    _, d = ray(sensor, column, row, **numbers)
    return float(d[0] / d[2]), float(d[1] / d[2])


FOV = math.tan(math.radians(40) / 2)
DIAGONAL = math.hypot(36, 24) / 2
# width, height, attributes, tangent of half the field of view along x by hand
AXES = {
    "x": (24, 16, {"fov": 40, "fov_axis": "x"}, FOV),
    "y": (24, 16, {"fov": 40, "fov_axis": "y"}, FOV * 24 / 16),
    "diagonal": (24, 16, {"fov": 40, "fov_axis": "diagonal"}, FOV * 24 / math.hypot(24, 16)),
    "smaller, lying": (24, 16, {"fov": 40, "fov_axis": "smaller"}, FOV * 24 / 16),
    "smaller, upright": (16, 24, {"fov": 40, "fov_axis": "smaller"}, FOV),
    "larger, lying": (24, 16, {"fov": 40, "fov_axis": "larger"}, FOV),
    "larger, upright": (16, 24, {"fov": 40, "fov_axis": "larger"}, FOV * 16 / 24),
    "50 mm on 36 x 24": (36, 24, {"focal_length": "50mm"}, 18 / 50),
    "35 mm, upright": (16, 24, {"focal_length": "35mm"}, DIAGONAL / 35 * 16 / math.hypot(16, 24)),
    "neither: 50 mm": (36, 24, {}, 18 / 50),
}


@pytest.mark.parametrize("width, height, attributes, tangent", AXES.values(), ids=AXES)
def test_field_of_view(width, height, attributes, tangent):
    eye = camera(width, height, **attributes)
    pixel = 2 * tangent / width  # square pixels
    for column, row in ((0, 0), (width - 1, 0), (0, height - 1), (width // 2, height // 3)):
        x, y = slopes(eye, column, row)
        # Rounded to float32 when it was made: x_fov is known to 6e-8.
        assert x == pytest.approx((width / 2 - column - 0.5) * pixel, rel=3e-7, abs=1e-12)  # +x is to the left
        assert y == pytest.approx((height / 2 - row - 0.5) * pixel, rel=3e-7, abs=1e-12)  # +y is up


def test_directions_have_unit_length_and_start_on_the_near_plane():
    eye = camera(fov=70, near_clip=0.25, to_world=torch.as_tensor(look_at((1, 2, 3), (0, 0.5, -1), (0, 1, 0))))
    forward, origin = eye.to_world[:3, 2].detach(), eye.to_world[:3, 3].detach()
    for column, row in ((0, 0), (23, 0), (11, 8)):
        o, d = ray(eye, column, row)
        assert float(d.norm()) == pytest.approx(1, abs=1e-12)
        assert float((o - origin) @ forward) == pytest.approx(0.25, rel=1e-6)
        torch.testing.assert_close((o - origin) / (o - origin).norm(), d, rtol=0, atol=1e-7)


def test_row_zero_is_at_the_top_and_column_zero_at_the_left():
    eye = camera(fov=40, to_world=torch.as_tensor(look_at((0, 0, 5), (0, 0, 0), (0, 1, 0))))
    _, upper_left = ray(eye, 0, 0)
    _, lower_right = ray(eye, 23, 15)
    assert upper_left[1] > 0 > lower_right[1]
    assert upper_left[0] < 0 < lower_right[0]  # looking along -z with y up, world +x is on the right


def test_an_image_shows_things_where_they_are():
    marks = {"top": ((0, 1, 0), rgb(1, 0, 0)), "right": ((1, 0, 0), rgb(0, 1, 0))}
    lamps = {name: rectangle(at, 0.2, emitter={"type": "area", "radiance": colour}) for name, (at, colour) in marks.items()}
    scene = load(sensor=sensor(15, (0, 0, 4), (0, 0, 0), 40), **lamps)
    image = rb.render(scene, spp=256, max_depth=1)[0]
    half = 15 / (2 * 4 * math.tan(math.radians(20)))  # pixels per unit in the plane of the lamps
    rows, columns = torch.meshgrid(torch.arange(15.0) + 0.5, torch.arange(15.0) + 0.5, indexing="ij")
    for channel, (column, row) in ((0, (7.5, 7.5 - half)), (1, (7.5 + half, 7.5))):
        light = image[channel]
        assert light.max() == 1
        assert float((light * columns).sum() / light.sum()) == pytest.approx(column, abs=0.1)
        assert float((light * rows).sum() / light.sum()) == pytest.approx(row, abs=0.1)


def test_a_crop_shows_that_part_of_the_whole_image():
    window = {"crop_offset_x": 5, "crop_offset_y": 9, "crop_width": 7, "crop_height": 4}
    whole, part = camera(fov=40), camera(fov=40, crop=window)
    for column, row in ((0, 0), (6, 3), (2, 1)):
        torch.testing.assert_close(ray(part, column, row)[1], ray(whole, column + 5, row + 9)[1])
    scene = load(sensor=sensor(4, film={"type": "hdrfilm", "width": 24, "height": 16, **window}), sky={"type": "constant"},
                 wall=rectangle((0, 0, 0)))
    assert rb.render(scene, spp=1, max_depth=1).shape == (1, 3, 4, 7)


@pytest.mark.parametrize("x, y", [(0.15, 0), (0, -0.22), (-0.3, 0.1)])
def test_the_principal_point_shifts_the_image_by_fractions_of_its_size(x, y):
    plain, shifted = camera(fov=40), camera(fov=40, principal_point_offset_x=x, principal_point_offset_y=y)
    tangent = math.tan(math.radians(20))
    for column, row in ((0, 0), (20, 7)):
        before, after = slopes(plain, column, row), slopes(shifted, column, row)
        assert after[0] - before[0] == pytest.approx(-2 * x * tangent, abs=1e-7)
        assert after[1] - before[1] == pytest.approx(-2 * y * tangent * 16 / 24, abs=1e-7)


def test_the_position_inside_a_pixel_follows_the_random_numbers():
    eye = camera(fov=40)
    left, right = (slopes(eye, 3, 5, u=torch.tensor([u], dtype=torch.float64))[0] for u in (0.0, 1 - 2.0**-24))
    assert left == pytest.approx((12 - 3) * 2 * FOV / 24, rel=1e-6)
    assert right == pytest.approx((12 - 4) * 2 * FOV / 24, rel=1e-6)


@pytest.mark.parametrize("factor", [1, 2], ids=["rigid", "scaled"])
def test_the_pose_turns_and_moves_rays_and_a_scale_that_it_gets_later_does_not_matter(factor):
    """One that scales from the start is refused, see `tests/sensor/test_scaled_pose.py`."""
    pose = translate((1, 2, 3)) @ rotate((0.3, 1, 0.2), 50)
    placed, plain = camera(fov=40, to_world=torch.as_tensor(pose)), camera(fov=40)
    placed.to_world.data.copy_(torch.as_tensor(pose @ scale((factor, factor, factor))))
    rotation = torch.as_tensor(rotate((0.3, 1, 0.2), 50)[:3, :3])
    for column, row in ((0, 0), (20, 7)):
        o, d = ray(placed, column, row)
        torch.testing.assert_close(d, rotation @ ray(plain, column, row)[1], rtol=0, atol=1e-6)
        torch.testing.assert_close(o, torch.tensor([1.0, 2, 3], dtype=torch.float64) + rotation @ ray(plain, column, row)[0],
                                   rtol=0, atol=1e-6)


def poster(distance, **clip):
    """Mean radiance of a poster that fills the view, before a sky of zero light."""
    scene = load(sensor=sensor(4, (0, 0, distance), (0, 0, 0), 40, **clip), poster=rectangle((0, 0, 0), 10.0, emitter=GLOW))
    return float(rb.render(scene, spp=4, max_depth=1).mean())


def test_what_is_before_the_near_plane_is_not_seen():
    assert poster(2.0, near_clip=1.9) == 1
    assert poster(2.0, near_clip=2.1) == 0


def test_what_is_behind_the_far_plane_is_not_seen():
    assert poster(2.0, far_clip=2.1) == 1
    assert poster(2.0, far_clip=1.9) == 0


@pytest.mark.parametrize("adjoint", [rb.MemoizedAdjoint(2, keep_hits=False), rb.QuadraticAdjoint(keep_hits=False)], ids=repr)
def test_the_backward_pass_sees_as_far_as_the_forward_pass(adjoint, compiled):
    def view(adjoint):
        near, far = sensor(6, far_clip=3.4), sensor(6)  # the first does not see the back of the room
        return image_and_gradients(cornell(sensors={"near": near, "far": far}), CASES["cornell"].parameters, spp=4,
                                   max_depth=3, adjoint=adjoint, compile=compiled)

    reference, expected = view(rb.TapeAdjoint())
    assert_informative(reference, expected)
    assert (reference[0] == 0).sum() > 3 * (reference[1] == 0).sum()
    image, gradients = view(adjoint)
    assert relative_error(image, reference) < 1e-10 if compiled else torch.equal(image, reference)
    assert all(relative_error(gradient, wanted) < 1e-10 for gradient, wanted in zip(gradients, expected))


BAD = {
    "unknown axis": ({"fov": 40, "fov_axis": "z"}, "fov_axis 'z' is not known"),
    "both": ({"fov": 40, "focal_length": "50mm"}, "either fov or focal_length, not both"),
    "flat": ({"fov": 180}, "fov must be between 0 and 180 degrees, got 180"),
    "none": ({"fov": 0}, "fov must be between 0 and 180 degrees, got 0"),
    "planes": ({"near_clip": 2.0, "far_clip": 1.0}, "near_clip must be positive and less than far_clip"),
    "behind": ({"near_clip": -1.0}, "near_clip must be positive"),
    "length": ({"focal_length": "long"}, "focal_length must read like '50mm', got 'long'"),
    "nothing to see": ({"to_world": torch.zeros(4, 4)}, "to_world must be affine"),
}


@pytest.mark.parametrize("attributes, message", BAD.values(), ids=BAD)
def test_a_camera_that_cannot_be(attributes, message):
    with pytest.raises(ValueError, match=message):
        Perspective(**attributes)


def camera_of_file(fov: str, folder) -> rb.Scene:
    path = folder / "scene.xml"
    path.write_text(f'<scene version="3.0.0"><sensor type="perspective"><float name="fov" value="{fov}"/></sensor>'
                    f'<emitter type="constant"/></scene>')
    return rb.load(path)


RADIANS = {
    "dict": lambda folder: load(sensor=sensor(4, fov=0.7), sky={"type": "constant"}),
    "file": lambda folder: camera_of_file("0.7", folder),
    "Python": lambda folder: Perspective(fov=0.7, fov_axis="smaller"),
    "lens": lambda folder: ThinLens(fov=0.7, aperture_radius=0.1),
    "projector": lambda folder: Projector(fov=0.7),
    "spot": lambda folder: Spot(cutoff_angle=0.7),
}


@pytest.mark.parametrize("make", RADIANS.values(), ids=RADIANS)
def test_an_angle_that_may_be_in_radians_is_named_with_its_unit(make, tmp_path):
    with pytest.warns(rb.SceneWarning, match="(fov|angle) is in degrees, got 0.7, .* were meant, give 40.11") as told:
        make(tmp_path)
    assert ["tests" in Path(each.filename).parts for each in told] == [True]  # the caller's line, not one of the package


def test_no_angle_of_two_degrees_or_of_a_focal_length_is_doubted(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Perspective(fov=2), Spot(cutoff_angle=2.0), Perspective(focal_length="1500mm"), camera_of_file("2.0", tmp_path)
        narrow = rb.camera_from_opencv([[5000, 0, 8], [0, 5000, 8], [0, 0, 1]], torch.eye(3), torch.zeros(3), 16, 16)
        assert float(narrow.as_perspective().x_fov) < 1
