"""What can be left out or repaired of a mesh file is, and told once for each kind; strictly it is an error."""

import struct
import warnings

import numpy as np
import pytest

from tests.formats.one_triangle import BINARY, CORNERS, LITTLE, NORMALS, POINTS, ply
from tests.formats.serialized_files import mesh
from tests.io.documents import scene_dict
from torch_radbp.formats.leniency import Repairs
from torch_radbp.formats.mesh import read_mesh
from torch_radbp.io.load import load_dict
from torch_radbp.plugin import SceneError, SceneWarning

SQUARE = CORNERS + "v 1 1 0\n"
NAN = float("nan")
FEW, LACKS_UV = "the face has fewer than 3 corners", "corners without a texture coordinate are read at \\(0, 0\\)"
NO_DIRECTION = "the normal has no direction .zero or not finite., and is made from the triangles around"
UV = "property float u\nproperty float v\n"
QUALITY = "property float quality_1\n"
UPRIGHT = "0 0 0 0 0 1\n1 0 0 {} \n0 1 0 0 0 1\n3 0 1 2\n"
# Name of the file, its content, and the message; all have the triangle of CORNERS as their first.
REPAIRED = {
    "two corners": ("obj", CORNERS + "f 1 2 3\nf 1 2\nf\n", f", line 5, line 6: {FEW}"),
    "no uv on some": ("obj", CORNERS + "vt 0 0\nf 1/1 2/1 3/1\nf 1 3 2\n", f", line 6: {LACKS_UV}"),
    "no normals on some": ("obj", CORNERS + "vn 0 0 1\nf 1//1 2//1 3\n", ", line 5: corners without a normal have one made"),
    "normal of length 0": ("obj", CORNERS + "vn 0 0 1\nvn 0 0 0\nf 1//1 2//2 3//1\n", f", line 5: {NO_DIRECTION}"),
    "NaN normals": ("obj", CORNERS + "vn nan -nan(ind) 1\nvn 1.#QNAN 0 0\nf 1//1 2//2 3//1\n",
                    f", line 4, line 5: {NO_DIRECTION}"),
    "NaN uv": ("obj", CORNERS + "vt 0 0\nvt nan inf\nf 1/1 2/2 3/1\n", ", line 5: the texture coordinate is not finite"),
    "curves": ("obj", CORNERS + "f 1 2 3\ncstype bspline\ndeg 2\ncurv 0 1 1 2 3\nparm u 0 0 0 1 1 1\nend\nsurf 0 1 0 1 1\n",
               ", line 7, line 10: a curve or free-form surface is left out"),
    "two corners of ply": ("ply", ply(POINTS + "3 0 1 2\n2 0 1\n", faces=2), f", line 14: {FEW}"),
    "two corners, binary": ("ply", ply(BINARY + struct.pack("<B3iB2i", 3, 0, 1, 2, 2, 0, 1), LITTLE, faces=2),
                            f", face 1 .from 0.: {FEW}"),
    "normal of length 0 of ply": ("ply", ply(UPRIGHT.format("0 0 0"), more=NORMALS), f", line 14: {NO_DIRECTION}"),
    "NaN normals of ply": ("ply", ply(UPRIGHT.format("0 nan 1"), more=NORMALS), f", line 14: {NO_DIRECTION}"),
    "NaN uv of ply": ("ply", ply("0 0 0 0 0\n1 0 0 nan 0\n0 1 0 0 0\n3 0 1 2\n", more=UV),
                      ", line 13: the texture coordinate is not finite"),
    "NaN attribute": ("ply", ply("0 0 0 1\n1 0 0 nan\n0 1 0 1\n3 0 1 2\n", more=QUALITY),
                      ", line 12: the attribute vertex_quality is left out: it is not finite"),
    "NaN position that is not used": ("ply", ply(POINTS + "nan 0 0\n3 0 1 2\n").replace(b"vertex 3", b"vertex 4"),
                                      ", line 13: the position is not finite; no face uses"),
    "normals of serialized": ("serialized", mesh(np.eye(3), [[0, 1, 2]], normals=[[0, 0, 1], [0, 0, 0], [NAN, 0, 1]]),
                              f", mesh 0, vertex 1 .from 0., vertex 2 .from 0.: {NO_DIRECTION}"),
    "NaN uv of serialized": ("serialized", mesh(np.eye(3), [[0, 1, 2]], uv=[[0, 0], [NAN, 0], [0, 1]]),
                             ", mesh 0, vertex 1 .from 0.: the texture coordinate is not finite"),
}
# The like, of which there is nothing to tell, since nothing depends on it.
UNUSED = {
    "zero normal of a vertex without faces": ply("0 0 0 0 0 1\n1 0 0 0 0 1\n0 1 0 0 0 1\n5 5 5 0 0 0\n3 0 1 2\n",
                                                 more=NORMALS).replace(b"vertex 3", b"vertex 4"),
    "NaN of a property that is not read": ply("0 0 0 1\n1 0 0 nan\n0 1 0 1\n3 0 1 2\n", more="property float quality\n"),
    "float count": ply(POINTS + "3 0 1 2\n", count="float"),
    "float count, binary": ply(BINARY + struct.pack("<f3i", 3, 0, 1, 2), LITTLE, count="float"),
    "double counts of unequal faces": ply(BINARY + struct.pack("<d3id3i", 3, 0, 1, 2, 3, 0, 2, 1), LITTLE, faces=2,
                                          count="double"),
    "float indices": ply(POINTS + "3 0 1 2\n").replace(b"uchar int vertex", b"uchar float vertex"),
    "float rows": ply(POINTS + "3 0 1 2\n").replace(b"face 1", b"face 1.0"),
}


def written(folder, kind, content):
    path = folder / f"m.{kind}"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


@pytest.mark.parametrize("case", REPAIRED)
def test_the_rest_of_a_file_is_read_and_what_is_missing_is_told(tmp_path, case):
    kind, content, message = REPAIRED[case]
    path = written(tmp_path, kind, content)
    description = scene_dict(m={"type": kind, "filename": path.name})
    with pytest.warns(SceneWarning, match=f"{path}{message}") as caught:
        scene = load_dict(description, base_dir=tmp_path)
    assert len(caught) == 1 and caught[0].filename == __file__
    assert scene.get_buffer("m.faces")[0].tolist() == [0, 1, 2]
    with pytest.raises(SceneError, match=f"{path}{message}"):
        load_dict(description, base_dir=tmp_path, strict=True)


@pytest.mark.parametrize("case", UNUSED)
def test_what_nothing_depends_on_is_no_fault(tmp_path, case):
    path = written(tmp_path, "ply", UNUSED[case])
    scene = load_dict(scene_dict(m={"type": "ply", "filename": path.name}), base_dir=tmp_path, strict=True)
    assert scene.get_buffer("m.faces")[0].tolist() == [0, 1, 2]


@pytest.mark.parametrize("option", ["face_normals", "recompute_normals"])
@pytest.mark.parametrize("kind, content", [
    ("obj", CORNERS + "vn nan nan nan\nvn x\nf 1//1 2//1 3//2\n"),
    ("ply", ply(UPRIGHT.format("0 nan 1"), more=NORMALS)),
    ("serialized", mesh(np.eye(3), [[0, 1, 2]], normals=np.full((3, 3), NAN)))])
def test_normals_that_nobody_asks_for_are_no_fault(tmp_path, kind, content, option):
    path = written(tmp_path, kind, content)
    load_dict(scene_dict(m={"type": kind, "filename": path.name, option: True}), base_dir=tmp_path, strict=True)


def test_normals_without_a_direction_are_those_of_the_triangles_around(tmp_path):
    """By hand: all triangles lie in the plane z = 0 and face +z; the normals of the file are turned."""
    text = SQUARE + "vn 1 0 1\nvn 0 0 0\nf 1//1 2//2 3//1\nf 2//2 4 3//1\n"
    path = written(tmp_path, "obj", text)
    with pytest.warns(SceneWarning):
        scene = load_dict(scene_dict(m={"type": "obj", "filename": path.name}), base_dir=tmp_path)
    tilted, up = [0.5**0.5, 0, 0.5**0.5], [0, 0, 1]
    np.testing.assert_allclose(scene.get_parameter("m.vertex_normals").detach(), [tilted, up, tilted, up], atol=1e-6)


def test_faces_without_texture_coordinates_are_read_at_the_origin(tmp_path):
    path = written(tmp_path, "obj", SQUARE + "vt .5 .25\nvt .75 1\nf 1/1 2/2 3/1\nf 2 4 3\n")
    with pytest.warns(SceneWarning, match=LACKS_UV):
        read = read_mesh(path)
    assert read.faces.tolist() == [[0, 1, 2], [3, 4, 5]]
    assert read.uv.tolist() == [[0.5, 0.25], [0.75, 1], [0.5, 0.25], [0, 0], [0, 0], [0, 0]]


def test_attributes_of_faces_that_are_left_out_go_with_them(tmp_path):
    body = POINTS + "3 0 1 2 5\n2 0 1 6\n4 0 1 2 0 7\n"
    header = ply(body, faces=3).replace(b"end_header", b"property float mark_1\nend_header")
    with pytest.warns(SceneWarning, match=FEW):
        read = read_mesh(written(tmp_path, "ply", header))
    assert read.faces.tolist() == [[0, 1, 2], [0, 1, 2], [0, 2, 0]]
    assert read.attributes["face_mark"].tolist() == [[5], [7], [7]]


@pytest.mark.parametrize("kind, values", [("uchar", (0, 128, 255)), ("ushort", (0, 32896, 65535)), ("int", (0, 128, 255)),
                                          ("float", (0, 0.2158605, 1))])
def test_colours_that_are_integers_are_in_srgb(tmp_path, kind, values):
    """Of 128 / 255 the linear value is ((0.50196 + 0.055) / 1.055)^2.4 = 0.2158605 (IEC 61966-2-1)."""
    more = "".join(f"property {kind} {name}\n" for name in ("red", "green", "blue", "alpha"))
    colour = " ".join(map(str, values))
    body = f"0 0 0 {colour} 0\n1 0 0 {colour} 0\n0 1 0 {colour} 0\n3 0 1 2\n"
    read = read_mesh(written(tmp_path, "ply", ply(body, more=more)))
    np.testing.assert_allclose(read.attributes["vertex_color"], [[0, 0.2158605, 1]] * 3, atol=1e-7)


def test_a_scene_of_many_files_tells_each_kind_once(tmp_path):
    for number in range(5):
        (tmp_path / f"{number}.obj").write_text(CORNERS + "f 1 2 3\nf 1 2\ncurv 0 1 1 2\n")
    with pytest.warns(SceneWarning) as caught:
        load_dict(scene_dict(**{f"m{n}": {"type": "obj", "filename": f"{n}.obj"} for n in range(5)}), base_dir=tmp_path)
    curves, few = (str(warning.message) for warning in caught)
    assert few == (f"{tmp_path}/0.obj, line 5, {tmp_path}/1.obj, line 5, {tmp_path}/2.obj, line 5 and 2 more: the face has "
                   "fewer than 3 corners, and is left out")
    assert curves.endswith("2.obj, line 6 and 2 more: a curve or free-form surface is left out")


def test_many_places_of_a_file_are_counted():
    with pytest.warns(SceneWarning) as caught, Repairs() as repairs:
        repairs.add_rows(range(100), lambda row: f"a.obj, line {row}", "is left out")
    assert [str(warning.message) for warning in caught] == ["a.obj, line 0, line 1, line 2 and 97 more: is left out"]


def test_a_block_within_another_hands_over_to_it_and_one_that_fails_tells_nothing():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with pytest.raises(KeyError), Repairs() as outer, Repairs() as inner:
            assert inner is outer
            inner.add("a", "is left out")
            raise KeyError
        with pytest.raises(SceneError, match="^a, b: x; c: y$"), Repairs(), Repairs(strict=True) as inner:
            for place, what in ("ax", "bx", "ax", "cy"):
                inner.add(place, what)
