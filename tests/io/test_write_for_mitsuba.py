"""What is saved as XML loads in Mitsuba, or is named; what glTF cuts off is named."""

import warnings

import numpy as np
import pytest
import torch

import torch_radbp as rb
from torch_radbp.plugin import SceneError
from torch_radbp.tensors.vec import Vec2

POSE = rb.look_at([0.3, 0.2, 2.5], [0.1, 0, 0], [0, 1, 0.1])
CAMERA = {"type": "calibrated", "fx": 9.0, "cx": 2.5, "cy": 4.25, "to_world": POSE,
          "film": {"type": "hdrfilm", "width": 8, "height": 6, "rfilter": {"type": "box"}}}
PLACES = [(0.0, 0.0), (1.0, 0.0), (0.25, 0.75), (0.5, 0.5), (1.0, 1.0)]


def scene_of(camera=CAMERA, bsdf=None):
    wall = {"type": "rectangle", "bsdf": bsdf or {"type": "diffuse"}}
    return rb.load_dict({"type": "scene", "camera": camera, "wall": wall, "sky": {"type": "constant"}})


def directions(sensor):
    """World directions in which places on the image are seen."""
    x, y = (torch.tensor(column, dtype=torch.get_default_dtype()) for column in zip(*PLACES))
    ray, _ = sensor.kind().sample_ray(sensor.lens(), Vec2(x, y), None)
    return torch.stack(tuple(ray.d), 1).detach().numpy()


@pytest.mark.parametrize("changes", [{}, {"cx": 3.5, "cy": 2.5}, {"k1": 0.0, "p2": 0.0}, {"fx": 30.0, "fy": 30.0}])
def test_a_calibrated_camera_without_distortion_is_a_perspective(changes, tmp_path):
    scene = scene_of(CAMERA | changes)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        rb.save(scene, tmp_path / "scene.xml", strict=True)
    again = rb.load(tmp_path / "scene.xml")
    assert again.sensors[0].type == "perspective" and scene.sensors[0].type == "calibrated"
    np.testing.assert_allclose(directions(again.sensors[0]), directions(scene.sensors[0]), atol=2e-6)


def test_mitsuba_sees_the_same_through_it(mi, tmp_path):
    scene = scene_of()
    rb.save(scene, tmp_path / "scene.xml", strict=True)
    sensor = mi.load_file(str(tmp_path / "scene.xml")).sensors()[0]
    theirs = [np.array(sensor.sample_ray(0.0, 0.0, place, [0.5, 0.5])[0].d) for place in PLACES]
    np.testing.assert_allclose(directions(scene.sensors[0]), theirs, atol=2e-6)


def test_what_the_camera_of_a_batch_is_written_as(tmp_path):
    scene = scene_of({"type": "batch", "film": CAMERA["film"], "left": CAMERA, "right": CAMERA | {"cx": 4.0}})
    rb.save(scene, tmp_path / "scene.xml", strict=True)
    assert (tmp_path / "scene.xml").read_text().count('type="perspective"') == 2


LACKING = {
    "k1 and p2": ({"k1": 0.1, "k2": 0.0, "p2": -0.01}, "its sensors have no k1, p2"),
    "skew": ({"skew": 0.5}, "its sensors have no skew"),
    "pixels that are not square": ({"fy": 9.1}, "its sensors have no fx other than fy"),
    "fisheye": ({"distortion": "fisheye"}, "its sensors have no fisheye"),
}


@pytest.mark.hostile
@pytest.mark.parametrize("case", LACKING)
def test_what_mitsuba_lacks_is_named(case, tmp_path):
    changes, message = LACKING[case]
    scene, path = scene_of(CAMERA | changes), tmp_path / "scene.xml"
    with pytest.raises(SceneError) as caught:
        rb.save(scene, path, strict=True)
    assert str(caught.value) == f"scene.xml: Mitsuba cannot read this file: camera: {message}"
    assert not path.exists()
    with pytest.warns(UserWarning) as found:
        rb.save(scene, path)
    assert [str(each.message) for each in found] == [f"{caught.value}; torch_radbp can"]
    assert {name for name, _ in rb.load(path).named_parameters()} == {name for name, _ in scene.named_parameters()}


@pytest.mark.hostile
def test_it_is_what_mitsuba_refuses(mi, tmp_path):
    with pytest.warns(UserWarning, match="Mitsuba cannot read"):
        rb.save(scene_of(CAMERA | {"k1": 0.1}), tmp_path / "scene.xml")
    with pytest.raises(RuntimeError, match="calibrated"):
        mi.load_file(str(tmp_path / "scene.xml"))


@pytest.mark.hostile
def test_a_trilinear_bitmap_is_named(tmp_path):
    picture = {"type": "bitmap", "data": np.full((2, 2, 3), 0.5), "filter_type": "trilinear"}
    with pytest.raises(SceneError, match="wall.bsdf.reflectance: its bitmaps have no filter_type 'trilinear'"):
        rb.save(scene_of(bsdf={"type": "diffuse", "reflectance": picture}), tmp_path / "scene.xml", strict=True)


PERSPECTIVE = {"type": "perspective", "to_world": POSE, "film": CAMERA["film"]}
BEYOND = {
    "a colour": ({"type": "diffuse", "reflectance": [0.2, 1.5, 0.5]}, "wall.bsdf: its base colour: 0.2 to 1.5, is cut to "),
    "a bitmap": ({"type": "diffuse", "reflectance": {"type": "bitmap", "data": np.full((2, 2, 3), 1.25)}},
                 "wall.bsdf: its base colour: 1.25 to 1.25, is cut to [0, 1]"),
    "a metal": ({"type": "principled", "base_color": [3.0, 0.5, 0.5], "metallic": 1.0}, "its base colour: 0.5 to 3, is cut"),
}


@pytest.mark.hostile
@pytest.mark.filterwarnings("ignore:.*reflects more light")
@pytest.mark.parametrize("case", BEYOND)
def test_what_gltf_cuts_off_is_named(case, tmp_path):
    bsdf, message = BEYOND[case]
    scene = scene_of(PERSPECTIVE, bsdf)
    with pytest.warns(rb.GltfWarning) as found:
        rb.save(scene, tmp_path / "scene.glb")
    assert message in str(found[-1].message)
    with pytest.raises(SceneError) as caught:
        rb.save(scene, tmp_path / "strict.glb", strict=True)
    assert message in str(caught.value)


def test_what_is_in_range_is_not_named(tmp_path):
    with pytest.warns(rb.GltfWarning) as found:
        rb.save(scene_of(PERSPECTIVE, {"type": "diffuse", "reflectance": [0.0, 1.0, 0.5]}), tmp_path / "scene.glb")
    assert "is cut" not in str(found[-1].message)
