"""The pose of a camera neither scales nor shears, as Mitsuba 3.9.1 demands; an orthographic one is scaled by it."""

import numpy as np
import pytest
import torch

import torch_radbp as rb
from torch_radbp.io.values.transform import rotate, scale, translate

PINHOLE = {"type": "perspective", "fov": 50.0}
LENS = {"type": "thinlens", "aperture_radius": 0.1, "fov": 50.0}
CALIBRATED = {"type": "calibrated", "fx": 4.0, "fy": 4.0}
SHEAR = np.array([[1, 0.3, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])
POSE = translate((1, 2, 3)) @ rotate((0.3, 1, 0.2), 50)
SCALED = {"doubled": scale((2, 2, 2)), "wide": scale((2, 1, 1)), "just beyond rounding": scale((1.0006, 1.0006, 1.0006)),
          "sheared": SHEAR}
TAKEN = {"rigid": np.eye(4), "mirrored": scale((-1, 1, 1)), "rounded": scale((1.0004, 1, 1))}


def scene(sensor: dict, to_world: np.ndarray, transform=np.asarray) -> dict:
    film = {"type": "hdrfilm", "width": 4, "height": 4}
    eye = sensor | {"film": film, "to_world": transform(POSE @ to_world)}
    return {"type": "scene", "eye": eye, "sky": {"type": "constant"}}


@pytest.mark.parametrize("to_world", SCALED.values(), ids=SCALED)
@pytest.mark.parametrize("sensor", [PINHOLE, LENS, CALIBRATED], ids=lambda sensor: sensor["type"])
def test_a_scaled_pose_is_refused(sensor, to_world):
    with pytest.raises(rb.SceneError, match=r"eye \(type '.*'\): to_world of a camera must not scale or shear.* lengths "):
        rb.load_dict(scene(sensor, to_world))


@pytest.mark.parametrize("to_world", TAKEN.values(), ids=TAKEN)
@pytest.mark.parametrize("sensor", [PINHOLE, LENS, CALIBRATED], ids=lambda sensor: sensor["type"])
def test_rotations_and_mirrored_poses_are_taken(sensor, to_world):
    pose = rb.load_dict(scene(sensor, to_world)).get_parameter("eye.to_world").detach().numpy()
    np.testing.assert_allclose(pose, POSE @ to_world, atol=1e-6)


@pytest.mark.parametrize("to_world", [*SCALED.values(), *TAKEN.values()], ids=[*SCALED, *TAKEN])
@pytest.mark.parametrize("sensor", [PINHOLE, LENS, {"type": "orthographic"}], ids=lambda sensor: sensor["type"])
def test_what_is_refused_is_what_mitsuba_refuses(mi, sensor, to_world):
    def loads(load, error, transform) -> bool:
        try:
            load(scene(sensor, to_world, transform))
        except error:
            return False
        return True

    theirs = loads(mi.load_dict, RuntimeError, mi.ScalarTransform4f)
    assert loads(rb.load_dict, rb.SceneError, np.asarray) == theirs
    assert theirs or sensor["type"] != "orthographic"


def test_a_pose_that_was_scaled_later_is_written_as_what_it_shows(tmp_path):
    """An optimiser moves all twelve numbers; the directions of the axes count."""
    made = rb.load_dict(scene(PINHOLE, np.eye(4)) | {"ball": {"type": "sphere", "center": [1.5, 2.2, 6]}})
    with torch.no_grad():
        made.get_parameter("eye.to_world").copy_(torch.as_tensor(POSE @ scale((3, 0.5, 2))))
    rb.save(made, tmp_path / "scene.xml")
    read = rb.load(tmp_path / "scene.xml")
    torch.testing.assert_close(read.get_parameter("eye.to_world").detach(), torch.as_tensor(POSE).float())
    images = [rb.render(each, spp=4, seed=2) for each in (made, read)]
    assert images[0].std() > 0
    torch.testing.assert_close(*images)


def test_a_sheared_pose_cannot_be_written(tmp_path):
    made = rb.load_dict(scene(PINHOLE, np.eye(4)))
    with torch.no_grad():
        made.get_parameter("eye.to_world").copy_(torch.as_tensor(POSE @ SHEAR))
    with pytest.raises(rb.SceneError, match="eye: not written, to_world shears.*rb.se3"):
        rb.save(made, tmp_path / "scene.xml")
