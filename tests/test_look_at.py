"""`rb.look_at` against Mitsuba, closed forms and finite differences."""

import numpy as np
import pytest
import torch

import torch_radbp as rb

VIEWS = [  # origin, target, up
    ([1, 2, 4], [0, 0.5, 0], [0, 1, 0]),
    ([1.0, 2, 4], [0, 0, 0], [0, 3, 0.5]),
    ([0, 0, 4], [1e-9, 0, 0], None),
    ([0, 0, -4], [0.1, 0, 0], [0, 0, 0]),
    ([3, -1, 2], [-1, 0, 7], None),
]


@pytest.mark.parametrize("origin, target, up", VIEWS[:2])  # without up: tests/io/test_transform.py
def test_look_at_is_that_of_mitsuba(mi, origin, target, up):
    theirs = mi.ScalarTransform4f().look_at(origin, target, up).matrix
    np.testing.assert_allclose(rb.look_at(origin, target, up).numpy(), np.array(theirs), atol=1e-6)


def test_look_at_maps_the_axes():
    matrix = rb.look_at((1, 2, 3), (1, 2, 8), (0, 1, 0))
    assert matrix.dtype == torch.float32
    torch.testing.assert_close(matrix @ torch.tensor([0.0, 0, 5, 1]), torch.tensor([1.0, 2, 8, 1]))
    torch.testing.assert_close(matrix[:3, 1], torch.tensor([0.0, 1, 0]))


@pytest.mark.parametrize("origin, target, up", VIEWS)
def test_every_pose_is_rigid_and_its_derivatives_are_right(origin, target, up):
    points = [torch.tensor(point, dtype=torch.float64, requires_grad=True)
              for point in (origin, target, up) if point is not None and any(point)]
    rotation = rb.look_at(*points)[:3, :3].detach()
    torch.testing.assert_close(rotation @ rotation.T, torch.eye(3, dtype=torch.float64))
    assert float(torch.linalg.det(rotation)) == pytest.approx(1.0)
    assert torch.autograd.gradcheck(rb.look_at, points)


@pytest.mark.parametrize("scale", [1e-18, 1e18])
def test_points_at_any_scale_give_the_same_rotation(scale):
    origin, target = torch.tensor([1.0, 2, 4]), torch.tensor([0, 0.5, 0])
    expected = rb.look_at(origin, target, [0, 1, 0])[:3, :3]
    torch.testing.assert_close(rb.look_at(origin * scale, target * scale, [0, scale, 0])[:3, :3], expected)


def test_a_scene_dict_takes_it():
    film = {"type": "hdrfilm", "width": 2, "height": 2}
    pose = rb.look_at([0, 1, 4], [0, 0, 0], [0, 1, 0])
    scene = rb.load_dict({"type": "scene", "sky": {"type": "constant"},
                          "eye": {"type": "perspective", "film": film, "to_world": pose}})
    assert torch.equal(scene.get_parameter("eye.to_world"), pose)


@pytest.mark.parametrize("arguments, error, message", [
    (([1, 1, 1], [1, 1, 1], [0, 1, 0]), ValueError, "origin and target must differ"),
    (([1e6, 0, 0], [1e6 + 0.06, 0, 0], [0, 1, 0]), ValueError, "origin and target must differ"),
    (([0, 0, 1], [0, 0, 0], [0, 0, 3]), ValueError, "up must not be parallel to the line of sight"),
    (([0, 1], [0, 0, 0], [0, 1, 0]), ValueError, r"origin must have shape \(3,\), got \(2,\)"),
    (([0, 0, 1], torch.zeros(1, 3), [0, 1, 0]), ValueError, r"target must have shape \(3,\), got \(1, 3\)"),
    (([0, 0, 1], [0, 0, float("nan")], [0, 1, 0]), ValueError, "target must be finite"),
    (("origin", [0, 0, 0], [0, 1, 0]), TypeError, "origin must be three numbers, got 'origin'"),
    (([0, 0, 1], [0, 0, 0], [1j, 0, 0]), TypeError, "up must be three numbers"),
    (([0, 0, 1], None, [0, 1, 0]), TypeError, "target must be three numbers, got None"),
])
def test_what_has_no_direction_is_refused(arguments, error, message):
    with pytest.raises(error, match=message):
        rb.look_at(*arguments)
