"""Mesh files at the edge of their formats: read where the formats allow them, refused with file and line elsewhere."""

import os
import struct

import numpy as np
import pytest

from tests.formats.one_triangle import BIG, BINARY, CORNERS, LITTLE, POINTS, ply
from tests.io.documents import scene_dict
from torch_radbp.formats.mesh import read_mesh
from torch_radbp.io.load import load_dict

pytestmark = pytest.mark.hostile

FACE = struct.pack("<B3i", 3, 0, 1, 2)
DUST = "element dust 2\nproperty list int int a\nproperty int b\n"
BAD_OBJ = {
    "empty": ("", ": the mesh has 0 vertices and no faces"),
    "no faces": (CORNERS, ": the mesh has 3 vertices and no faces"),
    "no area": ("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", ": all 1 triangles are degenerate"),
    "nan": ("v 0 0 0\nv nan 0 0\nv 0 1 0\nf 1 2 3\n", ", line 2: expected a finite number, got 'nan'"),
    "infinity": ("v 0 0 0\nv 0 -inf 0\nv 0 1 0\nf 1 2 3\n", ", line 2: expected a finite number, got '-inf'"),
    "overflow": ("v 0 0 0\nv 0 1e999 0\nv 0 1 0\nf 1 2 3\n", ", line 2: expected a finite number, got '1e999'"),
    "decimal comma": ("v 0,5 0 0\n" + CORNERS + "f 1 2 3\n", ", line 1: expected a finite number, got '0,5'"),
    "two dots": ("v 0.1.2 0 0\n" + CORNERS + "f 1 2 3\n", ", line 1: expected a finite number, got '0.1.2'"),
    "vertex of two": ("v 0 0\n" + CORNERS + "f 1 2 3\n", r", line 1: a vertex \(v\) has 3 or 4 or 6 or 7 numbers, got 2"),
    "uv of one": (CORNERS + "vt 0\nf 1 2 3\n", r", line 4: a texture coordinate \(vt\) has 2 or 3 numbers, got 1"),
    "normal of two": (CORNERS + "vn 0 1\nf 1 2 3\n", r", line 4: a normal \(vn\) has 3 numbers, got 2"),
    "vertex out of range": (CORNERS + "\nf 1 2 4\n", r", line 5: the vertex index 4 is out of range, the file has 3 \(v\)"),
    "uv out of range": (CORNERS + "vt 0 0\nf 1/1 2/1 3/2\n", ", line 5: the texture coordinate index 2 is out of range"),
    "normal out of range": (CORNERS + "vn 0 0 1\nf 1//1 2//1 3//7\n", ", line 5: the normal index 7 is out of range, .* 1"),
    "no uv at all": (CORNERS + "f 1/1 2/1 3/1\n", r", line 4: the texture coordinate index 1 is out of range, .* 0 \(vt\)"),
    "index 0": (CORNERS + "f 0 1 2\n", ", line 4: vertex indices are integers from 1, or relative ones from -1, got '0'"),
    "uv index 0": (CORNERS + "vt 0 0\nf 1/1 2/0 3/1\n", ", line 5: texture coordinate indices are integers .* got '2/0'"),
    "normal index 0": (CORNERS + "vn 0 0 1\nf 1//1 2//1 3//0\n", ", line 5: normal indices are integers .* got '3//0'"),
    "fraction": (CORNERS + "f 1 2 2.5\n", ", line 4: vertex indices are integers .* got '2.5'"),
    "huge index": (CORNERS + "f 1 2 99999999999999999999\n", ", line 4: vertex indices are integers .* got '9999"),
    "relative out of range": (CORNERS + "f -4 -2 -1\n",
                              ", line 4: the relative vertex index in '-4' is out of range, 3 come"),
    "relative to later": ("v 0 0 0\nf -1 -2 -3\nv 1 0 0\nv 0 1 0\n",
                          ", line 2: the relative vertex index in '-3' .* 1 come"),
    "faces of two corners only": (CORNERS + "f 1 2\nf 2 3\n", ": the mesh has 3 vertices and no faces"),
    "curves only": (CORNERS + "curv 0 1 1 2 3\n", ": the mesh has 3 vertices and no faces"),
    "slash at the end": (CORNERS + "vt 0 0\nf 1/ 2/ 3/\n", ", line 5: a corner of a face is v, v/vt, v//vn .* got '1/'"),
    "three slashes": (CORNERS + "f 1///1 2///1 3///1\n", ", line 4: a corner of a face is .* got '1///1'"),
    "slash alone": (CORNERS + "f 1 2 /\n", ", line 4: a corner of a face is .* got '/'"),
    "word as a corner": (CORNERS + "f 1 2 x\n", ", line 4: vertex indices are integers .* got 'x'"),
    "unknown keyword": (CORNERS + "f 1 2 3\nfc 1 2 3\n", ", line 5: 'fc' does not begin a line that is supported"),
    "binary": (b"v 0 0 0\n\x00\x01\x02", ", line 2: holds the byte 0x00, which no text file has"),
    "UTF-16": ("v 0 0 0\n".encode("utf-16"), ", line 1: holds the byte 0x00, .* UTF-16"),
    "PNG": (b"\x89PNG\r\n\x1a\n\x00\x00", ", line 2: holds the byte 0x1a"),
    "PLY": (ply(POINTS + "3 0 1 2\n"), ", line 1: 'ply' does not begin a line that is supported"),
    "long line": (b"v" + b" " * (1 << 21), ", line 1: the line is longer than"),
}
BAD_PLY = {
    "empty": (b"", ", line 1: a PLY file begins with a line \"ply\", got b''"),
    "text": (b"hello", ", line 1: a PLY file begins with a line \"ply\", got b'hello'"),
    "header cut short": (ply("")[:60], ", line 5: b'prope' is not a line of a header"),
    "no end of header": (b"ply\nformat ascii 1.0\n", ", line 3: the header is cut short, it has no line \"end_header\""),
    "no format": (b"ply\nend_header\n", ", line 2: the header has no line \"format ascii 1.0\""),
    "unknown format": (ply("", "ascii2"), ", line 2: the format must be ascii, .*, got 'format ascii2 1.0'"),
    "unknown line": (b"ply\nformat ascii 1.0\nhello\n", ", line 3: .*hello.* is not a line of a header"),
    "rows": (b"ply\nformat ascii 1.0\nelement vertex -3\n", ", line 3: expected \"element name rows\""),
    "property of nothing": (b"ply\nformat ascii 1.0\nproperty float x\n",
                            ", line 3: a property must follow after the element"),
    "unknown type": (ply("", more="property half a\n"), ", line 7: 'half' is not a type of PLY; .*known: char"),
    "property twice": (ply("", more="property float x\n"), ", line 7: the property 'x' of element 'vertex' is given twice"),
    "element twice": (ply("", more="element vertex 3\n"), ", line 7: the element 'vertex' is given twice"),
    "no properties": (ply("", more="element dust 3\n"), ": the element 'dust' has 3 rows and no properties"),
    "no faces at all": (b"ply\nformat ascii 1.0\nelement vertex 0\nend_header\n", ": the header has no element 'face'"),
    "no rows of faces": (ply(POINTS, faces=0), ": the mesh has 3 vertices and no faces"),
    "triangle strips": (ply("").replace(b"face", b"tristrips"),
                        ": the header has no element 'face'; .*got vertex, tristrips"),
    "no z": (ply("").replace(b"float z", b"float w"), ": element vertex lacks z of x, y, z"),
    "half a normal": (ply("", more="property float nx\n"), ": element vertex lacks ny, nz of nx, ny, nz"),
    "no corners": (ply("").replace(b"vertex_indices", b"corner"),
                   ": element face needs one list of integers called vertex_index"),
    "uv per face": (ply("").replace(b"end_h", b"property list uchar float texcoord\nend_h"),
                    ": .*per face; export them per vertex"),
    "vertices cut short": (ply("0 0 0\n1 0"), ", line 11: a row of element 'vertex' has 3 numbers here, got 2"),
    "faces cut short": (ply(POINTS + "3 0 1 2\n", faces=2), ": cut short, it has 1 of the 2 rows of element 'face'"),
    "face cut short": (ply(POINTS + "3 0 1\n"), ", line 13: a row of element 'face' has 4 numbers here, got 3"),
    "face too long": (ply(POINTS + "3 0 1 2 0\n"), ", line 13: a row of element 'face' has 4 numbers here, got 5"),
    "file too long": (ply(POINTS + "3 0 1 2\n3 0 1 2\n"), ", line 14: follows after the last element"),
    "negative count": (ply(POINTS + "-1\n"), ", line 13: a list of -1 entries"),
    "index out of range": (ply(POINTS + "3 0 1 3\n"), ", line 13: faces must index vertices 0 to 2, got 3"),
    "negative index": (ply(POINTS + "3 0 1 -1\n"), ", line 13: faces must index vertices 0 to 2, got -1"),
    "fraction": (ply(POINTS + "3 0 1 1.5\n"), ", line 13: faces must index vertices 0 to 2, got 1.5"),
    "word": (ply("0 0 zero\n"), ", line 10: expected a finite number, got 'zero'"),
    "nan": (ply(POINTS.replace("1 0 0", "1 nan 0") + "3 0 1 2\n"), ", line 11: vertices must be finite, 1 of 3 are NaN"),
    "binary in ascii": (ply(BINARY), ", line 10: holds the byte 0x00"),
    "binary vertices cut short": (ply(BINARY[:30], LITTLE), ": cut short, it ends in row 2 of the 3 rows of"),
    "binary faces cut short": (ply(BINARY + b"\x03\0\0\0\0\1\0", LITTLE), ": cut short, it ends in row 0 of the 1"),
    "binary second face cut short": (ply(BINARY + struct.pack("<B3iB2i", 3, 0, 1, 2, 3, 0, 1), LITTLE, faces=2),
                                     ": cut short, it ends in row 1 of the 2 rows of element 'face'"),
    "binary file too long": (ply(BINARY + FACE + b"\n", LITTLE), ": 1 bytes follow"),
    "wrong byte order": (ply(BINARY + FACE, BIG), r", face 0 .*: faces must index"),
    "binary nan": (ply(b"\0\0\xc0\x7f" + BINARY[4:] + FACE, LITTLE),
                   r", vertex 0 \(from 0\): vertices must be finite, 1 of 3"),
    "fractional count": (ply(POINTS + "2.5 0 1 2\n", count="float"), ", line 13: a list of 2.5 entries"),
    "fractional binary count": (ply(BINARY + struct.pack("<f3i", 2.5, 0, 1, 2), LITTLE, count="float"),
                                r", face 0 \(from 0\): a list cannot have 2.5 entries"),
    "nan binary count": (ply(BINARY + struct.pack("<f3i", float("nan"), 0, 1, 2), LITTLE, count="float"),
                         r", face 0 \(from 0\): a list cannot have nan entries"),
    "faces of two corners only": (ply(POINTS + "2 0 1\n"), ": the mesh has no face of 3 corners or more"),
    "negative binary count": (ply(BINARY + struct.pack("<b3i", -3, 0, 1, 2), LITTLE, count="char"),
                              r", face 0 \(from 0\): a list cannot have -3 entries"),
    "more rows than bytes": (ply(BINARY, LITTLE, faces=999999999999), ": cut short, it ends in row 0 of the"),
    "huge count": (ply(BINARY + struct.pack("<I3i", 2**32 - 1, 0, 1, 2), LITTLE, count="uint"), ": cut short"),
}


def check_refusal(path, content, message):
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(ValueError, match=rf"{path.name}({message})") as caught:
        read_mesh(path)
    assert str(caught.value).startswith(str(path)) and "\n" not in str(caught.value)


@pytest.mark.parametrize("case", BAD_OBJ)
def test_bad_obj_files_are_refused_with_their_line(tmp_path, case):
    check_refusal(tmp_path / "m.obj", *BAD_OBJ[case])


@pytest.mark.parametrize("case", BAD_PLY)
def test_bad_ply_files_are_refused_with_their_line(tmp_path, case):
    check_refusal(tmp_path / "m.ply", *BAD_PLY[case])


@pytest.mark.parametrize("name, error, message", [
    ("gone.obj", FileNotFoundError, "file not found"),
    ("folder.ply", IsADirectoryError, "is a folder, not a file"),
    ("pipe.obj", OSError, "is not an ordinary file"),
    ("m.stl", ValueError, r"unknown kind of mesh '\.stl'; supported: \.obj, \.ply"),
    ("x" * 300 + ".obj", FileNotFoundError, "file not found"),
])
def test_what_is_no_mesh_file_is_named(tmp_path, name, error, message):
    (tmp_path / "folder.ply").mkdir()
    os.mkfifo(tmp_path / "pipe.obj")
    with pytest.raises(error, match=f"{name}: {message}"):
        read_mesh(tmp_path / name)


TRIANGLE = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
GOOD_OBJ = {
    "relative indices": CORNERS + "f -3 -2 -1\nv 5 5 5\n",
    "relative uv": CORNERS + "vt 0 0\nvt 1 0\nvt 0 1\nf -3/-3 -2/-2 -1/-1\n",
    "later vertices": "f 1 2 3\n" + CORNERS,
    "byte-order mark": "\N{ZERO WIDTH NO-BREAK SPACE}" + CORNERS + "f 1 2 3\n",
    "line ends of Windows": (CORNERS + "f 1 2 3\n").replace("\n", "\r\n"),
    "no line end at the end": CORNERS + "f 1 2 3",
    "comments": "# a\nv 0 0 0 # b\nv 1 0 0#c\nv 0 1 0\nf 1 2 3 # d \\\n#e",
    "continued lines": "v 0 \\\n 0 0\nv 1 0\\\n 0\nv 0 1 0\nf 1 2 \\ \r\n3\n",
    "blanks and tabs": "  v\t0  0\t0 \n\n\n\tv 1 0 0\n v 0 1 0\nf\t1 2  3  \n",
    "exponents": "v 0e5 -0 .0\nv 100e-2 0. 0\nv 0 +1.000000000000000000000 0\nf 1 2 3\n",
    "weights and colours": "v 0 0 0 1\nv 1 0 0 .5 .5 .5\nv 0 1 0 1 0 0 0\nf 1 2 3\n",
    "materials and groups": "mtllib gone.mtl\no a\ng b c\nusemtl x\ns off\n" + CORNERS + "l 1 2\np 1\nf 1 2 3\n",
}
GOOD_PLY = {
    "ascii": ply(POINTS + "3 0 1 2\n"),
    "blank lines": ply("\n" + POINTS.replace("\n", "\n\n") + "3 0 1 2\n\n"),
    "line ends of Windows": ply(POINTS + "3 0 1 2\n").replace(b"\n", b"\r\n"),
    "colours": ply("0 0 0 255\n1 0 0 9\n0 1 0 7\n3 0 1 2\n", more="property uchar red\n"),
    "an element more": ply("0 0 0\n1 0 0\n0 1 0\n2 5 6 1\n0 7\n3 0 1 2\n", more=DUST),
    "little-endian": ply(BINARY + FACE, LITTLE),
    "big-endian": ply(struct.pack(">9fB3i", 0, 0, 0, 1, 0, 0, 0, 1, 0, 3, 0, 1, 2), BIG),
    "an element more, binary": ply(BINARY + struct.pack("<iiii", 2, 5, 6, 1) + struct.pack("<ii", 0, 7) +
                                   FACE, LITTLE,
                                   more=DUST),
}


@pytest.mark.parametrize("name, content", [*((f"{case}.obj", text) for case, text in GOOD_OBJ.items()),
                                           *((f"{case}.ply", content) for case, content in GOOD_PLY.items())])
def test_what_the_formats_allow_is_read(tmp_path, name, content):
    (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    mesh = read_mesh(tmp_path / name)
    assert mesh.vertices.tolist() == TRIANGLE and mesh.faces.tolist() == [[0, 1, 2]] and mesh.normals is None
    assert mesh.uv is None or mesh.uv.tolist() == [[0, 0], [1, 0], [0, 1]]


MIXED = [[0, 1, 2], [0, 1, 2, 3], [2, 1, 0], [0, 1, 2, 3, 4]]
MIXED_FANS = [[0, 1, 2], [0, 1, 2], [0, 2, 3], [2, 1, 0], [0, 1, 2], [0, 2, 3], [0, 3, 4]]


@pytest.mark.parametrize("kind", ["ascii", LITTLE, "binary_big_endian", "obj"])
def test_polygons_become_fans_in_their_order(tmp_path, kind):
    points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (-1, 0.5, 0)]
    order = {"binary_little_endian": "<", "binary_big_endian": ">"}.get(kind)
    if kind == "obj":
        text = "".join(f"v {x} {y} {z}\n" for x, y, z in points)
        content = (text + "".join(f"f {' '.join(str(i + 1) for i in face)}\n" for face in MIXED)).encode()
    elif kind == "ascii":
        body = "".join(f"{x} {y} {z}\n" for x, y, z in points)
        content = ply(body + "".join(f"{len(face)} {' '.join(map(str, face))}\n" for face in MIXED), faces=4)
    else:
        body = b"".join(struct.pack(f"{order}3f", *point) for point in points)
        content = ply(body + b"".join(struct.pack(f"{order}B{len(face)}i", len(face), *face) for face in MIXED), kind,
                      faces=4)
    path = tmp_path / ("m.obj" if kind == "obj" else "m.ply")
    path.write_bytes(content.replace(b"element vertex 3", b"element vertex 5"))
    mesh = read_mesh(path)
    assert mesh.faces.tolist() == MIXED_FANS and mesh.vertices.tolist() == [list(point) for point in points]


def test_blocks_of_a_file_fit_together(tmp_path, monkeypatch):
    """Relative indices, continued lines and line numbers are right wherever the blocks are cut."""
    text = "".join(f"v {i} {i % 7} {i * i % 5} \\\n\nvt {i} 0\nf -1/-1 -{min(i, 2) + 1}/-1 1/1\n" for i in range(40))
    text = text.replace("f -1/-1 -1/-1 1/1\n", "\n").replace("f -1/-1 -2/-1 1/1\n", "\n")
    (tmp_path / "m.obj").write_text(text)
    whole = read_mesh(tmp_path / "m.obj")
    (tmp_path / "bad.obj").write_text(text + "f 1/1 2/2 77/1\n")
    line = text.count("\n") + 1
    for size in (1, 7, 64, 1000):
        monkeypatch.setattr("torch_radbp.formats.text_lines.BLOCK", size)
        for a, b in zip(whole, read_mesh(tmp_path / "m.obj")):
            np.testing.assert_array_equal(a, b)
        with pytest.raises(ValueError, match=rf"bad\.obj, line {line}: the vertex index 77"):
            read_mesh(tmp_path / "bad.obj")


@pytest.mark.parametrize("option", ["face_normals", "recompute_normals"])
def test_normals_that_are_not_wanted_need_not_be_usable(tmp_path, option):
    (tmp_path / "m.obj").write_text(CORNERS + "vn 0 0 0\nf 1//1 2//1 3\n")
    scene = load_dict(scene_dict(m={"type": "obj", "filename": "m.obj", option: True}), base_dir=tmp_path)
    assert scene.get_parameter("m.vertex_positions").shape == (3, 3)


def test_positions_beyond_single_precision_are_refused_by_name(tmp_path):
    (tmp_path / "m.obj").write_text(CORNERS.replace("v 1 0 0", "v 1e39 0 0") + "f 1 2 3\n")
    with pytest.raises(ValueError, match="m.*: vertex_positions must be finite, got 1 of 9 .* in float32"):
        load_dict(scene_dict(m={"type": "obj", "filename": "m.obj"}), base_dir=tmp_path)
