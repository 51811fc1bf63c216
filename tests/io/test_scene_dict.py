"""Scenes as Python dicts."""

import numpy as np
import pytest
import torch

from tests.io.documents import TRIANGLE_OBJ, scene_dict
from torch_radbp.bsdf.diffuse import Diffuse
from torch_radbp.io.load import load_dict

MATRIX = [[2.0, 0, 0, 1], [0, 3, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]


@pytest.mark.parametrize("matrix", [MATRIX, np.array(MATRIX), np.array(MATRIX, "f4"), torch.tensor(MATRIX)])
def test_a_transform_is_any_4_by_4_array(matrix):
    scene = load_dict(scene_dict(r={"type": "rectangle", "to_world": matrix}))
    torch.testing.assert_close(scene.get_parameter("r.to_world").detach(), torch.tensor(MATRIX))


def test_the_cornell_box_of_mitsuba_loads_with_its_parameter_names_and_values(mi):
    scene = load_dict(mi.cornell_box())
    theirs = mi.traverse(mi.load_dict(mi.cornell_box()))
    common = [name for name, _ in scene.named_parameters() if name in theirs]
    assert len(common) == 11  # Mitsuba merges the white shapes into one mesh without a name
    for name in common:
        value, parameter = theirs[name], scene.get_parameter(name)
        expected = np.array(value.matrix if name.endswith("to_world") else value, dtype="f4")
        np.testing.assert_allclose(parameter.detach().numpy(), expected, rtol=1e-6, err_msg=name)
    assert scene.integrator.max_depth == 8 and scene.sensors[0].sampler.sample_count == 64


def test_numbers_may_come_from_numpy_and_torch():
    bsdf = {"type": "diffuse", "reflectance": {"type": "rgb", "value": np.array([0.1, 0.2, 0.3])}}
    scene = load_dict(scene_dict(s={"type": "sphere", "radius": np.float32(2), "center": torch.tensor([1.0, 2, 3]),
                                    "bsdf": bsdf}))
    torch.testing.assert_close(scene.get_parameter("s.bsdf.reflectance.value").detach(), torch.tensor([0.1, 0.2, 0.3]))
    torch.testing.assert_close(scene.get_parameter("s.to_world")[:3, 3].detach(), torch.tensor([1.0, 2, 3]))


def test_a_colour_is_a_number_three_numbers_an_rgb_or_a_texture():
    def value(reflectance):
        scene = load_dict(scene_dict(white={"type": "diffuse", "reflectance": reflectance}))
        return scene.get_parameter("white.reflectance.value").tolist()

    assert value(0.5) == 0.5
    assert value([0.25, 0.5, 0.75]) == [0.25, 0.5, 0.75]
    assert value({"type": "rgb", "value": 0.5}) == [0.5, 0.5, 0.5]
    assert value({"type": "spectrum", "value": 0.5}) == 0.5


def test_plugins_already_made_are_taken_as_they_are():
    white = Diffuse(reflectance=0.75)
    scene = load_dict(scene_dict(white=white, ball={"type": "sphere", "bsdf": {"type": "ref", "id": "white"}}))
    assert scene.get_submodule("ball").bsdf is white


@pytest.mark.parametrize("name", ["white", "paint"])
def test_an_object_of_the_top_level_is_referred_to_by_key_and_by_id(name):
    """As in Mitsuba."""
    scene = load_dict(scene_dict(white={"type": "diffuse", "id": "paint"},
                                 ball={"type": "sphere", "bsdf": {"type": "ref", "id": name}}))
    assert scene.get_submodule("ball").bsdf is scene.get_submodule("white")


def test_one_dict_used_twice_makes_two_objects():
    white = {"type": "diffuse", "reflectance": 0.5}
    scene = load_dict(scene_dict(a={"type": "disk", "bsdf": white}, b={"type": "disk", "bsdf": white}))
    assert scene.get_parameter("a.bsdf.reflectance.value") is not scene.get_parameter("b.bsdf.reflectance.value")


def test_files_are_relative_to_base_dir(tmp_path):
    (tmp_path / "t.obj").write_text(TRIANGLE_OBJ)
    scene = load_dict(scene_dict(mesh={"type": "obj", "filename": "t.obj"}), base_dir=tmp_path)
    assert scene.get_parameter("mesh.vertex_positions").shape == (3, 3)


def test_texture_transforms_may_be_3_by_3():
    texture = {"type": "bitmap", "data": np.full((2, 2, 3), 0.5), "to_uv": [[2, 0, 0.25], [0, 3, 0.5], [0, 0, 1]]}
    bsdf = {"type": "diffuse", "reflectance": texture}
    matrix = load_dict(scene_dict(white=bsdf)).get_submodule("white.reflectance").to_uv
    assert matrix[:2, [0, 1, 3]].tolist() == [[2, 0, 0.25], [0, 3, 0.5]]
