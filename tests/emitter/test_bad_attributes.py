"""Emitters that cannot be: one message that says what was expected, what came, and what is known."""

import numpy as np
import pytest
import torch

import torch_radbp as rb
from tests.io.documents import scene_dict
from tests.scenes import load, rectangle, sensor, texels
from torch_radbp.io.values.transform import rotate

pytestmark = pytest.mark.hostile

BITMAP = {"type": "bitmap", "data": texels(2, 2)}
SKY = {"type": "envmap", "bitmap": texels(3, 4)}

BAD = {
    "envmap without an image": ({"type": "envmap"}, "needs either filename or bitmap"),
    "envmap with two images": (SKY | {"filename": __file__}, "either filename or bitmap, and not both"),
    "missing file": ({"type": "envmap", "filename": "nowhere.exr"}, "filename 'nowhere.exr' not found; looked in"),
    "wrong shape": ({"type": "envmap", "bitmap": np.ones((3, 4, 2))}, r"bitmap must have shape .*, got \(3, 4, 2\)"),
    "no texels": ({"type": "envmap", "bitmap": np.ones((0, 4, 3))}, "bitmap must have shape"),
    "negative texel": ({"type": "envmap", "bitmap": -texels(3, 4)}, "bitmap must be at least 0, got -0"),
    "not a number": ({"type": "envmap", "bitmap": np.full((3, 4, 3), np.nan)}, "36 of 36 values that are NaN or infinite"),
    "negative scale": (SKY | {"scale": -1.0}, "scale must be at least 0 and finite, got -1"),
    "flat pose": (SKY | {"to_world": np.diag([1.0, 1, 0, 1])}, "to_world must be invertible"),
    "misspelt": (SKY | {"to_wrold": np.eye(4)}, "no attribute 'to_wrold'; did you mean 'to_world'"),
    "negative weight": (SKY | {"sampling_weight": -1.0}, "sampling_weight must be at least 0 and finite, got -1"),
    "cutoff of zero": ({"type": "spot", "cutoff_angle": 0.0}, "cutoff_angle must be more than 0 and at most 180 deg"),
    "beam as wide as the cone": ({"type": "spot", "cutoff_angle": 20.0, "beam_width": 20.0},
                                 "beam_width must be at least 0 and less than the cutoff_angle of 20.0 degrees, got 20.0"),
    "negative beam": ({"type": "spot", "beam_width": -1.0}, "beam_width must be at least 0"),
    "image in half a space": ({"type": "spot", "cutoff_angle": 90.0, "texture": BITMAP}, "less than 90 degrees for a spot"),
    "image as intensity": ({"type": "spot", "intensity": BITMAP}, "intensity of a spot emitter must be one number or"),
    "negative intensity": ({"type": "spot", "intensity": -1.0}, "intensity must be at least 0, got -1"),
    "unknown axis": ({"type": "projector", "fov_axis": "diagnal"}, "fov_axis 'diagnal' is not known; did you mean 'dia"),
    "field of view": ({"type": "projector", "fov": 180.0}, "fov must be between 0 and 180 degrees, got 180"),
    "two lenses": ({"type": "projector", "fov": 40.0, "focal_length": "50mm"}, "either fov or focal_length, not both"),
    "not a lens": ({"type": "projector", "focal_length": "wide"}, "focal_length must read like '50mm', got 'wide'"),
    "negative image": ({"type": "projector", "irradiance": {"type": "bitmap", "data": -texels(2, 2)}},
                       "irradiance must be at least 0"),
    "projector turned off": ({"type": "projector", "scale": -0.1}, "scale must be at least 0"),
    "no direction": ({"type": "directional", "direction": [0.0, 0, 0]}, "direction must not be zero"),
    "two directions": ({"type": "directional", "direction": [0.0, 0, 1], "to_world": np.eye(4)},
                       "either direction or to_world, not both"),
    "image as irradiance": ({"type": "directional", "irradiance": BITMAP}, "irradiance of a directional emitter must be"),
    "two positions": ({"type": "point", "position": [0.0, 0, 0], "to_world": np.eye(4)}, "either position or to_world"),
}


@pytest.mark.parametrize("emitter, message", BAD.values(), ids=BAD)
def test_a_bad_emitter_is_refused(emitter, message):
    description = scene_dict(lamp=emitter)
    del description["sky"]
    with pytest.raises(rb.SceneError, match=message) as caught:
        rb.load_dict(description)
    assert str(caught.value).startswith("lamp")


@pytest.mark.parametrize("first, second", [("constant", "envmap"), ("envmap", "envmap"), ("constant", "constant")])
def test_two_surrounds_are_refused(first, second):
    kinds = {"constant": {"type": "constant"}, "envmap": SKY}
    with pytest.raises(rb.SceneError, match=rf"more than one emitter that surrounds it \({first}, {second}\)"):
        rb.load_dict(scene_dict(sky=kinds[first], second=kinds[second]))


def test_only_area_lights_belong_to_shapes():
    with pytest.raises(rb.SceneError, match="an emitter that shines from surfaces, such as area; got 'spot'"):
        rb.load_dict(scene_dict(wall=rectangle((0, 0, 0), emitter={"type": "spot"})))


def test_an_emitter_of_a_shape_cannot_stand_alone():
    with pytest.raises(rb.SceneError, match="`lamp` is an emitter of type area, which belongs inside a shape"):
        rb.load_dict(scene_dict(lamp={"type": "area"}))


def test_if_no_emitter_can_be_picked_the_message_says_why():
    """Mitsuba 3.9.1: `DiscreteDistribution: no probability mass found!`."""
    scene = rb.load_dict(scene_dict(wall=rectangle((0, 0, 0)), lamp={"type": "point", "sampling_weight": 0.0}))
    scene.get_submodule("sky").sampling_weight = 0.0
    with pytest.raises(ValueError, match="the sampling_weight of every emitter is 0"):
        rb.render(scene, spp=1, max_depth=2)
    scene.get_submodule("sky").sampling_weight = -1.0
    with pytest.raises(ValueError, match="sampling_weight of a constant emitter must be at least 0 and finite, got -1"):
        rb.render(scene, spp=1, max_depth=2)


def test_a_cone_that_an_optimiser_has_turned_inside_out_is_named():
    scene = rb.load_dict(scene_dict(wall=rectangle((0, 0, 0)), lamp={"type": "spot"}))
    scene.get_parameter("lamp.beam_width").fill_(21.0)
    with pytest.raises(ValueError, match="beam_width must be less than cutoff_angle, got 21.0 and 20.0 degrees"):
        rb.render(scene, spp=1, max_depth=2)


def test_a_pose_that_an_optimiser_has_flattened_is_named():
    scene = rb.load_dict(scene_dict(wall=rectangle((0, 0, 0)), lamp={"type": "projector"}))
    scene.get_parameter("lamp.to_world")[:3, 0] = 0.0
    with pytest.raises(ValueError, match="to_world must be invertible"):
        rb.render(scene, spp=1, max_depth=2)


def test_a_constant_takes_a_pose_which_changes_nothing():
    scenes = [load(sensor=sensor(4), floor=rectangle((0, 0, 0)), sky={"type": "constant"} | more)
              for more in ({}, {"to_world": rotate((0, 1, 0), 40)})]
    images = [rb.render(scene, spp=4, max_depth=3) for scene in scenes]
    assert torch.equal(*images) and images[0].max() > 0
    with pytest.raises(ValueError, match="to_world"):
        load(sensor=sensor(4), sky={"type": "constant", "to_world": np.zeros((4, 4))})


def test_an_attribute_that_an_emitter_has_not_lists_those_that_it_has():
    with pytest.raises(ValueError, match="no attribute 'intensity'; known: radiance, sampling_weight, to_world"):
        load(sensor=sensor(4), sky={"type": "constant", "intensity": 1.0})
