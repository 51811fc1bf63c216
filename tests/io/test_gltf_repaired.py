"""What can be left out or repaired of a glTF file is, and one warning counts and names it; extensions and uris of people."""

import base64
import math

import numpy as np
import pytest

import torch_radbp as rb
from tests.io.gltf_files import SQUARE, SQUARE_FACES, SQUARE_UV, GltfFile
from tests.io.gltf_loading import lamp, load_quietly, load_with_loss
from torch_radbp.io.gltf.document import GltfWarning
from torch_radbp.plugin import SceneError

NAN = float("nan")


@pytest.fixture
def file():
    return GltfFile()


def flat(file):
    return file.square(POSITION=file.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]]))


def empty(file):
    none = file.add("accessors", componentType=5126, count=0, type="VEC3")
    return {"attributes": {"POSITION": none}}


def five_corners(file):
    return {**file.square(), "indices": file.array(SQUARE_FACES[:5], "uint16")}


def instanced(file, **attributes):
    return {"EXT_mesh_gpu_instancing": {"attributes": {name: file.array(values) for name, values in attributes.items()}}}


LEFT_OUT = "is left out: its triangles have no area"
# What makes a primitive, what is said of it, and how many shapes come of it.
ODD = {
    "no area": (flat, LEFT_OUT, 0),
    "no area in the precision of the scene": (
        lambda f: f.square(POSITION=f.array(np.array(SQUARE) * 1e-30)), LEFT_OUT, 0),
    "no elements": (empty, "is left out: it has no triangles", 0),
    "no attributes": (lambda f: {"attributes": {}}, "is left out: it has no POSITION", 0),
    "two corners": (lambda f: {**f.square(), "indices": f.array([0, 1], "uint16")}, "is left out: it has no triangles", 0),
    "five corners": (five_corners, "the corners at the end that make no whole triangle are left out", 1),
    "NaN normal": (lambda f: f.square(NORMAL=f.array([[0, 0, 1], [NAN, 0, 1], [0, math.inf, 0], [0, 0, 0]])),
                   r"\(3 of 4\): normals that are zero or not finite are made from the triangles around", 1),
    "NaN uv": (lambda f: f.square(uv=[[0, 1], [NAN, 1], [1, 0], [0, 0]]), r"\(1 of 4\): surface coordinates that", 1),
    "bright colour": (lambda f: f.square(COLOR_0=f.array([[3, 0, 0.5]] * 4)), r"\(up to 3\): colours of vertices", 1),
}


@pytest.mark.parametrize("case", ODD)
def test_an_odd_primitive_is_left_out_or_repaired_and_the_others_are_read(file, tmp_path, case):
    make, message, count = ODD[case]
    file.node(file.square(), name="sheet")
    file.node(make(file), name="odd")
    scene = load_with_loss(file, tmp_path, rf"meshes\[1\].primitives\[0\].*{message}")
    assert len(list(scene.shapes)) == 1 + count
    if count:
        np.testing.assert_allclose(scene.get_parameter("odd.vertex_normals").detach(), [[0, 0, 1]] * 4, atol=1e-6)


def test_of_a_hundred_meshes_each_kind_is_told_once(file, tmp_path):
    square, line = file.square(), flat(file)
    for number in range(100):
        file.node(line if number % 5 == 0 else square, name=f"m{number}")
    file.node({"attributes": {}}, name="nothing")
    path = file.save(tmp_path / "asset.glb")
    with pytest.warns(GltfWarning) as caught:
        scene = rb.load(path)
    assert len(list(scene.shapes)) == 80 and len(caught) == 1
    text = str(caught[0].message)
    assert f"meshes[0].primitives[0], meshes[5].primitives[0], meshes[10].primitives[0] and 17 more: {LEFT_OUT}; " in text
    assert "meshes[100].primitives[0]: is left out: it has no POSITION" in text
    with pytest.raises(SceneError, match="and 17 more"):
        rb.load(path, strict=True)


def test_null_is_as_if_nothing_was_given_and_is_told(file, tmp_path):
    """Some writers write out what they do not have."""
    file.node(file.square(), name="sheet", camera=None, matrix=None, extras=None)
    file.document["accessors"][0]["byteOffset"] = None
    scene = load_with_loss(file, tmp_path, r"nodes\[0\].matrix, accessors.*byteOffset: null is read as if nothing was given")
    assert scene.get_parameter("sheet.vertex_positions").tolist() == SQUARE


def test_colours_that_rounding_has_moved_are_no_loss(file, tmp_path):
    file.node(file.square(COLOR_0=file.array([[1.0000001, -1e-7, 0.5]] * 4)), name="sheet")
    scene = load_quietly(file, tmp_path)
    assert scene.get_parameter("sheet.vertex_color")[0].tolist() == [1, 0, 0.5]


def test_colours_below_zero_are_refused_with_all_their_digits(file, tmp_path):
    file.node(file.square(COLOR_0=file.array([[1.0000001, -0.25, 0.5]] * 4)))
    with pytest.raises(SceneError, match=r"COLOR_0 must be in \[0, 1\], got -0.25 to 1.00000012"):
        rb.load(file.save(tmp_path / "asset.glb"))


@pytest.mark.parametrize("inner", [0.6, 0.6 + 1e-6])
def test_a_cone_that_ends_sharply_has_the_narrowest_fall_off(file, tmp_path, inner):
    """Blender writes blend 0 so. Light inside of 0.999 times the cutoff is that of Mitsuba, which lets it end sharply."""
    file.node(file.square())
    file.node(extensions=lamp(file, type="spot", spot={"innerConeAngle": inner, "outerConeAngle": 0.6}, name="stage"))
    stage = next(iter(load_with_loss(file, tmp_path, "beam_width, which is not less than cutoff_angle").emitters))
    assert float(stage.cutoff_angle) == pytest.approx(math.degrees(0.6), rel=1e-6)
    assert float(stage.beam_width) == pytest.approx(0.999 * math.degrees(0.6), rel=1e-6)


def test_a_beam_that_is_wider_than_its_cone_is_refused(file, tmp_path):
    file.node(file.square())
    file.node(extensions=lamp(file, type="spot", spot={"innerConeAngle": 0.7, "outerConeAngle": 0.6}))
    with pytest.raises(SceneError, match="beam_width must be at least 0 and less than the cutoff_angle"):
        rb.load(file.save(tmp_path / "asset.glb"))


def test_instances_stand_where_their_attributes_say(file, tmp_path):
    """By hand: a corner (1, 1, 0) is scaled, turned by 90 degrees about z to (-1, 1, 0), moved, then moved by the node."""
    half = math.sqrt(0.5)
    places = instanced(file, TRANSLATION=[[0, 0, 0], [5, 0, 0], [0, 0, 7]], ROTATION=[[0, 0, half, half]] * 3,
                       SCALE=[[1, 1, 1], [2, 2, 2], [1, 1, 1]])
    file.node(file.square(), name="leaf", translation=[0, 10, 0], extensions=places)
    file.document["extensionsRequired"] = file.document["extensionsUsed"] = ["EXT_mesh_gpu_instancing"]
    scene = load_quietly(file, tmp_path)
    corners = [scene.get_parameter(f"{name}.vertex_positions")[2].tolist() for name in ("leaf", "leaf_1", "leaf_2")]
    np.testing.assert_allclose(corners, [[-1, 11, 0], [3, 12, 0], [-1, 11, 7]], atol=1e-5)


def test_instances_that_do_not_fit_are_refused(file, tmp_path):
    file.node(file.square(), extensions=instanced(file, TRANSLATION=[[0, 0, 0]] * 2, SCALE=[[1, 1, 1]]))
    with pytest.raises(SceneError, match="must have the same number of elements, .* 2 of TRANSLATION, 1 of SCALE"):
        rb.load(file.save(tmp_path / "asset.glb"))


def test_an_instance_without_extent_is_left_out(file, tmp_path):
    places = instanced(file, SCALE=[[1, 1, 1], [0, 0, 0]])
    file.node(file.square(), name="leaf", extensions=places)
    scene = load_with_loss(file, tmp_path, "nodes.0. 'leaf': is left out: its transform flattens space")
    assert len(list(scene.shapes)) == 1


def test_nodes_that_are_not_visible_hide_all_below_but_cameras(file, tmp_path):
    hidden = {"KHR_node_visibility": {"visible": False}}
    shown = {"KHR_node_visibility": {"visible": True}}
    view = file.add("cameras", type="perspective", perspective={"yfov": 0.7, "znear": 0.1})
    below = [file.node(file.square(), name="below", root=False, extensions=shown),
             file.node(name="light", root=False, extensions=lamp(file, type="point")),
             file.node(name="view", root=False, camera=view)]
    file.node(file.square(), name="hidden", extensions=hidden, children=below)
    file.node(file.square(), name="seen", extensions=shown)
    file.document["extensionsUsed"] = ["KHR_node_visibility", "KHR_lights_punctual"]
    scene = load_quietly(file, tmp_path)
    assert [scene.name_of(shape) for shape in scene.shapes] == ["seen"]
    assert [emitter.type for emitter in scene.emitters] == ["constant"] and scene.name_of(scene.sensors[0]) == "view"


@pytest.mark.parametrize("name", ["EXT_meshopt_compression", "KHR_meshopt_compression"])
def test_compressed_views_are_read_from_their_fallback(file, tmp_path, name):
    file.node(file.square(), name="sheet")
    file.document["extensionsUsed"] = [name]
    for view in file.document["bufferViews"]:
        view["extensions"] = {name: {"buffer": 1, "byteLength": 4, "byteStride": 4, "count": 1, "mode": "ATTRIBUTES"}}
    file.document["buffers"].append({"byteLength": 4, "uri": "data:application/octet-stream;base64,AAAAAA=="})
    scene = load_quietly(file, tmp_path)
    assert scene.get_parameter("sheet.vertex_positions").tolist() == SQUARE
    file.document["buffers"].append({"byteLength": len(file.binary), "extensions": {name: {"fallback": True}}})
    file.document["bufferViews"][0]["buffer"] = 2
    with pytest.raises(SceneError, match="meshopt_compression is not supported, and there is no buffer with the same"):
        rb.load(file.save(tmp_path / "asset.glb"))


@pytest.mark.parametrize("name, message", [
    ("KHR_materials_unlit", "not supported; all surfaces are lit here"),
    ("KHR_draco_mesh_compression", "not supported; save it without compression: import it into Blender"),
    ("KHR_material_ior", "not supported; did you mean 'KHR_materials_ior'"),
    ("KHR_animation_pointer", "not supported; known: EXT_mesh_gpu_instancing")])
def test_what_a_document_requires_and_is_not_read_has_advice_of_its_own(file, tmp_path, name, message):
    file.node(file.square())
    file.document["extensionsRequired"] = [name]
    with pytest.raises(SceneError, match=message):
        rb.load(file.save(tmp_path / "asset.glb"))


def wrapped(text):
    return "\r\n".join(text[start:start + 20] for start in range(0, len(text), 20))


SPELLINGS = {
    "upper case": lambda text: f"data:application/octet-stream;BASE64,{text}",
    "scheme in upper case": lambda text: f"DATA:;base64,{text}",
    "line breaks": lambda text: f"data:;base64,{wrapped(text)}",
    "no padding": lambda text: f"data:;base64,{text.rstrip('=')}",
    "percent signs": lambda text: f"data:;base64,{text.replace('=', '%3D').replace('+', '%2B')}",
}


@pytest.mark.parametrize("case", SPELLINGS)
def test_data_uris_may_be_written_as_people_do(file, tmp_path, case):
    file.node(file.square(), name="sheet")
    file.binary += b"\0\xfb\xef\xbe\0"  # so that there is padding, and a plus sign
    text = base64.b64encode(file.binary).decode()
    assert "=" in text and "+" in text
    file.document["buffers"][0]["uri"] = SPELLINGS[case](text)
    scene = load_quietly(file, tmp_path, "asset.gltf")
    assert scene.get_parameter("sheet.vertex_texcoords").tolist() == SQUARE_UV


@pytest.mark.parametrize("uri, name", [
    ("a.bin?v=3", "a.bin"), ("a.bin#part", "a.bin"), ("data\\a.bin", "data/a.bin"),
    (".\\data\\a%20b.bin?x=1", "data/a b.bin"),
    ("a?b#c.bin", "a?b#c.bin"), ("data\\a.bin", "data\\a.bin")])
def test_uris_of_files_may_have_queries_and_backslashes(file, tmp_path, uri, name):
    file.node(file.square(), name="sheet")
    (tmp_path / "data").mkdir()
    (tmp_path / name).write_bytes(file.binary)
    file.document["buffers"][0]["uri"] = uri
    scene = load_quietly(file, tmp_path, "asset.gltf")
    assert scene.get_parameter("sheet.vertex_positions").tolist() == SQUARE


def test_backslashes_lead_out_of_the_folder_no_more_than_slashes(file, tmp_path):
    file.node(file.square())
    (tmp_path / "in").mkdir()
    (tmp_path / "secret.bin").write_bytes(file.binary)
    file.document["buffers"][0]["uri"] = "..\\secret.bin"
    with pytest.raises(SceneError, match="leads out of the folder"):
        rb.load(file.save(tmp_path / "in" / "asset.gltf"))


@pytest.mark.parametrize("uri", ["DATA/Wood.bin", "data/wood.BIN"])
def test_a_name_in_another_case_is_suggested(file, tmp_path, uri):
    file.node(file.square())
    (tmp_path / "Data").mkdir()
    (tmp_path / "Data" / "wood.bin").write_bytes(file.binary)
    file.document["buffers"][0]["uri"] = uri
    with pytest.raises(SceneError, match=f"{uri}: file not found; did you mean {tmp_path}/Data/wood.bin"):
        rb.load(file.save(tmp_path / "asset.gltf"))


def test_losses_are_told_where_nothing_is_left(file, tmp_path):
    file.node(flat(file))
    with pytest.raises(SceneError, match=rf"the scene has no triangles; meshes\[0\].primitives\[0\]: {LEFT_OUT}"):
        rb.load(file.save(tmp_path / "asset.glb"))


def test_strict_may_be_text_of_a_command_line(file, tmp_path):
    file.node(five_corners(file))
    path = file.save(tmp_path / "asset.glb")
    with pytest.raises(SceneError, match="no whole triangle"):
        rb.load(path, strict="true")
    with pytest.raises(TypeError, match="strict must be True or False, got 1"):
        rb.load(path, strict=1)
    with pytest.warns(GltfWarning):
        rb.load(path, strict="false")
