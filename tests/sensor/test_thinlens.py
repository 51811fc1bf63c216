"""The camera with a lens, as Mitsuba 3.9.1 defines it."""

import math
import warnings

import pytest
import torch

import torch_radbp as rb
from tests.scenes import GLOW, load, look_at, rectangle
from torch_radbp.boundary.terms.jump_watch import SilhouetteWarning
from torch_radbp.film.box import Box
from torch_radbp.film.hdrfilm import HDRFilm
from torch_radbp.io.values.transform import rotate, translate
from torch_radbp.io.write import save
from torch_radbp.jit.stages import compiled
from torch_radbp.path.camera_rays import APERTURE_U, APERTURE_V, sample_camera
from torch_radbp.sampling.sampler import CAMERA_COUNTER, bounce_key, film_order, lane_key, sample_key, uniform
from torch_radbp.sensor.perspective import Perspective
from torch_radbp.sensor.thinlens import ThinLens
from torch_radbp.tensors.differentiated import detached
from torch_radbp.tensors.stage import EAGER
from torch_radbp.tensors.vec import Vec2

HALF = torch.tensor([0.5], dtype=torch.float64)


def camera(width=12, height=9, **attributes) -> ThinLens:
    """A camera in float64 with a box filter, so that u = v = 0.5 is the centre of the pixel."""
    film = HDRFilm(width=width, height=height, rfilter=Box())
    return ThinLens(film=film, **{"aperture_radius": 0.2, "fov": 50} | attributes).double()


def ray(sensor, column: int, row: int, aperture: tuple[float, float]) -> tuple[torch.Tensor, torch.Tensor]:
    """(origin, direction) of the ray from a place on the lens to the centre of a pixel, (3,) each."""
    column, row = torch.tensor([[column], [row]], dtype=torch.int32)
    place = None if isinstance(sensor, Perspective) else Vec2(*(torch.full_like(HALF, number) for number in aperture))
    found, _ = sensor.tensors().sample_ray(column, row, Vec2(HALF, HALF), place)
    return found.o.stack()[0].detach(), found.d.stack()[0].detach()


PLACES = ((0.5, 0.5), (0.0, 0.0), (0.9, 0.2), (0.3, 0.95), (0.1, 0.6))


@pytest.mark.parametrize("seed", range(3))
def test_rays_are_those_of_mitsuba(seed):
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    matrix = translate((1, -2, 3)) @ rotate((0.3, 1, 0.2 * seed), 50)
    attributes = {"aperture_radius": 0.3, "focus_distance": 1.7 + seed, "fov": 50.0, "fov_axis": "smaller", "near_clip": 0.3}
    film = {"type": "hdrfilm", "width": 12, "height": 7 + 4 * seed, "rfilter": {"type": "box"}}
    theirs = mi.load_dict({"type": "thinlens", "to_world": mi.ScalarTransform4f(matrix), "film": film, **attributes})
    ours = camera(12, 7 + 4 * seed, to_world=torch.as_tensor(matrix), **attributes)
    for place in PLACES:
        for column, row in ((0, 0), (11, 6), (2, 3)):
            sample = mi.Point2f((column + 0.5) / 12, (row + 0.5) / (7 + 4 * seed))
            expected, _ = theirs.sample_ray(0, 0.5, sample, mi.Point2f(*place))
            o, d = ray(ours, column, row, place)
            torch.testing.assert_close(o, torch.tensor(list(expected.o), dtype=torch.float64), rtol=0, atol=1e-5)
            torch.testing.assert_close(d, torch.tensor(list(expected.d), dtype=torch.float64), rtol=0, atol=1e-5)


def test_rays_of_a_pixel_meet_in_the_plane_in_focus_on_the_ray_of_a_pinhole():
    pose = torch.as_tensor(translate((1, 2, 3)) @ rotate((0.3, 1, 0.2), 50))
    lens = camera(to_world=pose, focus_distance=2.5)
    pinhole = Perspective(film=lens.film, fov=50, to_world=pose).double()
    forward = lens.to_world[:3, 2].detach()
    origin = lens.to_world[:3, 3].detach()
    for column, row in ((0, 0), (11, 2), (4, 8)):
        _, d = ray(pinhole, column, row, (0.5, 0.5))
        meeting = origin + d * 2.5 / (d @ forward)
        for place in PLACES:
            o, d = ray(lens, column, row, place)
            t = (2.5 - (o - origin) @ forward) / (d @ forward)
            torch.testing.assert_close(o + t * d, meeting, rtol=0, atol=1e-6)


def test_rays_start_all_over_the_lens():
    """The radius of a point of a disk has the mean 2/3 and the mean square 1/2."""
    sensor = camera(near_clip=1e-9, aperture_radius=0.4)
    generator = torch.Generator().manual_seed(1)
    u, v = torch.rand(2, 20000, generator=generator, dtype=torch.float64)
    zero = torch.zeros(20000, dtype=torch.int32)
    o = sensor.tensors().sample_ray(zero, zero, Vec2(u, v), Vec2(u, v))[0].o
    radius = torch.hypot(o.x, o.y).detach() / 0.4
    assert radius.max() <= 1 + 1e-6 and float(o.z.abs().max()) < 1e-8
    assert float(radius.mean()) == pytest.approx(2 / 3, abs=0.01)
    assert float((radius**2).mean()) == pytest.approx(1 / 2, abs=0.01)
    assert abs(float(o.x.mean())) < 0.005 and abs(float(o.y.mean())) < 0.005


def test_compiled_rays_are_the_eager_ones():
    sample = torch.arange(64, dtype=torch.int32)
    arguments = (detached(camera().tensors()), film_order(12, 64, sample.device), torch.full_like(sample, 40), sample,
                 sample_key(3, 0, True, sample.device), False)
    (expected, *_), (found, *_) = (stages(sample_camera)(*arguments) for stages in (EAGER, compiled()))
    for part, wanted in zip((*found.o, *found.d), (*expected.o, *expected.d)):
        assert (part - wanted).abs().max() < 1e-14
    assert expected.o.x.std() > 0.01


@pytest.mark.parametrize("dimension", [APERTURE_U, APERTURE_V])
def test_places_on_the_lens_are_spread_evenly(dimension):
    """Of 64 samples of a pixel every one of 64 bands across the square of the lens has one."""
    sample = torch.arange(64, dtype=torch.int32)
    lanes = lane_key(sample_key(3, 0, True, sample.device), torch.full_like(sample, 40), sample)
    numbers = uniform(bounce_key(lanes, CAMERA_COUNTER), dimension, torch.float64)
    assert ((numbers * 64 - (numbers * 64).min()).round().sort().values == sample).all()


def spot(z: float, **attributes) -> torch.Tensor:
    """The image, (H, W), of a small lamp at z by a camera at 4 that is in focus at z = 0."""
    sensor = {"type": "thinlens", "to_world": look_at((0, 0, 4), (0, 0, 0), (0, 1, 0)), "fov": 40, "focus_distance": 4,
              "aperture_radius": 0.3, "film": {"type": "hdrfilm", "width": 21, "height": 21, "rfilter": {"type": "box"}}}
    lamp = rectangle((0, 0, z), 0.15, emitter=GLOW)
    given = {name: value for name, value in (sensor | attributes).items() if value is not None}
    return rb.render(load(sensor=given, lamp=lamp), spp=256, max_depth=1)[0, 0]


def test_what_is_not_in_focus_is_blurred_by_the_circle_of_confusion():
    sharp, blurred = spot(0.0), spot(1.5)
    pixel = 2 * 4 * math.tan(math.radians(20)) / 21  # in the plane in focus
    assert float(sharp.sum()) == pytest.approx((0.3 / pixel) ** 2, rel=0.02)
    # Each point is seen from a disk: in focus, of radius 0.3 * 1.5 / 2.5; its mean square is half the squared radius.
    x = (torch.arange(21.0, dtype=torch.float64) - 10) * pixel
    spread = float((blurred.sum(0) * x**2).sum() / blurred.sum())
    lamp = (0.15 * 4 / 2.5) ** 2 / 3 + pixel**2 / 12
    assert spread == pytest.approx(lamp + (0.3 * 1.5 / 2.5) ** 2 / 4, rel=0.02)


def test_a_tiny_aperture_is_a_pinhole():
    image = spot(1.5, aperture_radius=1e-7)
    expected = spot(1.5, type="perspective", aperture_radius=None, focus_distance=None)
    assert expected.max() == 1 and (image - expected).abs().max() < 1e-12


def test_silhouettes_beside_the_view_of_the_middle_of_the_lens_count_if_the_border_sees_them():
    def warned(aperture: float) -> bool:
        sensor = {"type": "thinlens", "to_world": look_at((0, 0, 4), (0, 0, 0), (0, 1, 0)), "fov": 40, "focus_distance": 4,
                  "aperture_radius": aperture, "film": {"type": "hdrfilm", "width": 4, "height": 4}}
        beside = rectangle((3.0, 0, -3.0), 0.25)
        scene = load(sensor=sensor, sky={"type": "constant"}, shape=beside)
        scene.get_parameter("shape.to_world").requires_grad_()
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            rb.render(scene, spp=1, max_depth=1, terms=["interior"])
        return any(issubclass(warning.category, SilhouetteWarning) for warning in caught)

    assert warned(0.5) and not warned(0.01)


def test_saved_and_loaded_it_is_the_same(tmp_path):
    scene = load(torch.float32, sensor={"type": "thinlens", "aperture_radius": 0.3, "focus_distance": 2.5, "fov": 33.0,
                                        "near_clip": 0.5, "film": {"type": "hdrfilm", "width": 4, "height": 4}},
                 wall=rectangle((0, 0, 2), 2.0, (0, 1, 0), 180, emitter=GLOW))
    save(scene, tmp_path / "scene.xml")
    loaded = rb.load(tmp_path / "scene.xml")
    for name in ("aperture_radius", "focus_distance", "to_world"):
        assert torch.equal(loaded.get_parameter(f"sensor.{name}"), scene.get_parameter(f"sensor.{name}"))
    torch.testing.assert_close(loaded.sensors[0].x_fov, scene.sensors[0].x_fov, rtol=1e-6, atol=0)
    assert loaded.sensors[0].near_clip == 0.5
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    theirs = mi.traverse(mi.load_file(str(tmp_path / "scene.xml")))
    assert float(theirs["sensor.aperture_radius"]) == pytest.approx(0.3)


def test_by_default_the_far_plane_is_in_focus():
    assert float(camera(far_clip=77.0).focus_distance) == 77


BAD = {
    "no aperture": ({"aperture_radius": 0.0}, "aperture_radius must be greater than 0"),
    "in focus at the lens": ({"focus_distance": 0.0}, "focus_distance must be greater than 0"),
    "planes": ({"near_clip": 2.0, "far_clip": 1.0}, "less than far_clip"),
    "view": ({"fov": 200}, "fov must be between 0 and 180"),
}


@pytest.mark.parametrize("attributes, message", BAD.values(), ids=BAD)
def test_a_camera_that_cannot_be(attributes, message):
    with pytest.raises(ValueError, match=message):
        camera(**attributes)


def test_it_needs_an_aperture_and_has_no_principal_point():
    with pytest.raises(rb.SceneError, match="needs 'aperture_radius'"):
        load(sensor={"type": "thinlens"}, lamp=rectangle((0, 0, 0), emitter=GLOW))
    with pytest.raises(rb.SceneError, match="no attribute 'principal_point_offset_x'"):
        load(sensor={"type": "thinlens", "aperture_radius": 0.1, "principal_point_offset_x": 0.1},
             lamp=rectangle((0, 0, 0), emitter=GLOW))


def test_the_unit_pose_is_mitsubas():
    """Without a pose it looks along +z."""
    o, d = ray(camera(11, 9), 5, 4, (0.5, 0.5))
    torch.testing.assert_close(d, torch.tensor([0, 0, 1.0], dtype=torch.float64), rtol=0, atol=1e-12)
    torch.testing.assert_close(o, torch.tensor([0, 0, 0.01], dtype=torch.float64), rtol=0, atol=1e-9)
