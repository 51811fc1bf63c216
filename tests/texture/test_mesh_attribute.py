"""Attributes of meshes as textures: their values, where they come from, and their derivatives."""

import numpy as np
import pytest
import torch

import torch_radbp as rb
from tests.deep import deep
from tests.gradients import MEMOIZED, QUADRATIC, cotangent, image_and_gradients, relative_error
from tests.scenes import load, rectangle, rgb, sensor
from tests.scenes.mesh_attributes import PLY, add_attributes, tetrahedron
from torch_radbp.formats.mesh import read_mesh
from torch_radbp.formats.ply_attributes import attributes_in

pytestmark = pytest.mark.filterwarnings("ignore::torch_radbp.SilhouetteWarning")
SETTINGS = {"spp": 4, "max_depth": 4, "rr_depth": 2}
TOLERANCE = 1e-10


def attribute(name: str, **others) -> dict:
    return {"type": "mesh_attribute", "name": name} | others


def glowing(texture: dict, folder, x: float, y: float) -> rb.Scene:
    """A mesh from a file that emits what it carries, of which the camera sees the point (x, y)."""
    (folder / "mesh.ply").write_text(PLY)
    emitter = {"type": "area", "radiance": texture}
    return load(sensor=sensor(1, (x, y, 3), (x, y, 0), 1e-3),
                mesh={"type": "ply", "filename": str(folder / "mesh.ply"), "emitter": emitter})


VALUES = [  # at (0.3, -0.5), (-0.2, 0.4), (0.9, 0.1)
    (attribute("vertex_color"), [[0.21999998, 0.32499999, 0.30000001], [0.1, 0.39999995, 0.48000008],
                                 [0.22000001, 0.47499999, 0.30000001]]),
    (attribute("face_tint_color", scale=2.0), [[0.2, 0.4, 0.6], [0.8, 1.0, 1.2], [0.2, 0.4, 0.6]]),
    (attribute("vertex_rough"), [[0.59] * 3, [0.67] * 3, [0.65] * 3]),
    (attribute("face_amount", scale=0.5), [[0.125] * 3, [0.375] * 3, [0.125] * 3]),
]


@pytest.mark.parametrize("texture, expected", VALUES, ids=[texture["name"] for texture, _ in VALUES])
def test_values_are_those_of_mitsuba(texture, expected, tmp_path):
    """Printed by Mitsuba 3.9.1, `scalar_rgb`, with PLY of `tests/scenes/mesh_attributes.py` in mesh.ply:

        scene = mi.load_dict({"type": "scene", "mesh": {"type": "ply", "filename": "mesh.ply"}})
        for x, y in ((0.3, -0.5), (-0.2, 0.4), (0.9, 0.1)):
            print(mi.load_dict(texture).eval(scene.ray_intersect(mi.Ray3f([x, y, 3], [0, 0, -1]))))
    """
    found = [rb.render(glowing(texture, tmp_path, *place), spp=1, max_depth=1)[0, :, 0, 0].tolist()
             for place in ((0.3, -0.5), (-0.2, 0.4), (0.9, 0.1))]
    np.testing.assert_allclose(found, expected, atol=2e-5)  # the pixel has a size


@pytest.mark.parametrize("names, expected", [
    ("x y z r g b", {"color": ("r", "g", "b")}),
    ("red green blue", {"color": ("red", "green", "blue")}),
    ("c_x", {"c": ("c_x",)}),
    ("c_1 c_2 c_3", {"c": ("c_1", "c_2", "c_3")}),
    ("c_0 c_1 c_2", {"c": ("c_0", "c_1", "c_2")}),  # as Mitsuba writes them
    ("tint_r tint_g tint_b", {"tint_color": ("tint_r", "tint_g", "tint_b")}),
    ("vertex_c_r", {"vertex_c_color": ("vertex_c_r",)}),
    ("nx ny nz u v c_r", {"c_color": ("c_r",)}),
    ("rough x1 x2 temp_x temp_y a rough_a", {}),
])
def test_attributes_have_the_names_of_mitsuba(names, expected):
    """Printed by Mitsuba 3.9.1, `scalar_rgb`, of a PLY file whose vertices have these properties behind x, y, z:

        print(mi.traverse(mi.load_dict({"type": "ply", "filename": ...})).keys())
    """
    assert attributes_in(names.split()) == expected


def binary(text: str, kind: str) -> bytes:
    """The mesh as a binary file, with a polygon of four corners if `kind` is ragged."""
    header, body = text.split("end_header\n")
    rows = [row.split() for row in body.splitlines()]
    if kind == "ragged":
        header = header.replace("element face 2", "element face 3")
        rows.append("4 0 1 2 3 0.7 0.8 0.9 0.5".split())
    data = b"".join(np.array(row, "<f4").tobytes() for row in rows[:4])
    for row in rows[4:]:
        corners = int(row[0])
        data += np.uint8(corners).tobytes() + np.array(row[1:1 + corners], "<i4").tobytes()
        data += np.array(row[1 + corners:], "<f4").tobytes()
    return header.replace("ascii", "binary_little_endian").encode() + b"end_header\n" + data


@pytest.mark.parametrize("kind", ["ascii", "even", "ragged"])
def test_every_kind_of_ply_file_brings_its_attributes(kind, tmp_path):
    (tmp_path / "mesh.ply").write_bytes(PLY.encode() if kind == "ascii" else binary(PLY, kind))
    mesh = read_mesh(tmp_path / "mesh.ply")
    assert sorted(mesh.attributes) == ["face_amount", "face_tint_color", "vertex_color", "vertex_rough"]
    amounts = [0.25, 0.75] + [0.5, 0.5] * (kind == "ragged")  # a polygon becomes two triangles
    np.testing.assert_allclose(mesh.attributes["face_amount"][:, 0], amounts)
    np.testing.assert_allclose(mesh.attributes["face_tint_color"][1], [0.4, 0.5, 0.6], rtol=1e-6)
    np.testing.assert_allclose(mesh.attributes["vertex_color"][3], [0.1, 0.2, 0.9], rtol=1e-6)


def room(dtype: torch.dtype = torch.float64) -> rb.Scene:
    """A mesh whose attributes are its colour and its roughness, and another that emits its own."""
    bsdf = {"type": "roughplastic", "alpha": 0.3, "diffuse_reflectance": attribute("vertex_color", scale=0.9),
            "specular_reflectance": attribute("face_amount")}
    lamp = tetrahedron(to_world=[[0.4, 0, 0, 0], [0, 0.4, 0, 1.6], [0, 0, 0.4, 0.9], [0, 0, 0, 1]],
                       emitter={"type": "area", "radiance": attribute("vertex_color", scale=8.0)})
    scene = load(dtype, sensor=sensor(5, (0, 1.2, 3), (0, -0.1, 0), 45), subject=tetrahedron(bsdf=bsdf), lamp=lamp,
                 floor=rectangle((0, -0.5, 0), 1.3, angle=-90))
    scene.lamp.add_attribute("vertex_color", torch.linspace(0.2, 0.9, 12, dtype=dtype).reshape(4, 3))
    return add_attributes(scene).to(dtype)


NAMES = [name for name, _ in room().named_parameters() if "vertex_color" in name or "face_amount" in name
         or name.endswith("scale")]


@pytest.mark.parametrize("sampling, compile", [("hybrid", False), ("attached", True), deep("hybrid", True),
                                               deep("attached", False)])
def test_every_strategy_gives_the_gradient_of_the_tape(sampling, compile):
    assert len(NAMES) == 6
    settings = SETTINGS | {"sampling": sampling}
    reference, expected = image_and_gradients(room(), NAMES, adjoint=rb.TapeAdjoint(), **settings)
    for adjoint in (MEMOIZED[0], MEMOIZED[-1], QUADRATIC[0]):
        image, gradients = image_and_gradients(room(), NAMES, adjoint=adjoint, compile=compile, **settings)
        assert relative_error(image, reference) < TOLERANCE
        for name, gradient, wanted in zip(NAMES, gradients, expected):
            assert wanted.abs().max() > 0, name
            assert relative_error(gradient, wanted) < TOLERANCE, name


def test_forward_mode_is_the_transpose_of_backward():
    generator = torch.Generator().manual_seed(0)
    tangents = {name: torch.randn(room().get_parameter(name).shape, generator=generator, dtype=torch.float64)
                for name in NAMES}
    derivative = rb.jvp(room(), tangents, seed=3, **SETTINGS)
    adj_image = cotangent(derivative)
    _, gradients = image_and_gradients(room(), NAMES, adj_image=adj_image, **SETTINGS)
    terms = torch.stack([(tangents[name] * gradient).sum() for name, gradient in zip(NAMES, gradients)])
    assert abs(terms.sum() - (adj_image * derivative).sum()) < TOLERANCE * terms.abs().sum()


def test_vertices_of_one_colour_look_like_that_colour():
    scene, plain = (load(sensor=sensor(6), subject=tetrahedron(bsdf={"type": "diffuse", "reflectance": colour}),
                         sky={"type": "constant"}) for colour in (attribute("vertex_color"), rgb(0.2, 0.5, 0.7)))
    scene.subject.add_attribute("vertex_color", torch.tensor([[0.2, 0.5, 0.7]], dtype=torch.float64).expand(4, 3))
    image, expected = (rb.render(each, spp=4, max_depth=3) for each in (scene, plain))
    assert relative_error(image, expected) < 1e-6  # the colour of the other is that of float32


def test_an_attribute_that_a_shape_lacks_is_named():
    scene = load(sensor=sensor(2), subject=tetrahedron(bsdf={"type": "diffuse", "reflectance": attribute("vertex_colour")}),
                 sky={"type": "constant"})
    add_attributes(scene)
    with pytest.raises(ValueError, match="'subject' has no attribute 'vertex_colour'.*; did you mean 'vertex_color'"):
        rb.render(scene, spp=1)
    ball = load(sensor=sensor(2), ball={"type": "sphere", "bsdf": {"type": "diffuse", "reflectance": attribute("face_c")}},
                sky={"type": "constant"})
    with pytest.raises(ValueError, match="'ball' has no attribute 'face_c'.*; known: none"):
        rb.render(ball, spp=1)


def test_a_value_out_of_range_is_found_and_named():
    scene = room()
    with torch.no_grad():
        scene.subject.vertex_color[1, 2] = 1.5
    with pytest.warns(UserWarning, match="subject.vertex_color has values above 1"):
        rb.render(scene, spp=1)
    with torch.no_grad():
        scene.subject.vertex_color[1, 2] = -1.5
    with pytest.raises(ValueError, match="subject.vertex_color must be at least 0, got -1.35"):
        rb.render(scene, spp=1)
    with torch.no_grad():
        scene.subject.vertex_color[1, 2] = float("nan")
    with pytest.raises(ValueError, match="subject.vertex_color' has 1 of 12 values that are NaN"):
        rb.render(scene, spp=1)


@pytest.mark.parametrize("name, values, message", [
    ("color", torch.zeros(4, 3), "begins with vertex_ or face_, got 'color'"),
    ("vertex_color", torch.zeros(3, 3), r"vertex_color must have shape \(4, 1\) or \(4, 3\), got \(3, 3\)"),
    ("face_c", torch.zeros(4, 2), r"face_c must have shape \(4, 1\) or \(4, 3\), got \(4, 2\)"),
    ("vertex_positions", torch.zeros(4, 3), "the mesh has 'vertex_positions' already"),
    ("vertex_c", torch.full((4, 1), torch.nan), "vertex_c must be finite"),
])
def test_what_is_no_attribute_is_refused(name, values, message):
    scene = load(sensor=sensor(), subject=tetrahedron(), sky={"type": "constant"})
    with pytest.raises(ValueError, match=message):
        scene.subject.add_attribute(name, values)
    assert scene.subject.attribute_names == ()
    with pytest.raises(rb.SceneError, match="name must begin with vertex_ or face_, got 'color'"):
        load(sensor=sensor(), wall=rectangle((0, 0, 0), bsdf={"type": "diffuse", "reflectance": attribute("color")}))


def test_a_saved_mesh_keeps_its_attributes(tmp_path):
    scene = room(torch.float32)
    rb.save(scene, tmp_path / "room.xml")
    saved = rb.load(tmp_path / "room.xml")
    for name in NAMES:
        torch.testing.assert_close(saved.get_parameter(name), scene.get_parameter(name))
    torch.testing.assert_close(rb.render(saved, spp=4, max_depth=3), rb.render(scene, spp=4, max_depth=3))
