"""Daylight: Mitsuba's values, the sun's place, and what is refused."""

import warnings

import numpy as np
import pytest
import torch

import torch_radbp as rb
from tests.emitter.lanes import detached
from tests.scenes import load, rectangle, rgb, sensor
from tests.scenes.lights import scene_of
from torch_radbp.emitter.sun_position import PlaceAndTime, sun_position
from torch_radbp.emitter.sunsky import Sunsky
from torch_radbp.io.values.transform import rotate, scale
from torch_radbp.tensors.vec import Vec3, normalize

# Radiance by Mitsuba 3.9.1, `scalar_rgb`: turbidity, albedo, direction to the sun, of the view, and the colour.
KNOWN = [
    (3.0, 0.3, (0.3, 0.2, 0.8), (0.3, 0.2, 0.8), (21987.303, 18490.518, 14381.746)),
    (3.0, 0.3, (0.3, 0.2, 0.8), (0.1, -0.9, 0.2), (0.07954299, 0.1303932, 0.2138307)),
    (1.0, 0.0, (0.0, 0.1, 1.0), (0.0, 0.2, 1.0), (0.02531729, 0.05356039, 0.09199489)),
    (2.5, 0.8, (0.9, 0.1, 0.05), (-0.4, 0.5, 0.02), (0.06718272, 0.05198372, 0.02297421)),
    (6.7, 0.5, (-0.5, 0.6, 0.3), (-0.5, 0.6, 0.31), (0.9909946, 0.8622627, 0.5593559)),
    (10.0, 1.0, (0.2, 0.9, 0.4), (0.9, -0.3, 0.6), (0.06843981, 0.07828707, 0.09641118)),
    (4.4, 0.2, (0.6, 0.6, 0.2), (0.6, 0.6, 0.2), (14017.24, 9185.552, 4149.114)),
    (4.4, 0.2, (0.6, 0.6, 0.2), (0.6, 0.6, -0.2), (0, 0, 0)),
]


def radiance(emitter: Sunsky, directions) -> torch.Tensor:
    emitter = emitter.double()
    table = emitter.kind().table([emitter], torch.zeros(1, dtype=torch.float64))
    return emitter.kind().radiance(table, normalize(Vec3.of(torch.as_tensor(directions, dtype=torch.float64)))).stack()


@pytest.mark.parametrize("turbidity, albedo, sun, view, expected", KNOWN)
def test_radiance_is_mitsubas(turbidity, albedo, sun, view, expected):
    found = radiance(Sunsky(turbidity=turbidity, albedo=albedo, sun_direction=torch.tensor(sun)), [view])[0]
    torch.testing.assert_close(found, torch.tensor(expected, dtype=torch.float64), rtol=1e-5, atol=0)


def test_the_sun_stands_in_the_south_at_noon_and_rises_in_the_east():
    """Greenwich at the equinox, universal time; +x is south and +y west."""
    day = PlaceAndTime(latitude=51.48, longitude=0.0, timezone=0.0, year=2010, month=3, day=20)
    noon = sun_position(day._replace(hour=12.0, minute=7.0))  # by the equation of time
    torch.testing.assert_close(noon[2], torch.tensor(np.cos(np.radians(51.48))), rtol=0, atol=3e-3)
    assert abs(noon[1]) < 5e-3 and noon[0] > 0
    morning = sun_position(day._replace(hour=6.0, minute=7.0))
    assert abs(morning[2]) < 1e-2 and morning[1] < -0.99


def test_a_pose_turns_all_and_a_wider_disc_sends_the_same():
    turn = torch.as_tensor(rotate((1, 0.2, 0.3), 70) @ scale((2, 2, 2)))
    still, turned = Sunsky(), Sunsky(to_world=turn)
    views = torch.randn(50, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    rotation = turned.rotation()
    torch.testing.assert_close(radiance(turned, views @ rotation.T), radiance(still, views), rtol=1e-6, atol=1e-9)
    suns = [radiance(Sunsky(sky_scale=0.0, sun_aperture=angle), [Sunsky().sun_direction.tolist()])[0] * np.sin(
        np.radians(angle / 4)) ** 2 for angle in (0.5358, 5.0, 40.0)]
    torch.testing.assert_close(suns[1], suns[0], rtol=1e-6, atol=0)
    torch.testing.assert_close(suns[2], suns[0], rtol=1e-6, atol=0)


def test_the_density_of_directions_integrates_to_one():
    tensors = detached(scene_of("sunsky"))
    number, kind = tensors.layout.surround
    views = normalize(Vec3.of(torch.randn(400_000, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1))))
    total = 4 * np.pi * kind.weighing(tensors.lights.tables[number], views)
    assert abs(total.mean() - 1) < 4 * total.std() / len(total) ** 0.5 + 0.01  # it is a continuous stand-in


def test_a_sun_below_the_horizon_sends_nothing():
    for sun in ((1.0, 0.0, -0.1), (0.0, 0.0, -1.0)):
        assert not radiance(Sunsky(sun_direction=torch.tensor(sun)), [(0, 0, 1), sun, (1, 0, 0.1)]).any()
    scene = load(sensor=sensor(4), floor=rectangle((0, 0, 0)), sky={"type": "sunsky", "sun_direction": [0, 0.1, -1]})
    assert not rb.render(scene, spp=2, max_depth=3).any()


def test_its_parameters_are_those_that_have_derivatives():
    scene = load(torch.float32, sensor=sensor(4), floor=rectangle((0, 0, 0)), sky={
        "type": "sunsky", "albedo": rgb(0.1, 0.2, 0.3)})
    assert {name for name, _ in scene.named_parameters() if name.startswith("sky")} == {
        "sky.turbidity", "sky.sun_scale", "sky.sky_scale", "sky.albedo.value"}


BAD = {
    "turbidity": ({"turbidity": 0.5}, r"turbidity must be in \[1, 10\], got 0.5"),
    "albedo": ({"albedo": 1.5}, r"albedo.* must be in \[0, 1\], got 1.5"),
    "scale": ({"sun_scale": -1.0}, "scale must be at least 0 and finite, got -1"),
    "both": ({"sun_direction": [0, 0, 1], "hour": 3.0}, "either sun_direction or a place and time, got hour as well"),
    "zero": ({"sun_direction": [0, 0, 0]}, "sun_direction must not be zero"),
    "aperture": ({"sun_aperture": 0.0}, "sun_aperture must be between 0 and 180 degrees, got 0.0"),
    "limb": ({"complex_sun": True}, "complex_sun is not supported"),
    "shear": ({"to_world": np.diag([1.0, 2, 1, 1])}, "to_world of a sunsky must be a rotation"),
    "month": ({"month": 13}, "month must be from 1 to 12, got 13"),
    "day": ({"month": 2, "day": 30}, "day must be from 1 to 28 in month 2, got 30"),
    "latitude": ({"latitude": 500.0}, "latitude must be from -90 to 90, got 500"),
    "hour": ({"hour": 25.0}, "hour must be from 0 to 24, got 25"),
    "unknown": ({"ground_albedo": 0.3}, "no attribute 'ground_albedo'; .*known: albedo, complex_sun, day"),
}


@pytest.mark.hostile
@pytest.mark.parametrize("case", BAD)
def test_what_cannot_be_is_refused(case):
    attributes, message = BAD[case]
    with pytest.raises(ValueError, match=message):
        load(sensor=sensor(4), sky={"type": "sunsky"} | attributes)


def test_a_sun_below_the_horizon_is_told():
    with pytest.warns(rb.SceneWarning, match="below the horizon"):
        load(sensor=sensor(4), sky={"type": "sunsky", "sun_direction": [0.0, 1.0, -0.2]})
    with pytest.warns(rb.SceneWarning, match="below the horizon"):
        load(sensor=sensor(4), sky={"type": "sunsky", "hour": 2.0})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load(sensor=sensor(4), sky={"type": "sunsky", "sun_direction": [0.0, 1.0, 0.2]})
