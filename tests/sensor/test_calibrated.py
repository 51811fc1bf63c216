"""A camera with OpenCV's intrinsics and distortion."""

import math
import warnings

import pytest
import torch

import torch_radbp as rb
from tests.scenes import GLOW, load, look_at, rectangle, texels
from tests.scenes.parts import FIELD_OF_VIEW, FISHEYE, THIN_PRISM, calibrated
from torch_radbp.boundary.terms.jump_watch import SilhouetteWarning
from torch_radbp.film.box import Box
from torch_radbp.film.hdrfilm import HDRFilm
from torch_radbp.film.tent import Tent
from torch_radbp.io.values.transform import rotate, scale, translate
from torch_radbp.io.write import save
from torch_radbp.jit.stages import compiled
from torch_radbp.path.camera_rays import sample_camera
from torch_radbp.sampling.sampler import film_order, sample_key
from torch_radbp.sensor.calibrated import LENSES, Calibrated
from torch_radbp.sensor.perspective import Perspective
from torch_radbp.tensors.differentiated import detached
from torch_radbp.tensors.stage import EAGER
from torch_radbp.tensors.vec import Vec2, Vec3

HALF = torch.tensor([0.5], dtype=torch.float64)
BROWN = {"k1": -0.2, "k2": 0.05, "k3": 0.01, "p1": 0.01, "p2": -0.02}


def camera(width=24, height=16, **attributes) -> Calibrated:
    """A camera in float64 with a box filter, so that u = v = 0.5 is the centre of the pixel."""
    return Calibrated(film=HDRFilm(width=width, height=height, rfilter=Box()), **attributes).double()


def direction(sensor, column: int, row: int) -> torch.Tensor:
    """(3,) the direction that the centre of a pixel sees."""
    column, row = torch.tensor([[column], [row]], dtype=torch.int32)
    ray, _ = sensor.tensors().sample_ray(column, row, Vec2(HALF, HALF))
    return ray.d.stack()[0].detach()


PIXELS = ((0, 0), (23, 15), (20, 3), (7, 11))


def test_without_distortion_it_is_the_perspective_camera():
    pose = torch.as_tensor(translate((1, 2, 3)) @ rotate((0.3, 1, 0.2), 50))
    focal = 12 / math.tan(math.radians(25))
    ours = camera(fx=focal, to_world=pose, cx=11.5 - 0.1 * 24, cy=7.5 + 0.05 * 16, near_clip=0.3)
    theirs = Perspective(film=ours.film, fov=50, to_world=pose, principal_point_offset_x=0.1,
                         principal_point_offset_y=-0.05, near_clip=0.3).double()
    for column, row in PIXELS:
        torch.testing.assert_close(direction(ours, column, row), direction(theirs, column, row), rtol=0, atol=1e-6)


@pytest.mark.parametrize("attributes", [{}, BROWN, {"distortion": "fisheye", "k1": 0.05, "k2": -0.02},
                                        {"distortion": "thin_prism_fisheye", "k1": 0.05, "p2": 0.01, "sx1": -0.02},
                                        {"distortion": "field_of_view", "omega": 0.9}],
                         ids=["none", "brown_conrady", "fisheye", "thin prism", "field of view"])
def test_a_point_is_projected_to_the_pixel_that_sees_it(attributes):
    """OpenCV: fx x' + skew y' + cx is 0 at the centre of the first pixel."""
    sensor = camera(fx=14.0, fy=15.0, cx=10.0, cy=8.5, skew=0.4, **attributes)
    model = sensor.lens().distortion
    for column, row in PIXELS:
        left, up, ahead = direction(sensor, column, row)
        point = model.distorted(Vec3(-left[None], -up[None], ahead[None]))
        assert float(14.0 * point.x + 0.4 * point.y + 10.0) == pytest.approx(column, abs=1e-5)
        assert float(15.0 * point.y + 8.5) == pytest.approx(row, abs=1e-5)


def test_the_principal_point_is_the_middle_of_the_image_and_pixels_are_square():
    sensor = camera(fx=20.0)
    assert (float(sensor.cx), float(sensor.cy), float(sensor.fy)) == (11.5, 7.5, 20.0)
    assert {name for name, _ in sensor.named_parameters()} == {"to_world", "fx", "fy", "cx", "cy", "skew"}


def test_coefficients_that_are_given_are_parameters():
    sensor = camera(fx=20.0, k1=0.0, p2=0.1)
    assert {"k1", "p2"} < {name for name, _ in sensor.named_parameters()} and sensor.k2 is None


@pytest.mark.parametrize("coefficients", [{}, FISHEYE, THIN_PRISM, FIELD_OF_VIEW],
                         ids=["brown_conrady", "fisheye", "thin prism", "field of view"])
def test_compiled_rays_are_the_eager_ones(coefficients):
    sensor = load(sensor=calibrated(16, 0.7, **coefficients), lamp=rectangle((0, 0, 0), emitter=GLOW)).sensors[0]
    numbers = torch.arange(256, dtype=torch.int32)
    arguments = (detached(sensor.tensors()), film_order(16, 7, numbers.device), numbers, numbers % 7,
                 sample_key(3, 0, True, numbers.device), True)
    (expected, _, weight, cone, *_), (found, _, counts, fused, *_) = (
        stages(sample_camera)(*arguments) for stages in (EAGER, compiled()))
    assert torch.equal(weight, counts) and weight.min() == weight.max() == 1
    for part, wanted in zip((*found.o, *found.d, *fused), (*expected.o, *expected.d, *cone)):
        assert (part - wanted).abs().max() < 1e-13
    assert expected.d.x.std() > 0.1 and cone.spread.min() > 0


def spots(places, sensor) -> torch.Tensor:
    """(K, 2) the columns and rows, fractional, at which small lamps appear."""
    rows, columns = (torch.arange(size, dtype=torch.float64) for size in (sensor.film.height, sensor.film.width))
    found = []
    for place in places:
        lamp = rectangle(place, 0.03, (0, 1, 0), 180, emitter=GLOW)
        image = rb.render(load(sensor=sensor, lamp=lamp), spp=256, max_depth=1)[0, 0]
        found.append(torch.stack([(image.sum(0) * columns).sum(), (image.sum(1) * rows).sum()]) / image.sum())
    return torch.stack(found)


def test_an_image_shows_things_where_opencv_puts_them():
    """In a camera at the origin that looks along +z, with x to the left; u and v by OpenCV's formulas, in plain numbers.
    The tent filter keeps centroids."""
    sensor = Calibrated(film=HDRFilm(width=40, height=30, rfilter=Tent()), fx=30.0, fy=28.0, cx=18.0, cy=14.0, **BROWN)
    places = [(0.0, 0.0, 2.0), (0.8, 0.5, 2.0), (-0.9, -0.6, 2.0)]
    for place, (u, v) in zip(places, spots(places, sensor)):
        x, y = -place[0] / 2, -place[1] / 2
        s = x * x + y * y
        radial = 1 - 0.2 * s + 0.05 * s**2 + 0.01 * s**3
        wanted_x = x * radial + 2 * 0.01 * x * y - 0.02 * (s + 2 * x * x)
        wanted_y = y * radial + 0.01 * (s + 2 * y * y) - 2 * 0.02 * x * y
        assert float(u) == pytest.approx(30 * wanted_x + 18, abs=0.05)
        assert float(v) == pytest.approx(28 * wanted_y + 14, abs=0.05)


def test_what_no_direction_is_projected_to_is_black():
    """An equidistant fisheye with a focal length of 2 pixels has an image circle of radius 2 pi pixels."""
    sensor = Calibrated(film=HDRFilm(width=21, height=21, rfilter=Box()), fx=2.0, distortion="fisheye")
    scene = load(sensor=sensor, sky={"type": "constant", "radiance": 1.0}, lamp=rectangle((0, 0, 1), 0.1))
    image = rb.render(scene, spp=16, max_depth=1)[0, 0]
    row, column = torch.meshgrid(torch.arange(21.0) - 10, torch.arange(21.0) - 10, indexing="ij")
    radius = torch.hypot(row, column)
    assert (image[radius > 2 * math.pi + 0.8] == 0).all()
    assert (image[(radius < 2 * math.pi - 0.8) & (radius > 3)] == 1).all()
    assert float(image.sum()) == pytest.approx(math.pi * (2 * math.pi) ** 2, rel=0.05)


LENSES_BESIDE = {"pinhole": {"fx": 4.0}, "folded": {"fx": 2.0, "k1": -0.05}, "plain": {"fx": 4.0, "k1": 0.01},
                 "field of view": {"fx": 2.0, "distortion": "field_of_view", "omega": 0.9},
                 "fisheye": {"fx": 0.9, "distortion": "fisheye"},
                 "thin prism": {"fx": 0.9, "distortion": "thin_prism_fisheye", "sx1": 0.01}}


@pytest.mark.parametrize("order", [tuple(LENSES_BESIDE), tuple(reversed(LENSES_BESIDE))], ids=["pinhole first", "last"])
def test_small_images_of_several_lenses_are_each_as_alone(order):
    """They are traced together, those with pixels that see nothing and those without."""
    sensors = {name: {"type": "calibrated", "film": {"type": "hdrfilm", "width": 8, "height": 8}} | LENSES_BESIDE[name]
               for name in order}
    scene = load(**sensors, sky={"type": "constant", "radiance": 1.0}, lamp=rectangle((0, 0, 9), 0.1))
    together = rb.render(scene, spp=4, max_depth=2, sensors=list(range(len(order))))
    for number, name in enumerate(order):
        alone = rb.render(scene, spp=4, max_depth=2, sensors=[number])[0]
        torch.testing.assert_close(together[number], alone, rtol=0, atol=1e-12)
        assert (alone.min() < 0.2) == (name not in ("pinhole", "plain")), name  # corners beyond the lens


def test_gradients_of_a_scene_ignore_what_is_not_seen():
    sensor = Calibrated(film=HDRFilm(width=11, height=11, rfilter=Box()), fx=1.0, distortion="fisheye", k1=0.0)
    scene = load(sensor=sensor, sky={"type": "envmap", "bitmap": texels(4, 8)}, lamp=rectangle((0, 0, -9), 0.1))
    names = ("sky.data", "sensor.k1")
    for adjoint in (rb.MemoizedAdjoint(), rb.ReplayAdjoint(), rb.TapeAdjoint()):
        wanted = [scene.get_parameter(name).requires_grad_() for name in names]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SilhouetteWarning)
            image = rb.render(scene, spp=8, max_depth=1, adjoint=adjoint, share_samples=True)
        assert (image == 0).any() and (image > 0).any()
        of_sky, of_k1 = torch.autograd.grad(image.sum(), wanted)
        torch.testing.assert_close((of_sky * wanted[0]).sum().detach(), image.sum().detach(), rtol=1e-10, atol=0)
        assert torch.isfinite(of_k1) and of_k1 != 0


@pytest.mark.parametrize("attributes", [{"near_clip": 1.9}, {"near_clip": 1.9, "distortion": "fisheye"}])
def test_near_and_far_planes(attributes):
    def seen(**more) -> float:
        sensor = {"type": "calibrated", "to_world": look_at((0, 0, 2), (0, 0, 0), (0, 1, 0)), "fx": 40.0,
                  "film": {"type": "hdrfilm", "width": 4, "height": 4}}
        scene = load(sensor=sensor | attributes | more, poster=rectangle((0, 0, 0), 10.0, emitter=GLOW))
        return float(rb.render(scene, spp=4, max_depth=1).mean())

    assert seen() == 1 and seen(far_clip=2.1) == 1
    assert seen(near_clip=2.1) == 0 and seen(far_clip=1.99) == 0


def warned(place, **attributes) -> bool:
    """Whether the outline of a small square at a place counts as seen by a camera at the origin that looks along +z."""
    sensor = {"type": "calibrated", "fx": 16.0, "film": {"type": "hdrfilm", "width": 16, "height": 16}}
    shape = {"type": "rectangle", "to_world": translate(place) @ scale((0.05, 0.05, 0.05))}
    scene = load(sensor=sensor | attributes, sky={"type": "constant"}, shape=shape)
    scene.get_parameter("shape.to_world").requires_grad_()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        rb.render(scene, spp=1, max_depth=1, terms=["interior"])
    return any(issubclass(warning.category, SilhouetteWarning) for warning in caught)


def test_silhouettes_are_looked_for_where_the_distorted_image_is():
    """Half the image is 0.5 at a focal length of 1; barrel distortion of -0.2 brings 0.58 to 0.54, and -0.5 to 0.48."""
    assert warned((0.4, 0, 1)) and not warned((0.58, 0, 1)) and not warned((0.58, 0, 1), k1=-0.2)
    assert warned((0.58, 0, 1), k1=-0.5)
    assert not warned((0.45, 0, 1), k1=2.0)
    assert warned((0.45, 0, 1), k1=0.1)


def test_silhouettes_behind_a_fisheye_count_if_it_sees_them():
    """0.5 / 0.2 = 2.5 radians reach 143 degrees off the axis."""
    fisheye = {"distortion": "fisheye", "fx": 3.2}
    assert warned((1.0, 0, -0.9), **fisheye) and warned((0, -1, 0.1), **fisheye)
    assert not warned((0.3, 0, -1), **fisheye) and not warned((1.0, 0, -0.9), distortion="fisheye", fx=8.0)


@pytest.mark.parametrize("coefficients", [{}, FISHEYE, THIN_PRISM, FIELD_OF_VIEW],
                         ids=["brown_conrady", "fisheye", "thin prism", "field of view"])
def test_saved_and_loaded_it_is_the_same(tmp_path, coefficients):
    scene = load(torch.float32, sensor=calibrated(4, **coefficients), lamp=rectangle((0, 0, 0), emitter=GLOW))
    save(scene, tmp_path / "scene.xml")
    loaded = rb.load(tmp_path / "scene.xml")
    ours, theirs = (dict(which.sensors[0].named_parameters()) for which in (scene, loaded))
    of_lens = sum(coefficients.get(name, 0) is not None for name in LENSES[scene.sensors[0].distortion]._fields)
    assert set(ours) == set(theirs) and len(ours) == 6 + of_lens  # to_world, fx, fy, cx, cy, skew
    assert all(torch.equal(ours[name], theirs[name]) for name in ours)
    assert loaded.sensors[0].distortion == scene.sensors[0].distortion


BAD = {
    "focal length": ({"fx": 0.0}, "fx must be greater than 0"),
    "model": ({"fx": 9.0, "distortion": "brown"}, "distortion 'brown' is not known; did you mean 'brown_conrady'"),
    "coefficient": ({"fx": 9.0, "distortion": "fisheye", "p1": 0.1}, "fisheye lens has no coefficient p1; it has k1, k2"),
    "no omega": ({"fx": 9.0, "distortion": "field_of_view"}, "needs omega, radians between 0 and pi"),
    "omega": ({"fx": 9.0, "distortion": "field_of_view", "omega": 3.2}, "omega must be between 0 and 3.14159 radians"),
    "stray omega": ({"fx": 9.0, "omega": 0.5}, "a brown_conrady lens has no coefficient omega; it has k1, k2"),
    "planes": ({"fx": 9.0, "near_clip": 2.0, "far_clip": 1.0}, "less than far_clip"),
}


@pytest.mark.parametrize("attributes, message", BAD.values(), ids=BAD)
def test_a_camera_that_cannot_be(attributes, message):
    with pytest.raises(ValueError, match=message):
        camera(**attributes)
