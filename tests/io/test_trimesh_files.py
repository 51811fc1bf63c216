"""Files of the formats that trimesh reads: a mesh comes back as it was, and what cannot be read is said."""

import io
import tarfile
import warnings
import zipfile
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

import torch_radbp as rb
from torch_radbp.plugin import SceneError

OTHERS = {"camera": {"type": "perspective", "to_world": rb.look_at([0.5, 3, 4], [0, 0, 0], [0, 1, 0]),
                     "film": {"type": "hdrfilm", "width": 16, "height": 16}}, "sky": {"type": "constant"}}
NEEDS = {"dae": "collada", "zae": "collada", "3mf": "lxml", "xaml": "lxml"}


def body() -> trimesh.Trimesh:
    """A closed mesh that no rotation and no mirror maps to itself."""
    mesh = trimesh.creation.icosphere(1)
    return trimesh.Trimesh(mesh.vertices * (1, 0.6, 1.4) + 0.2 * mesh.vertices[:, [1, 2, 0]], mesh.faces, process=False)


def exported(kind: str) -> Callable[[trimesh.Trimesh, Path], Path]:
    def write(mesh: trimesh.Trimesh, folder: Path) -> Path:
        mesh.export(folder / f"part.{kind.removesuffix('_ascii')}", file_type=kind)
        return folder / f"part.{kind.removesuffix('_ascii')}"
    return write


def gltf(mesh: trimesh.Trimesh, folder: Path) -> Path:
    for name, content in mesh.export(file_type="gltf").items():
        (folder / name).write_bytes(content)
    return folder / "model.gltf"


def zipped(name: str, inner: str) -> Callable[[trimesh.Trimesh, Path], Path]:
    def write(mesh: trimesh.Trimesh, folder: Path) -> Path:
        with zipfile.ZipFile(folder / name, "w") as archive:
            archive.writestr(f"part.{inner}", mesh.export(file_type=inner))
        return folder / name
    return write


def tarred(name: str, mode: str) -> Callable[[trimesh.Trimesh, Path], Path]:
    def write(mesh: trimesh.Trimesh, folder: Path) -> Path:
        content = mesh.export(file_type="stl")
        with tarfile.open(folder / name, mode) as archive:
            entry = tarfile.TarInfo("part.stl")
            entry.size = len(content)
            archive.addfile(entry, io.BytesIO(content))
        return folder / name
    return write


def xaml(mesh: trimesh.Trimesh, folder: Path) -> Path:
    """trimesh does not write XAML."""
    def text(values: np.ndarray) -> str:
        return " ".join(",".join(str(number) for number in row) for row in values.tolist())

    (folder / "part.xaml").write_text(
        '<Model3DGroup xmlns="http://schemas.microsoft.com/winfx/2006/xaml/presentation"><GeometryModel3D>'
        f'<GeometryModel3D.Geometry><MeshGeometry3D Positions="{text(mesh.vertices)}" Normals="{text(mesh.vertex_normals)}" '
        f'TriangleIndices="{text(mesh.faces)}"/></GeometryModel3D.Geometry></GeometryModel3D></Model3DGroup>')
    return folder / "part.xaml"


FORMATS: dict[str, Callable[[trimesh.Trimesh, Path], Path]] = {
    **{kind: exported(kind) for kind in ("stl", "stl_ascii", "off", "glb", "dae", "3mf", "obj", "ply")}, "gltf": gltf,
    "zae": zipped("part.zae", "dae"), "zip": zipped("part.zip", "off"), "tar.gz": tarred("part.tar.gz", "w:gz"),
    "xaml": xaml}


def corners(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(F, 9) the corners of triangles, each from its first corner in x on, sorted: what a file may not change."""
    triangles = np.round(vertices[faces], 4)
    first = triangles[:, :, 0].argmin(1)
    turned = np.stack([triangles[np.arange(len(faces)), (first + step) % 3] for step in range(3)], 1).reshape(len(faces), 9)
    return turned[np.lexsort(turned.T)]


def part_of(path: Path, **attributes) -> dict:
    kind = path.suffix[1:] if path.suffix in (".obj", ".ply") else "mesh"
    return {"type": kind, "filename": str(path), **attributes}


@pytest.mark.parametrize("kind", FORMATS)
def test_a_mesh_goes_through_a_file_into_a_scene_and_back(kind, tmp_path):
    """Read by `filename`, given back by `to_trimesh`, written by trimesh, and read again: the same triangles each time."""
    if kind in NEEDS and find_spec(NEEDS[kind]) is None:
        pytest.skip(f"trimesh reads {kind} with {NEEDS[kind]}, of the extra `test`")
    mesh, again = body(), tmp_path / "again"
    again.mkdir()
    for folder in (tmp_path, again):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", rb.SceneWarning)  # of the material; see test_to_trimesh
            scene = rb.load_dict({"type": "scene", "part": part_of(FORMATS[kind](mesh, folder)), **OTHERS})
            mesh = scene.part.to_trimesh()
        assert len(mesh.vertices) == 42  # one for each place, also where the file has one for each corner
        # Text has 4 digits or more, see `corners`; 2e-4 is a last digit that is rounded to either side.
        np.testing.assert_allclose(corners(mesh.vertices, mesh.faces), corners(body().vertices, body().faces), atol=2e-4)


def test_the_formats_are_twelve_or_more():
    assert len(FORMATS) >= 12


def test_a_file_of_xml_scenes_too(tmp_path):
    exported("stl")(body(), tmp_path)
    (tmp_path / "scene.xml").write_text("""<scene version="3.0.0"><shape type="mesh" id="part">
        <string name="filename" value="part.stl"/><bsdf type="diffuse"/></shape><emitter type="constant"/>
        <sensor type="perspective"/></scene>""")
    assert rb.load(tmp_path / "scene.xml").part.vertex_positions.shape == (42, 3)


def test_what_a_file_says_of_its_material_is_read_unless_a_bsdf_is_given(tmp_path):
    mesh = body()
    mesh.visual = trimesh.visual.TextureVisuals(material=trimesh.visual.material.PBRMaterial(
        name="gold", baseColorFactor=[255, 128, 0, 255], metallicFactor=0.5, roughnessFactor=0.25))
    path = exported("glb")(mesh, tmp_path)
    scene = rb.load_dict({"type": "scene", "own": part_of(path), **OTHERS,
                          "other": part_of(path, bsdf={"type": "diffuse", "reflectance": 0.25})})
    assert (scene.own.bsdf.metallic.value, scene.own.bsdf.roughness.value) == (0.5, 0.25)
    assert scene.own.bsdf.base_color.value.tolist() == pytest.approx([1, 128 / 255, 0])
    assert scene.other.bsdf.reflectance.value == 0.25


def parts(*colours: int) -> trimesh.Scene:
    """Bodies side by side, each of its own red."""
    scene = trimesh.Scene()
    for number, red in enumerate(colours):
        mesh = body()
        mesh.visual = trimesh.visual.TextureVisuals(material=trimesh.visual.material.PBRMaterial(
            baseColorFactor=[red, 0, 0, 255]))
        scene.add_geometry(mesh, transform=trimesh.transformations.translation_matrix([3 * number, 0, 0]))
    return scene


def test_several_meshes_of_a_file_become_one_shape_of_their_material(tmp_path):
    parts(200, 200).export(tmp_path / "part.glb")
    scene = rb.load_dict({"type": "scene", "part": part_of(tmp_path / "part.glb"), **OTHERS})
    assert scene.part.faces.shape == (160, 3) and scene.part.vertex_positions[:, 0].max() > 3


@pytest.mark.hostile
def test_several_materials_of_a_file_ask_for_one(tmp_path):
    parts(200, 100).export(tmp_path / "part.glb")
    with pytest.raises(SceneError, match=r"part .*one shape has one material, and the 2 meshes have several: give a bsdf"):
        rb.load_dict({"type": "scene", "part": part_of(tmp_path / "part.glb"), **OTHERS})
    part = part_of(tmp_path / "part.glb", bsdf={"type": "diffuse"})
    assert rb.load_dict({"type": "scene", "part": part, **OTHERS}).part.faces.shape == (160, 3)


def refusal(path: Path, **attributes) -> str:
    with pytest.raises(SceneError) as error:
        rb.load_dict({"type": "scene", "part": {"type": "mesh", "filename": str(path), **attributes}, **OTHERS})
    return str(error.value)


@pytest.mark.hostile
@pytest.mark.parametrize("name, content, words", [
    ("part.obj", b"v 0 0 0", "read by the shape type 'obj'"),
    ("part.ply", b"ply", "read by the shape type 'ply'"),
    ("part.blend", b"BLENDER", "unknown kind of mesh '.blend'; supported: .obj, .ply, .serialized, .3dxml, .3mf,"),
    ("part.stl", b"solid nothing", "part.stl: "),
    ("part.off", b"OFF 3 1 0\n0 0 0\n1 0 0", "trimesh cannot read it as .off"),
    ("part.off", b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 nan 0\n3 0 1 2\n", "1 of 3 vertices are NaN or infinite"),
    ("part.xyz", b"0 0 0\n1 1 1\n", "no triangles"),
    ("part.off", b"OFF\n3 1 0\n0 0 0\n1 0 0\n2 0 0\n3 0 1 2\n", "degenerate")],
    ids=["OBJ", "PLY", "unknown", "empty", "cut short", "NaN", "points", "no area"])
def test_a_file_that_cannot_be_used_is_named(name, content, words, tmp_path):
    (tmp_path / name).write_bytes(content)
    message = refusal(tmp_path / name)
    assert words in message and name in message


@pytest.mark.hostile
@pytest.mark.parametrize("kind, package", [("dae", "pycollada"), ("3mf", "lxml networkx"), ("step", "cascadio"),
                                           ("ctm", "openctm")])
def test_a_package_that_trimesh_lacks_is_named(kind, package, tmp_path, monkeypatch):
    def missing(*arguments, **settings):
        raise ImportError("No module named 'some_module'")

    monkeypatch.setitem(trimesh.exchange.load.mesh_loaders, kind, missing)
    (tmp_path / f"part.{kind}").write_bytes(b"anything")
    assert refusal(tmp_path / f"part.{kind}").endswith(f"trimesh reads .{kind} files with {package}: pip install {package}")


@pytest.mark.hostile
def test_a_mesh_is_given_in_one_way(tmp_path):
    assert "needs vertex_positions and faces, or a mesh of trimesh, or a filename, got mesh, filename" in refusal(
        exported("stl")(body(), tmp_path), mesh=body())
    assert "got vertex_positions, faces, filename" in refusal(
        exported("stl")(body(), tmp_path), vertex_positions=torch.eye(3), faces=torch.tensor([[0, 1, 2]]))
    with pytest.raises(SceneError, match="got none of them"):
        rb.load_dict({"type": "scene", "part": {"type": "mesh"}, **OTHERS})
    with pytest.raises(SceneError, match="mesh must be a trimesh.Trimesh or a trimesh.Scene, got 'part'"):
        rb.load_dict({"type": "scene", "part": {"type": "mesh", "mesh": "part"}, **OTHERS})
