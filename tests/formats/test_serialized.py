"""Serialized meshes: all that the format can hold is read, and damaged files are refused by name."""

import struct
import zlib

import numpy as np
import pytest
import torch

import torch_radbp as rb
from tests.formats.serialized_files import mesh, serialized
from tests.scenes import load, sensor
from torch_radbp.formats.mesh import read_mesh

VERTICES = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
FACES = np.array([[0, 1, 2], [0, 1, 3]])
TABLES = {"normals": [[0.3, 0, 1], [0, 0.2, 1], [0, 0, 1], [0, 0, 2]], "uv": [[0, 0], [1, 0], [0, 0.5], [0.3, 0.25]],
          "colours": [[0.25, 0.5, 0.75], [0, 0, 1], [1, 1, 1], [0.5, 0, 0]]}


@pytest.mark.parametrize("version", [3, 4])
@pytest.mark.parametrize("double", [False, True])
def test_all_tables_of_all_meshes_are_read(tmp_path, version, double):
    meshes = [mesh(VERTICES * (1 + index), np.roll(FACES, index, 0), version, double, **TABLES if index else {})
              for index in range(3)]
    (tmp_path / "m.dat").write_bytes(serialized(*meshes))
    for index in range(3):
        read = read_mesh(tmp_path / "m.dat", shape_index=index)
        assert np.array_equal(read.vertices, VERTICES * (1 + index))
        assert np.array_equal(read.faces, np.roll(FACES, index, 0))
        if index == 0:
            assert read.normals is None and read.uv is None and not read.attributes
            continue
        exact = np.float64 if double else np.float32
        assert np.array_equal(read.normals, np.array(TABLES["normals"], exact))
        assert np.array_equal(read.uv, np.array(TABLES["uv"], exact))
        assert np.array_equal(read.attributes["vertex_color"], TABLES["colours"])
        assert read_mesh(tmp_path / "m.dat", want_normals=False, shape_index=index).normals is None


def test_a_file_without_a_table_of_its_meshes_has_the_first(tmp_path):
    """Mitsuba does not read the table either."""
    (tmp_path / "m.serialized").write_bytes(mesh(VERTICES, FACES))
    assert np.array_equal(read_mesh(tmp_path / "m.serialized").vertices, VERTICES)


def shape_of(path, **attributes) -> torch.nn.Module:
    return load(sensor=sensor(2), sky={"type": "constant"}, shape={"type": "serialized", "filename": str(path)} | attributes
                ).shape


def test_the_plugin_reads_it_as_mitsuba_does(tmp_path, mi):
    """Parameters by name, with and without normals in the file, and flat; the flag of flat faces is without effect."""
    path = tmp_path / "m.serialized"
    tables = {name: TABLES[name] for name in ("normals", "uv")}
    path.write_bytes(serialized(mesh(VERTICES, FACES, **tables), mesh(2 * VERTICES, FACES, double=True, flags=0x10)))
    for attributes in ({}, {"face_normals": True}, {"shape_index": 1}, {"flip_normals": True, "shape_index": 1}):
        ours = dict(shape_of(path, **attributes).named_parameters(recurse=False))
        theirs = mi.traverse(mi.load_dict({"type": "serialized", "filename": str(path)} | attributes))
        for name in ("vertex_positions", "vertex_normals", "vertex_texcoords"):
            values = np.array(theirs[name])
            assert (name in ours) == (len(values) > 0), (attributes, name)
            if len(values):
                np.testing.assert_allclose(ours[name].detach().numpy().ravel(), values, atol=1e-6)


def test_colours_are_an_attribute(tmp_path):
    (tmp_path / "m.serialized").write_bytes(serialized(mesh(VERTICES, FACES, colours=TABLES["colours"])))
    scene = rb.load_dict({"type": "scene", "camera": sensor(4, (1, 1, 3)), "sky": {"type": "constant"}, "shape": {
        "type": "serialized", "filename": str(tmp_path / "m.serialized"), "bsdf": {"type": "twosided", "inside": {
            "type": "diffuse", "reflectance": {"type": "mesh_attribute", "name": "vertex_color"}}}}})
    colours = scene.get_parameter("shape.vertex_color").requires_grad_()
    rb.render(scene, spp=4).sum().backward()
    assert colours.grad.abs().max() > 0


def damaged(content: bytes, change) -> bytes:
    """A mesh whose uncompressed content is changed."""
    return content[:4] + zlib.compress(change(zlib.decompress(content[4:])))


ONE = mesh(VERTICES, FACES)
TWO = serialized(ONE, mesh(VERTICES, FACES, normals=TABLES["normals"]))
COUNTS = len(b"\0\0\0\0a mesh\0")  # where the numbers of vertices and faces are
BAD = {
    "empty": (b"", 0, ": cut short, a mesh begins with 4 bytes, got 0"),
    "another file": (b"ply\nformat", 0, ": a serialized mesh begins with 0x041c, got 0x6c70"),
    "unknown version": (b"\x1c\x04\x05\0", 0, ": the version must be 3 or 4, got 5"),
    "no data": (ONE[:4], 0, ", mesh 0: cut short, it ends in its flags, which need 4 bytes"),
    "not compressed": (ONE[:4] + b"hello, world", 0, ", mesh 0: the compressed data is damaged"),
    "cut short": (ONE[:30], 0, ", mesh 0: cut short, it ends in its "),
    "no checksum": (ONE[:-2], 0, ", mesh 0: cut short, the end of the compressed data is missing"),
    "wrong checksum": (ONE[:-1] + bytes([ONE[-1] ^ 1]), 0, ", mesh 0: the compressed data is damaged"),
    "unknown flags": (mesh(VERTICES, FACES, flags=0x4), 0, ", mesh 0: its flags 0x1004 are none of the format"),
    "two precisions": (mesh(VERTICES, FACES, double=True, flags=0x1000), 0, ", mesh 0: its flags 0x3000 are none"),
    "endless name": (mesh(VERTICES, FACES, name="x" * 5000), 0, ", mesh 0: its name has no end within 4096 bytes"),
    "no vertices": (mesh([], FACES), 0, ", mesh 0: the mesh has 0 vertices and 2 faces"),
    "no faces": (mesh(VERTICES, []), 0, ", mesh 0: the mesh has 4 vertices and no faces"),
    "more vertices than bytes": (damaged(ONE, lambda data: data[:COUNTS] + struct.pack("<QQ", 1 << 31, 2)), 0,
                                 ", mesh 0: cut short, it ends in its vertices .2147483648 rows., which need"),
    "more faces than bytes": (damaged(ONE, lambda data: data[:-1]), 0, ", mesh 0: cut short, it ends in its faces .2 rows."),
    "too long": (damaged(ONE, lambda data: data + b"\0"), 0, ", mesh 0: more follows after its faces"),
    "index out of range": (mesh(VERTICES, [[0, 1, 2], [0, 1, 4]]), 0,
                           r", mesh 0, face 1 \(from 0\): faces must index vertices 0 to 3, got 4"),
    "nan": (mesh([[0, 0, 0], [0, np.nan, 0], [1, 0, 0], [0, 1, 0]], FACES), 0,
            r", mesh 0, vertex 1 \(from 0\): vertices must be finite, 1 of 4"),
    "no area": (mesh(VERTICES, [[0, 1, 1]]), 0, ": all 1 triangles are degenerate"),
    "no such mesh": (TWO, 2, ": shape_index must be from 0 to 1, got 2"),
    "damaged table": (TWO[:-12] + struct.pack("<QI", 1 << 40, 2), 1, ": the table of its meshes is damaged, mesh 1 begins"),
    "no table": (ONE, 1, ": the table of its meshes is damaged or cut short"),
    "table of nothing": (ONE + bytes(4), 1, ": the table of its meshes is damaged or cut short, it has 0 of them"),
    "table that points elsewhere": (TWO[:-12] + struct.pack("<QI", 7, 2), 1, ", mesh 1: a serialized mesh begins with"),
}


@pytest.mark.hostile
@pytest.mark.parametrize("case", BAD)
def test_damaged_files_are_refused(tmp_path, case):
    content, shape_index, message = BAD[case]
    (tmp_path / "m.serialized").write_bytes(content)
    with pytest.raises(ValueError, match=f"m.serialized({message})") as caught:
        read_mesh(tmp_path / "m.serialized", shape_index=shape_index)
    assert str(caught.value).startswith(str(tmp_path)) and "\n" not in str(caught.value)


@pytest.mark.hostile
def test_every_byte_may_be_wrong(tmp_path):
    """No change of a byte, and no end of the file, gives anything but a mesh or a ValueError."""
    path = tmp_path / "m.serialized"
    for at in range(len(TWO)):
        for content in (TWO[:at], TWO[:at] + bytes([TWO[at] ^ 0x55]) + TWO[at + 1:]):
            path.write_bytes(content)
            for shape_index in (0, 1):
                try:
                    assert np.isfinite(read_mesh(path, shape_index=shape_index).vertices).all()
                except ValueError as error:
                    assert "m.serialized" in str(error)


@pytest.mark.parametrize("attributes, message", [
    ({"shape_index": -1}, "shape_index must be an integer of at least 0, got -1"),
    ({"shape_index": 1.5}, "shape_index must be an integer, got 1.5"),
    ({"shape_index": 7}, "shape_index must be from 0 to 1, got 7"),
    ({"flip_tex_coords": True}, "serialized has no attribute 'flip_tex_coords'"),
])
def test_bad_attributes(tmp_path, attributes, message):
    (tmp_path / "m.serialized").write_bytes(TWO)
    with pytest.raises(rb.SceneError, match=message):
        shape_of(tmp_path / "m.serialized", **attributes)
