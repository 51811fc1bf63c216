"""Scenes of Mitsuba before version 2 mean what Mitsuba 3.9.1 takes them for."""

import numpy as np
import pytest

from tests.io.documents import write_scene
from torch_radbp.io.xml_scene import read_scene
from torch_radbp.io.xml_upgrade import snake_case


def read(folder, body: str, version: str = "0.6.0") -> dict:
    return read_scene(write_scene(folder, body, complete=False, version=version), {})


@pytest.mark.parametrize(("old", "new"), [
    ("toWorld", "to_world"), ("intIOR", "int_ior"), ("alphaU", "alpha_u"), ("cropOffsetX", "crop_offset_x"),
    ("max_depth", "max_depth"), ("alpha", "alpha"),
])
def test_names_become_those_of_mitsuba_3(old, new):
    assert snake_case(old) == new


def test_ids_types_values_and_variables_stay(tmp_path):
    scene = read(tmp_path, '<default name="maxDepth" value="7"/><integrator type="path"><integer name="maxDepth" '
                           'value="$maxDepth"/></integrator><bsdf type="conductor" id="aMirror"><string name="material" '
                           'value="Au"/></bsdf>')
    assert scene == {"type": "scene", "path": {"type": "path", "max_depth": 7},
                     "aMirror": {"type": "conductor", "id": "aMirror", "material": "Au"}}


def test_newer_scenes_are_not_changed(tmp_path):
    body = '<shape type="sphere"><float name="someName" value="1"/></shape>'
    assert read(tmp_path, body, version="2.0.0")["sphere"] == {"type": "sphere", "someName": 1.0}
    assert read(tmp_path, body, version="1.9.0")["sphere"] == {"type": "sphere", "some_name": 1.0}


def test_each_included_file_has_its_own_version(tmp_path):
    write_scene(tmp_path, '<shape type="sphere"><float name="someName" value="1"/></shape>', name="part.xml", complete=False)
    scene = read(tmp_path, '<include filename="part.xml"/><shape type="cube"><float name="someName" value="1"/></shape>')
    assert (list(scene["sphere"]), list(scene["cube"])) == (["type", "someName"], ["type", "some_name"])


def test_shifts_and_scales_of_a_texture_become_a_transform(tmp_path):
    """As in Mitsuba 3.9.1: scale after shift, at (u, v) = (0, 0) the coordinates are (0.6, -0.8)."""
    scene = read(tmp_path, '<texture type="bitmap"><float name="uscale" value="2"/><float name="uoffset" value="0.3"/>'
                           '<float name="vscale" value="4"/><float name="voffset" value="-0.2"/></texture>')
    expected = np.diag([2.0, 4.0, 1.0, 1.0])
    expected[:2, 3] = 0.6, -0.8
    assert np.allclose(scene["bitmap"]["to_uv"], expected) and list(scene["bitmap"]) == ["type", "to_uv"]


def test_the_colour_of_a_diffuse_bsdf_has_another_name(tmp_path):
    scene = read(tmp_path, '<bsdf type="diffuse" id="a"><rgb name="diffuseReflectance" value="0.2"/></bsdf>'
                           '<bsdf type="plastic" id="b"><rgb name="diffuseReflectance" value="0.2"/></bsdf>')
    assert list(scene["a"])[2:] == ["reflectance"] and list(scene["b"])[2:] == ["diffuse_reflectance"]


def test_a_camera_looks_where_it_looked(tmp_path):
    pose = '<transform name="to{}orld"><look{}t origin="1, 2, 3" target="0, 0, 1" up="0, 1, 0"/></transform>'
    scene = read(tmp_path, f'<shape type="sphere">{pose.format("W", "A")}</shape>')
    newer = read(tmp_path, f'<shape type="sphere">{pose.format("_w", "a")}</shape>', version="3.0.0")
    assert np.array_equal(scene["sphere"]["to_world"], newer["sphere"]["to_world"])
