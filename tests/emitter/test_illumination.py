"""Lights without extent against their formulas; `tests/peer` compares their images with Mitsuba's."""

import math

import numpy as np
import pytest
import torch

from tests.emitter.lanes import at, detached, light_numbers
from tests.scenes import load, look_at, rgb, sensor
from tests.scenes.lights import FLOOR, scene_of, slide
from torch_radbp.connection.light import LightSample, sample_light
from torch_radbp.emitter.directional import facing
from torch_radbp.emitter.spot import SpotKind
from torch_radbp.scene.tables.scene_tensors import SceneTensors

ORIGIN = (0.3, 1.0, -0.2)
POSE = look_at(ORIGIN, (0.5, -0.4, 0.3), (0.2, 1, 0))


def lit(points, **emitter) -> LightSample:
    scene = detached(load(sensor=sensor(2), **FLOOR, lamp=emitter))
    return sample(scene, points)


def sample(scene: SceneTensors, points) -> LightSample:
    return sample_light(scene, scene, at(points), light_numbers(len(points), 1))


def in_front(local, pose=POSE) -> np.ndarray:
    """World coordinates of points given in a light's own."""
    return np.asarray(local, dtype=float) @ pose[:3, :3].T + pose[:3, 3]


def cone(degrees, distance=2.0) -> np.ndarray:
    """Local points at angles from the axis, all around."""
    angle, around = np.radians(degrees), np.arange(len(degrees))
    return distance * np.stack([np.sin(angle) * np.cos(around), np.sin(angle) * np.sin(around), np.cos(angle)], 1)


def test_a_spot_falls_off_linearly_with_the_angle():
    angles = np.array([0, 5, 9.99, 12, 20, 29.9, 30.1, 60, 120, 180])
    light = lit(in_front(cone(angles)), type="spot", to_world=POSE, intensity=rgb(8, 4, 2), cutoff_angle=30.0,
                beam_width=10.0)
    expected = np.clip((30 - angles) / 20, 0, 1)[:, None] * np.array([8, 4, 2]) / 4
    torch.testing.assert_close(light.radiance.stack(), torch.from_numpy(expected), rtol=0, atol=1e-5)
    assert light.findable.sum() == 0 and (light.pdf == 1).all() and light.distant is None


def test_a_wide_spot_reaches_behind_itself():
    angles = np.array([60.0, 90, 110, 140, 175])
    light = lit(in_front(cone(angles)), type="spot", to_world=POSE, cutoff_angle=150.0)
    expected = np.clip((150 - angles) / 37.5, 0, 1) / 4
    torch.testing.assert_close(light.radiance.x, torch.from_numpy(expected), rtol=0, atol=1e-5)


def test_the_image_of_a_spot_fills_the_square_around_its_cone():
    local = np.array([[0.1, 0.2, 1.0], [-0.3, 0.05, 1.0], [0.2, -0.4, 1.0]])
    image = torch.as_tensor(slide(8, 8)["data"])
    light = lit(in_front(local), type="spot", to_world=POSE, cutoff_angle=45.0, beam_width=44.0,
                texture=slide(8, 8) | {"filter_type": "nearest"})
    texel = ((0.5 + 0.5 * local[:, :2]) * 8).astype(int)
    expected = image[texel[:, 1], texel[:, 0]] / torch.from_numpy((local**2).sum(1))[:, None]
    torch.testing.assert_close(light.radiance.stack(), expected, rtol=1e-5, atol=0)


def test_a_projector_throws_a_flat_image_the_right_way_round():
    """On a screen across its axis at distance 1, irradiance is pi E: radiance / distance^2 times the screen's cosine.

    Seen along the axis, x runs to the left and y up, as in a camera; row 0 is the top of the image.
    """
    across, up = np.meshgrid(np.linspace(-0.47, 0.45, 7), np.linspace(-0.3, 0.3, 5))
    local = np.stack([across.ravel(), up.ravel(), np.ones(35)], 1)
    image = torch.as_tensor(slide(4, 6)["data"])
    light = lit(in_front(local), type="projector", to_world=POSE, scale=2.0, fov=90.0,
                irradiance=slide(4, 6) | {"filter_type": "nearest"})
    screen = torch.from_numpy(1 / np.sqrt((local**2).sum(1)))[:, None]
    column, row = ((0.5 - 0.5 * local[:, 0]) * 6).astype(int), ((0.5 - 0.5 * local[:, 1] * 6 / 4) * 4).astype(int)
    torch.testing.assert_close(light.radiance.stack() * screen, 2 * math.pi * image[row, column], rtol=1e-5, atol=0)


def test_a_projector_lights_its_frustum_only():
    local = [[0, 0, 1.0], [0.55, 0, 1], [0, 0.56, 1], [0.57, 0, 1], [0, -0.58, 1], [0, 0, -1], [0.1, 0.1, 1e-6]]
    half = math.degrees(math.atan(0.565)) * 2
    light = lit(in_front(local), type="projector", to_world=POSE, fov=half)
    assert ((light.radiance.x > 0) == torch.tensor([True, True, True, False, False, False, False])).all()
    assert torch.isfinite(light.radiance.stack()).all()


@pytest.mark.parametrize("axis, height, width, horizontal", [
    ("x", 4, 6, 50.0), ("y", 4, 6, 69.9426), ("diagonal", 4, 6, 42.4117), ("smaller", 4, 6, 69.9426),
    ("larger", 6, 4, 34.538)])
def test_the_field_of_view_is_measured_as_in_mitsuba(axis, height, width, horizontal):
    """Figures printed by Mitsuba 3.9.1 for the same projectors."""
    scene = load(sensor=sensor(2), **FLOOR, lamp={"type": "projector", "irradiance": slide(height, width), "fov": 50.0,
                                                  "fov_axis": axis})
    assert scene.get_submodule("lamp").fov == pytest.approx(horizontal, abs=1e-4)


def test_a_projector_has_the_lens_of_a_camera_by_default():
    scene = load(sensor=sensor(2), **FLOOR, lamp={"type": "projector"})
    assert scene.get_submodule("lamp").fov == pytest.approx(34.0221, abs=1e-4)  # printed by Mitsuba 3.9.1


def test_directional_light_comes_from_one_direction_at_any_distance():
    points = np.array([[0, 0, 0], [1e4, 2, 3], [0, -5, 1e-3]])
    light = lit(points, type="directional", direction=[1.0, -2.0, 3.0], irradiance=rgb(2, 3, 4))
    expected = -torch.tensor([1.0, -2, 3], dtype=torch.float64) / math.sqrt(14)
    torch.testing.assert_close(light.d.stack(), expected.expand(3, 3), rtol=0, atol=1e-7)
    torch.testing.assert_close(light.radiance.stack(), torch.tensor([2.0, 3, 4], dtype=torch.float64).expand(3, 3))
    assert light.distant.all() and not light.findable.any()


def test_a_direction_becomes_the_pose_that_mitsuba_makes_of_it():
    """mi.traverse(directional)["to_world"] of Mitsuba 3.9.1 for direction (1, 2, 3)."""
    expected = torch.tensor([[0.0792865, 0.96035683, 0.26726127], [-0.84142697, -0.07928652, 0.53452253],
                             [0.5345225, -0.26726127, 0.8017838]], dtype=torch.float64)
    torch.testing.assert_close(facing([1, 2, 3])[:3, :3], expected, rtol=0, atol=1e-6)


def test_lights_are_chosen_by_their_weights():
    scene = scene_of("all")
    scene.get_submodule("spot_image_lamp").sampling_weight = 3.0
    lights, kinds = detached(scene).lights, detached(scene).layout.lights
    total = torch.zeros(6, dtype=torch.float64).index_add_(0, lights.kind, lights.choice.pmf)
    expected = [3 if kind == SpotKind() else 1 for kind in kinds]
    torch.testing.assert_close(total, torch.tensor(expected, dtype=torch.float64) / 8)


@pytest.mark.parametrize("kind", ["spot", "projector", "directional"])
def test_the_scale_of_a_pose_does_not_count(kind):
    points = in_front([[0.1, 0.05, 1.0], [-0.1, 0.1, 2.0]])
    plain, scaled = (lit(points, type=kind, to_world=POSE @ np.diag([s, s, s, 1])) for s in (1.0, 2.5))
    assert plain.radiance.x.min() > 0
    torch.testing.assert_close(plain.radiance.stack(), scaled.radiance.stack(), rtol=1e-5, atol=0)
    torch.testing.assert_close(plain.d.stack(), scaled.d.stack(), rtol=0, atol=1e-6)
