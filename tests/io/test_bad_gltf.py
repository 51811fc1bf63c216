"""Damaged and hostile glTF files are refused with the file and the place, in one line."""

import base64
import math
import struct
import warnings
import zlib

import numpy as np
import pytest
import torch

import torch_radbp as rb
from tests.io.gltf_files import SQUARE, GltfFile, set_to
from torch_radbp.plugin import SceneError


def square():
    """A good file with a texture, a node and a light, to be spoilt."""
    file = GltfFile()
    info = file.texture(np.full((4, 4, 3), 100))
    gold = file.add("materials", name="gold", pbrMetallicRoughness={"baseColorTexture": info})
    file.node(file.square(gold), name="sheet")
    return file


def refused(folder, content, message, name="asset.glb"):
    path = folder / name
    path.write_bytes(content)
    with pytest.raises(SceneError) as caught:
        rb.load(path)
    text = str(caught.value)
    assert text.startswith(str(path)) and "\n" not in text and len(text) < 1000
    assert message in text, text


def drop(*path):
    def spoil(file):
        inner = file.document
        for key in path[:-1]:
            inner = inner[key]
        del inner[path[-1]]

    return spoil


BASE_COLOUR = "pbrMetallicRoughness", "baseColorTexture"

# Accessors of `square`: positions, normals, uv, indices. Its first buffer view holds the image.
BAD = {
    "another version": (set_to("asset", "version", to="1.0"), "glTF version '1.0' is not supported; supported: 2.0"),
    "no version": (drop("asset", "version"), "asset: 'version' is missing"),
    "nodes are no list": (set_to("nodes", to={}), "nodes must be a list, got {}"),
    "a node is no object": (set_to("nodes", 0, to=7), "nodes[0]: must be an object, got 7"),
    "no such mesh": (set_to("nodes", 0, "mesh", to=5), "nodes[0] 'sheet': mesh 5 does not exist; the document has meshes"),
    "no such node": (set_to("scenes", 0, "nodes", to=[0, 3]), "scenes[0]: the node 3 does not exist"),
    "a node that is its own child": (set_to("nodes", 0, "children", to=[0]), "is one of its own descendants"),
    "a node twice": (set_to("scenes", 0, "nodes", to=[0, 0]), "not its only parent"),
    "fractions as indices": (set_to("nodes", 0, "mesh", to=0.5), "mesh must be an integer from 0"),
    "true as an index": (set_to("nodes", 0, "mesh", to=True), "mesh must be an integer from 0"),
    "matrix of 15": (set_to("nodes", 0, "matrix", to=[1] * 15), "matrix must be a list of 16 numbers"),
    "a matrix that is not affine": (set_to("nodes", 0, "matrix", to=[1] * 16), "matrix must be affine"),
    "rotation of nothing": (set_to("nodes", 0, "rotation", to=[0, 0, 0, 0]), "rotation must be a quaternion of length 1"),
    "huge translation": (set_to("nodes", 0, "translation", to=[1e30, 0, 0]), "meshes[0].primitives[0]: is left out: its "),
    "text for a number": (set_to("nodes", 0, "translation", to=["1", 0, 0]), "translation must be a number, got '1'"),
    "positions of two": (set_to("accessors", 0, "type", to="VEC2"), "type 'VEC2' cannot be the POSITION"),
    "no positions": (drop("meshes", 0, "primitives", 0, "attributes", "POSITION"), "is left out: it has no POSITION"),
    "no such accessor": (set_to("meshes", 0, "primitives", 0, "indices", to=99), "indices 99 does not exist"),
    "unknown component": (set_to("accessors", 0, "componentType", to=5130), "componentType 5130 is not known; did you mean"),
    "huge count": (set_to("accessors", 0, "count", to=2**40), "more than 268435456 numbers"),
    "count beyond the view": (set_to("accessors", 0, "count", to=5), "accessors[0]: its 5 elements end at byte 60 of"),
    "no positions, but indices": (set_to("accessors", 0, "count", to=0), "indices must be integers from 0 to -1, got"),
    "offset beyond the view": (set_to("accessors", 0, "byteOffset", to=4), "end at byte 52 of bufferViews[1], which has 48"),
    "view beyond the buffer": (set_to("bufferViews", 1, "byteLength", to=10**9), "bufferViews[1]: it ends at byte 1000"),
    "a stride that is too small": (set_to("bufferViews", 1, "byteStride", to=4), "its elements of 12 bytes overlap"),
    "negative offset": (set_to("bufferViews", 1, "byteOffset", to=-4), "byteOffset must be an integer from 0"),
    "buffer longer than the file": (set_to("buffers", 0, "byteLength", to=10**9), "buffers[0]: byteLength is 1000000000"),
    "indices beyond the vertices": (set_to("accessors", 3, "bufferView", to=1), "indices must be integers from 0 to 3"),
    "fewer normals": (set_to("accessors", 1, "count", to=3), "NORMAL has 3 elements, POSITION has 4"),
    "mode 9": (set_to("meshes", 0, "primitives", 0, "mode", to=9), "mode must be an integer from 0 to 6"),
    "no triangles": (set_to("meshes", 0, "primitives", to=[]), "the scene has no triangles"),
    "no such texture": (set_to("materials", 0, *BASE_COLOUR, "index", to=3), "index 3 does not exist"),
    "no such image": (set_to("textures", 0, "source", to=3), "textures[0]: source 3 does not exist"),
    "an image cut short": (set_to("bufferViews", 0, "byteLength", to=60), "images[0]: cannot be read as PNG"),
    "an image of 12 bytes": (set_to("bufferViews", 0, "byteLength", to=12), "cannot be read as PNG: its content is dam"),
    "no image at all": (set_to("images", 0, "bufferView", to=1), "images[0]: an image must be PNG or JPEG, this one begins"),
    "too much metal": (set_to("materials", 0, BASE_COLOUR[0], "metallicFactor", to=1.5), "metallicFactor must be in [0"),
    "an infinite colour": (set_to("materials", 0, "emissiveFactor", to=[1e300, 0, 0]), "emissiveFactor must be in [0, inf]"),
    "an alpha mode": (set_to("materials", 0, "alphaMode", to="CLIP"), "alphaMode must be OPAQUE, MASK or BLEND, got 'CLIP'"),
    "a wrap mode": (lambda f: f.document["textures"][0].update(sampler=f.add("samplers", wrapS=1)), "wrapS 1 is not known"),
    "a file from the network": (set_to("buffers", 0, "uri", to="http://x/y.bin"), "no other is read"),
    "a file of the system": (set_to("buffers", 0, "uri", to="/etc/passwd"), "leads out of the folder of the document, "),
    "a file above": (set_to("buffers", 0, "uri", to="../../y.bin"), "'../../y.bin' leads out of the folder"),
    "a file above in disguise": (set_to("buffers", 0, "uri", to="a/%2e%2e/..%2Fy.bin"), "leads out of the folder"),
    "a file that is not there": (set_to("buffers", 0, "uri", to="y.bin"), "y.bin: file not found"),
    "damaged base64": (set_to("buffers", 0, "uri", to="data:;base64,@@@"), "its data URI is damaged"),
    "no base64": (set_to("buffers", 0, "uri", to="data:text/plain,abc"), "must be encoded as base64"),
    "no lights": (set_to("nodes", 0, "extensions", to={"KHR_lights_punctual": {"light": 0}}), "has no KHR_lights_punctual"),
    "a lens without an angle": (lambda f: f.node(camera=f.add("cameras", type="perspective", perspective={"znear": 1})),
                                "cameras[0].perspective: 'yfov' is missing"),
    "a lens of 180 degrees": (lambda f: f.node(camera=f.add("cameras", type="perspective", perspective={
        "yfov": math.pi, "znear": 1})), "yfov must be in"),
    "a far plane before the near one": (lambda f: f.node(camera=f.add("cameras", type="perspective", perspective={
        "yfov": 1, "znear": 2, "zfar": 1})), "zfar must be in [2, inf]"),
    "names that are numbers": (set_to("materials", 0, "name", to=3), "name must be a string, got 3"),
}


@pytest.mark.parametrize("case", BAD)
def test_documents_that_do_not_fit_are_refused_by_place(tmp_path, case):
    spoil, message = BAD[case]
    file = square()
    spoil(file)
    refused(tmp_path, file.save(tmp_path / "good.glb").read_bytes(), message)


def test_bad_sparse_accessors_are_refused(tmp_path):
    for rows, message in [([2, 1], "indices must increase"), ([0, 9], "be less than 4"), ([1, 1], "indices must increase")]:
        file = square()
        sparse = {"count": 2, "indices": {"bufferView": file.view(np.array(rows, "u1").tobytes()), "componentType": 5121},
                  "values": {"bufferView": file.view(np.zeros((2, 3), "<f4").tobytes())}}
        file.document["accessors"][0]["sparse"] = sparse
        refused(tmp_path, file.save(tmp_path / "good.glb").read_bytes(), message)


def test_values_that_are_not_finite_are_refused(tmp_path):
    file = GltfFile()
    positions = np.array(SQUARE, dtype="f4")
    positions[1, 2] = np.nan
    file.node({"attributes": {"POSITION": file.array(positions)}, "mode": 6}, name="sheet")
    refused(tmp_path, file.save(tmp_path / "good.glb").read_bytes(), "vertex_positions must be finite, got 1 of 12")


def test_files_outside_of_the_folder_are_read_if_that_is_allowed(tmp_path):
    file = square()
    file.document["buffers"][0]["uri"] = "../buffer.bin"
    (tmp_path / "asset").mkdir()
    path = file.save(tmp_path / "asset" / "good.gltf")
    (tmp_path / "buffer.bin").write_bytes(file.binary + b"and more")
    with pytest.raises(rb.SceneError, match="leads out of the folder of the document, .*; .*allow_outside=True"):
        rb.load(path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rb.GltfWarning)
        assert len(rb.load(path, allow_outside=True).shapes) == 1
        (tmp_path / "asset" / "linked.bin").symlink_to(tmp_path / "buffer.bin")
        file.document["buffers"][0]["uri"] = "linked.bin"
        with pytest.raises(rb.SceneError, match="leads out of the folder"):
            rb.load(file.save(path))


HEADER = struct.Struct("<4sII")


def glb_bytes(folder):
    return square().save(folder / "good.glb").read_bytes()


CONTAINERS = {
    "empty": (lambda c: b"", "a GLB file begins with b'glTF', this one with b''"),
    "another file": (lambda c: b"\x89PNG" + c, "a GLB file begins with"),
    "a header only": (lambda c: c[:8], "cut short, a GLB file has a header of 12 bytes"),
    "another version": (lambda c: HEADER.pack(b"glTF", 1, len(c)) + c[12:], "GLB version 1 is not supported"),
    "cut short": (lambda c: c[:-10], "cut short, its header promises"),
    "a chunk too long": (lambda c: c[:12] + struct.pack("<I", 2**31) + c[16:], "cut short, its chunk b'JSON' at byte 20"),
    "no JSON": (lambda c: c[:16] + b"TEXT" + c[20:], "it has no chunk of JSON"),
    "no buffer": (lambda c: c[:20 + struct.unpack("<I", c[12:16])[0]], "cut short"),
}


@pytest.mark.parametrize("case", CONTAINERS)
def test_damaged_containers_are_refused(tmp_path, case):
    spoil, message = CONTAINERS[case]
    refused(tmp_path, spoil(glb_bytes(tmp_path)), message)


@pytest.mark.parametrize("content, message", [
    (b"", "line 1: not well-formed JSON"),
    (b"{\n\n!", "line 3: not well-formed JSON"),
    (b"[1]", "its JSON must be an object, got a list"),
    (b'{"asset": {"version": "2.0"}, "x": NaN}', "the value NaN, which JSON does not allow"),
    (b"\xff\xfe{}", "its JSON is not UTF-8"),
    (b'{"x":' * 100_000, "nested too deep"),
    (b'{"asset": {"version": ' + b"9" * 5000 + b"}}", "not well-formed JSON"),
    (b"{}", "asset: 'version' is missing"),
])
def test_damaged_json_is_refused_with_its_line(tmp_path, content, message):
    refused(tmp_path, content, message, "asset.gltf")


@pytest.mark.parametrize("name, message", [
    ("gone.glb", "file not found"), ("folder.gltf", "is a folder, not a file"),
    ("scene.fbx", r"unknown kind of scene '\.fbx'; supported: \.xml .* \.glb and \.gltf")])
def test_what_is_no_file_is_named(tmp_path, name, message):
    (tmp_path / "folder.gltf").mkdir()
    with pytest.raises(SceneError, match=f"{name}: {message}"):
        rb.load(tmp_path / name)


def test_a_picture_of_too_many_pixels_is_refused_before_it_is_decoded(tmp_path):
    file = square()
    png = b"\x89PNG\r\n\x1a\n"
    for chunk in (b"IHDR" + struct.pack(">IIBBBBB", 30000, 30000, 1, 0, 0, 0, 0), b"IDAT" + zlib.compress(b""), b"IEND"):
        png += struct.pack(">I", len(chunk) - 4) + chunk + struct.pack(">I", zlib.crc32(chunk))
    file.document["images"][0] = {"uri": "data:image/png;base64," + base64.b64encode(png).decode()}
    refused(tmp_path, file.save(tmp_path / "good.glb").read_bytes(), "1 to 134217728 pixels, this one has more")


def test_numbers_are_counted_as_often_as_nodes_use_them(tmp_path, monkeypatch):
    file = square()
    for number in range(20):
        file.node(name=f"copy_{number}", mesh=0, translation=[number, 0, 0])
    content = file.save(tmp_path / "good.glb").read_bytes()
    monkeypatch.setattr("torch_radbp.io.gltf.accessor.MAX_NUMBERS", 300)
    refused(tmp_path, content, "more than 300 numbers, counted as often as nodes use them")


def test_deep_trees_of_nodes_are_walked_without_recursion(tmp_path):
    file = square()
    child = file.document["scenes"][0]["nodes"].pop()
    for _ in range(5000):
        child = file.node(root=False, children=[child])
    file.document["scenes"][0]["nodes"] = [child]
    with pytest.warns(rb.GltfWarning, match="no light"):
        assert len(rb.load(file.save(tmp_path / "asset.glb")).shapes) == 1


def test_a_scene_far_from_the_origin_gets_a_camera_that_sees_it(tmp_path):
    """As large as numbers are rounded there."""
    file = square()
    set_to("nodes", 0, "translation", to=[0, 0, 2.0**31])(file)
    with pytest.warns(rb.GltfWarning, match="no camera"):
        scene = rb.load(file.save(tmp_path / "asset.glb"))
    camera = scene.sensors[0]
    assert torch.isfinite(camera.to_world).all() and camera.to_world[2, 3] > 2.0**31


def test_a_normal_map_beyond_what_is_finite_is_refused(tmp_path):
    file = square()
    file.document["materials"][0]["normalTexture"] = file.document["materials"][0]["pbrMetallicRoughness"][
        "baseColorTexture"] | {"scale": 2**53}
    refused(tmp_path, file.save(tmp_path / "good.glb").read_bytes(), "scale must be in [-100000, 100000], got")
