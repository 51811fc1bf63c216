"""What scene XML means: variables, includes, references, names and values."""

import pytest
import torch

from tests.io.documents import LAMP, SENSOR, TRIANGLE_OBJ, scene_text, write_scene
from torch_radbp.io.load import load
from torch_radbp.io.write import save
from torch_radbp.io.xml_scene import read_scene

WHITE = '<bsdf type="diffuse" id="white"><rgb name="reflectance" value="0.8, 0.7, 0.6"/></bsdf>'


def names(scene):
    return [name for name, _ in scene.named_parameters()]


def test_xml_becomes_the_dict_vocabulary(tmp_path):
    body = WHITE + '<shape type="sphere"><float name="radius" value="2"/><ref id="white"/></shape>' \
                   '<shape type="sphere"/>'
    assert read_scene(write_scene(tmp_path, body, complete=False), {}) == {
        "type": "scene",
        "white": {"type": "diffuse", "id": "white", "reflectance": {"type": "rgb", "value": [0.8, 0.7, 0.6]}},
        "sphere": {"type": "sphere", "radius": 2.0, "ref": {"type": "ref", "id": "white"}},
        "sphere_1": {"type": "sphere"},
    }


@pytest.mark.parametrize("element, value", [
    ('<integer name="v" value=" 12 "/>', 12),
    ('<float name="v" value="1e-3"/>', 1e-3),
    ('<float name="v" value="-.5"/>', -0.5),
    ('<boolean name="v" value="True"/>', True),
    ('<string name="v" value="a b"/>', "a b"),
    ('<rgb name="v" value="0.1 0.2,0.3"/>', {"type": "rgb", "value": [0.1, 0.2, 0.3]}),
    ('<rgb name="v" value="0.5"/>', {"type": "rgb", "value": [0.5, 0.5, 0.5]}),
    ('<spectrum name="v" value="0.5"/>', {"type": "spectrum", "value": 0.5}),
    ('<spectrum name="v" value="1, 2, 3"/>', {"type": "rgb", "value": [1, 2, 3]}),
    ('<spectrum name="v" value="400:.1, 700:2e-1"/>', {"type": "spectrum", "value": [(400, 0.1), (700, 0.2)]}),
    ('<spectrum name="v" filename="a.spd"/>', {"type": "spectrum", "filename": "a.spd"}),
    ('<point name="v" x="1" y="2" z="3"/>', [1, 2, 3]),
    ('<vector name="v" value="1, 2, 3"/>', [1, 2, 3]),
    ('<point name="v" value="4"/>', [4, 4, 4]),
])
def test_every_spelling_of_a_value(tmp_path, element, value):
    path = write_scene(tmp_path, f'<shape type="sphere" id="s">{element}</shape>', complete=False)
    assert read_scene(path, {})["s"]["v"] == value


def test_variables_come_from_the_call_before_the_default(tmp_path):
    sampler = '<sampler type="independent"><integer name="sample_count" value="$spp"/></sampler>'
    text = f'<default name="spp" value="8"/>{LAMP}<sensor type="perspective">{sampler}</sensor>'
    path = write_scene(tmp_path, text, complete=False)
    assert load(path).sensors[0].sampler.sample_count == 8
    assert load(path, spp=64).sensors[0].sampler.sample_count == 64


def test_the_longest_variable_wins_and_a_backslash_keeps_the_dollar(tmp_path):
    body = '<default name="a" value="1"/><default name="ab" value="2"/><bsdf type="diffuse" id="$ab-$a\\$a"/>'
    assert "2-1$a" in read_scene(write_scene(tmp_path, body), {})


def test_booleans_from_python_are_written_as_xml_writes_them(tmp_path):
    body = '<integrator type="path"><boolean name="hide_emitters" value="$hide"/></integrator>'
    assert load(write_scene(tmp_path, body), hide=True).integrator.hide_emitters is True


def test_includes_are_spliced_in_and_see_the_variables(tmp_path):
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "t.obj").write_text(TRIANGLE_OBJ)
    mesh = '<shape type="obj" id="mesh"><string name="filename" value="t.obj"/><ref id="white"/></shape>'
    write_scene(tmp_path / "parts", WHITE.replace("0.8", "$red") + mesh, name="all.xml", complete=False)
    (tmp_path / "parts" / "one.xml").write_text('<bsdf version="3.0.0" type="diffuse" id="one"/>')
    path = write_scene(tmp_path, '<default name="red" value="0.25"/><include filename="parts/all.xml"/>'
                                 '<shape type="cube" id="box"><include filename="parts/one.xml"/></shape>')
    scene = load(path)
    assert scene.get_parameter("white.reflectance.value")[0] == 0.25
    assert scene.get_parameter("mesh.vertex_positions").shape == (3, 3)
    assert names(load(path, red=0.5)) == names(scene)


def test_path_elements_add_folders_to_search(tmp_path):
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "t.obj").write_text(TRIANGLE_OBJ)
    body = '<path value="meshes"/><shape type="obj"><string name="filename" value="t.obj"/></shape>'
    assert "obj.vertex_positions" in names(load(write_scene(tmp_path, body)))


def test_references_may_point_forward_and_aliases_are_second_names(tmp_path):
    shapes = '<shape type="cube" id="a"><ref id="white"/></shape><shape type="cube" id="b"><ref id="paint"/></shape>'
    scene = load(write_scene(tmp_path, shapes + WHITE + '<alias id="white" as="paint"/>'))
    a, b, white = (scene.get_submodule(name) for name in ("a", "b", "white"))
    assert a.bsdf is white and b.bsdf is white
    assert names(scene).count("white.reflectance.value") == 1


def test_objects_without_an_id_are_named_by_their_type(tmp_path):
    scene = load(write_scene(tmp_path, '<shape type="rectangle" id="rectangle"/>' + '<shape type="rectangle"/>' * 2))
    assert [name for name in names(scene) if name.endswith("to_world")] == [
        "rectangle.to_world", "rectangle_1.to_world", "rectangle_2.to_world", "perspective.to_world"]


def test_nested_objects_find_their_attribute_by_category(tmp_path):
    film = '<film type="hdrfilm" name="whatever"><rfilter type="box"/></film>'
    dark = '<bsdf type="diffuse"><float name="reflectance" value="0.25"/></bsdf>'
    two = f'<bsdf type="twosided"><bsdf type="diffuse"/>{dark}</bsdf>'
    body = f'<shape type="disk" id="d">{two}</shape>{LAMP}<sensor type="perspective">{film}</sensor>'
    scene = load(write_scene(tmp_path, body, complete=False))
    assert scene.sensors[0].film.rfilter.type == "box"
    assert scene.get_parameter("d.bsdf.brdf_1.reflectance.value") == 0.25


@pytest.mark.parametrize("radiance", [
    '<rgb name="radiance" value="1, 2, 3"/>',
    '<spectrum name="radiance" value="2"/>',
])
def test_colours_of_emitters_are_those_of_mitsuba(mi, tmp_path, radiance):
    body = f'<shape type="rectangle" id="lamp"><emitter type="area">{radiance}</emitter></shape>{SENSOR}'
    path = write_scene(tmp_path, body, complete=False)
    theirs = list(mi.traverse(mi.load_file(str(path)))["lamp.emitter.radiance.value"])
    ours = load(path).get_parameter("lamp.emitter.radiance.value")
    torch.testing.assert_close(ours.detach(), torch.tensor(theirs))


@pytest.mark.parametrize("version", ["2.0.0", "2.1.0", "3.0.0", "3.9.1", "3.0", "3"])
def test_versions_of_mitsuba_2_and_3_are_read(tmp_path, version):
    (tmp_path / "scene.xml").write_text(scene_text("", version=version))
    assert load(tmp_path / "scene.xml").sensors


def test_parts_of_a_sensor_may_stand_in_the_scene_and_be_referred_to(tmp_path):
    text = ('<sampler type="multijitter" id="points"><integer name="sample_count" value="9"/></sampler>'
            '<rfilter type="tent" id="filter"/><film type="hdrfilm" id="film"><integer name="width" value="5"/>'
            '<ref id="filter"/></film><sensor type="perspective"><ref id="film"/><ref id="points"/></sensor>')
    scene = load(write_scene(tmp_path, LAMP + text, complete=False))
    (camera,) = scene.sensors
    assert (camera.film.width, camera.film.rfilter.type, camera.sampler.sample_count) == (5, "tent", 9)
    assert {name.split(".")[0] for name in names(scene)} == {"sky", "perspective"}


def test_the_lamp_of_a_shape_may_stand_in_the_scene_and_be_referred_to(tmp_path):
    """Its name is then its id, as in Mitsuba 3.9.1."""
    lamp = '<emitter type="area" id="lamp"><rgb name="radiance" value="1, 2, 3"/></emitter>'
    scene = load(write_scene(tmp_path, lamp + SENSOR + '<shape type="sphere" id="ball"><ref id="lamp"/></shape>',
                             complete=False))
    assert scene.emitters == [scene.ball.emitter]
    assert torch.equal(scene.get_parameter("lamp.radiance.value"), torch.tensor([1.0, 2.0, 3.0]))
    save(scene, tmp_path / "again.xml")
    assert set(names(load(tmp_path / "again.xml"))) == set(names(scene))
