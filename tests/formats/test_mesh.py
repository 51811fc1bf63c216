"""Meshes are numbered as in Mitsuba, in and out."""

import numpy as np
import pytest
import torch

from tests.io.documents import TRIANGLE_OBJ
from torch_radbp.formats.mesh import read_mesh
from torch_radbp.formats.mesh_arrays import MeshArrays
from torch_radbp.formats.ply import write_ply
from torch_radbp.shape.normals import angle_weighted_normals

SEAM = """v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0.5
v 9 9 9
vt 0 0
vt 1 0
vt 1 1
vt 0 1
vt .25 .25
f 1/1 2/2 3/3
f 1/5 3/3 4/4
"""
TWO_OBJECTS = """o a
usemtl red
v 0 0 0
v 1 0 0
v 1 1 0
vn 0 0 1
f 1//1 2//1 3//1
o b
usemtl blue
v 0 1 0.5
vn 0 1 0
f 1//2 2//2 4//2
g c
usemtl red
f 2//1 3//1 4//1
"""
POLYGONS = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv -1 .5 0\nv -1 .5 1\nf 1 2 3 4 5\nf 1 2 6\nf 1 2 3 6\n"
PLY = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
property float {u}
property float {v}
element face 2
property list uchar int {indices}
end_header
0 0 0 0 0
1 0 0 1 0
1 1 0 1 1
0 1 0.5 0 1
3 0 1 2
3 0 2 3
"""
MESHES = {
    "seam.obj": SEAM,
    "two.obj": TWO_OBJECTS,
    "polygons.obj": POLYGONS,
    "uv.ply": PLY.format(u="u", v="v", indices="vertex_indices"),
    "st.ply": PLY.format(u="s", v="t", indices="vertex_index"),
}


def of_mitsuba(path, **options):
    mi = pytest.importorskip("mitsuba")
    mi.set_variant("scalar_rgb")
    shape = mi.load_dict({"type": path.suffix[1:], "filename": str(path), **options})
    values = mi.traverse(shape)
    return {name: np.array(values[name]).reshape(-1, width) for name, width in
            (("vertex_positions", 3), ("vertex_normals", 3), ("vertex_texcoords", 2), ("faces", 3))}


def smooth_normals(vertices, faces):
    return angle_weighted_normals(torch.from_numpy(vertices), torch.from_numpy(faces)).numpy()


def smallest_first(faces):
    """Triangles turned so that their smallest index comes first: quads may be cut from another corner."""
    turn = (faces.argmin(axis=1)[:, None] + np.arange(3)) % 3
    return np.take_along_axis(faces, turn, axis=1)


@pytest.mark.parametrize("name", MESHES)
def test_meshes_are_numbered_as_in_mitsuba(tmp_path, name):
    path = tmp_path / name
    path.write_text(MESHES[name])
    mesh, theirs = read_mesh(path), of_mitsuba(path, flip_tex_coords=False)
    np.testing.assert_array_equal(smallest_first(mesh.faces), smallest_first(theirs["faces"]))
    np.testing.assert_array_equal(mesh.vertices, theirs["vertex_positions"])
    assert mesh.faces.dtype == np.int64 and mesh.vertices.dtype == np.float64
    uv = np.empty((0, 2)) if mesh.uv is None else mesh.uv
    np.testing.assert_array_equal(uv, theirs["vertex_texcoords"])
    normals = smooth_normals(mesh.vertices, mesh.faces) if mesh.normals is None else mesh.normals
    np.testing.assert_allclose(normals, theirs["vertex_normals"], atol=1e-6)
    assert (mesh.normals is not None) == (name == "two.obj")


@pytest.mark.parametrize("name", MESHES)
def test_written_meshes_are_read_back_here_and_in_mitsuba(tmp_path, name):
    (tmp_path / name).write_text(MESHES[name])
    mesh = read_mesh(tmp_path / name)
    write_ply(tmp_path / "out.ply", mesh)
    for before, after in zip(mesh, read_mesh(tmp_path / "out.ply")):
        assert (before is None and after is None) or np.array_equal(before, after)
    theirs = of_mitsuba(tmp_path / "out.ply")
    np.testing.assert_array_equal(theirs["vertex_positions"], mesh.vertices)
    np.testing.assert_array_equal(theirs["faces"], mesh.faces)


def test_single_precision_stays_single(tmp_path):
    mesh = read_mesh_of(tmp_path, TRIANGLE_OBJ)
    write_ply(tmp_path / "out.ply", mesh._replace(vertices=mesh.vertices.astype("f4")))
    assert b"property float x" in (tmp_path / "out.ply").read_bytes()


def read_mesh_of(tmp_path, text, name="mesh.obj"):
    (tmp_path / name).write_text(text)
    return read_mesh(tmp_path / name)


def test_smooth_normals_of_a_cube_corner_are_its_diagonal():
    corners = np.array([(x, y, z) for x in (0.0, 1) for y in (0.0, 1) for z in (0.0, 1)])
    quads = np.array([(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)])
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    normals = smooth_normals(corners, faces)  # plain averages would depend on which diagonals are cut
    np.testing.assert_allclose(normals, (2 * corners - 1) / np.sqrt(3), atol=1e-12)


def test_a_vertex_without_a_face_still_has_a_unit_normal():
    normals = smooth_normals(np.eye(4, 3), np.array([[0, 1, 2]]))
    np.testing.assert_array_equal(normals[3], (1, 0, 0))


def test_a_failed_write_leaves_nothing(tmp_path):
    with pytest.raises(ValueError):
        write_ply(tmp_path / "out.ply", MeshArrays(np.zeros((3, 3)), np.zeros((1, 4), "i8"), None, None))
    assert not list(tmp_path.iterdir())
