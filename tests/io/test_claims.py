"""Small files that claim to hold much are refused by what they hold, before memory for it is asked for."""

import io
import struct
import tracemalloc
import warnings
import zlib
from contextlib import contextmanager

import numpy as np
import OpenEXR
import pytest
from PIL import Image

import torch_radbp as rb
from tests.formats.picture_files import tiff_of
from tests.formats.serialized_files import mesh, serialized
from tests.io.gltf_files import GltfFile, set_to
from torch_radbp.formats.image import read_image
from torch_radbp.formats.mesh import read_mesh
from torch_radbp.formats.volume import read_volume

pytestmark = pytest.mark.hostile

MEMORY = 2**24  # bytes: far less than any claim below needs, more than reading a small file does
SIDE = 11_000  # pixels: within the limit of an image, 363 MB of bytes


@contextmanager
def little_memory():
    tracemalloc.start()
    try:
        yield
        assert tracemalloc.get_traced_memory()[1] < MEMORY
    finally:
        tracemalloc.stop()


def refused(path, content, read, *messages):
    path.write_bytes(content)
    with little_memory(), warnings.catch_warnings(), pytest.raises(ValueError) as caught:
        warnings.simplefilter("error")
        read(path)
    text = str(caught.value)
    assert text.startswith(str(path)) and "\n" not in text and len(text) < 500
    for message in messages:
        assert message in text, text


def png(width, height):
    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return (b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(bytes(50))) + chunk(b"IEND", b""))


def small(kind):
    """A picture of 16 x 16 pixels, 8 x 8 of which are one unit of JPEG."""
    file = io.BytesIO()
    Image.new("RGB", (16, 16)).save(file, kind)
    return bytearray(file.getvalue())


def jpeg(width, height):
    content = small("JPEG")
    size = content.index(b"\xff\xc0") + 5
    content[size:size + 4] = struct.pack(">HH", height, width)
    return bytes(content)


def bmp(width, height):
    content = small("BMP")
    content[18:26] = struct.pack("<ii", width, height)
    return bytes(content)


def tga(width, height):
    content = small("TGA")
    content[12:16] = struct.pack("<HH", width, height)
    return bytes(content)


def tif(width, height):
    content = bytearray(tiff_of(np.zeros((16, 17, 3)), bits=8))
    for tag, old, new in ((256, 17, width), (257, 16, height)):
        old, new = (struct.pack("<HHIHH", tag, 3, 1, side, 0) for side in (old, new))
        assert old in content
        content = content.replace(old, new)
    return bytes(content)


def hdr(width, height):
    return f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n".encode() + bytes(40)


def pfm(width, height):
    return f"PF\n{width} {height}\n-1\n".encode() + bytes(40)


TOO_MANY = "an image may have 1 to 134217728 pixels, this one has"
PICTURES = {
    "png": (png(SIDE, SIDE), "its pixels take 363011000 bytes, it has 50"),
    "png of 2^62": (png(2**31 - 1, 2**31 - 1), f"{TOO_MANY} more"),
    "png of 1 row": (png(2**31 - 1, 1), f"{TOO_MANY} more"),
    "jpeg": (jpeg(SIDE, SIDE), "its 11000 x 11000 pixels cannot be in ", "is the file cut short?"),
    "jpeg of 65500": (jpeg(65_500, 65_500), f"{TOO_MANY} more"),
    "jpeg of 1 row": (jpeg(65_500, 16), "its 65500 x 16 pixels cannot be in "),
    "bmp": (bmp(SIDE, SIDE), "image file is truncated"),
    "bmp of 2^60": (bmp(2**30, 2**30), f"{TOO_MANY} more"),
    "tga": (tga(SIDE, SIDE), "image file is truncated"),
    "tga of 65535": (tga(65_535, 65_535), f"{TOO_MANY} more"),
    "tiff": (tif(SIDE, SIDE), "image file is truncated"),
    "tiff of 65535": (tif(65_535, 65_535), f"{TOO_MANY} more"),
    "hdr": (hdr(SIDE, SIDE), "its pixels are cut short in row 0 of 11000"),
    "hdr of 10^18": (hdr(999_999_999, 999_999_999), f"{TOO_MANY} 999999999 x 999999999"),
    "pfm": (pfm(SIDE, SIDE), "its pixels take 1452000000 bytes, it has 40"),
    "pfm of 10^18": (pfm(999_999_999, 999_999_999), f"{TOO_MANY} 999999999 x 999999999"),
}


@pytest.mark.parametrize("case", PICTURES)
def test_pictures(case, tmp_path):
    content, *messages = PICTURES[case]
    kind = case.split()[0]
    refused(tmp_path / f"picture.{kind}", content, read_image, f"cannot be read as {kind.upper()}: ", *messages)


HEADER = "its header is damaged, or the file is cut short"


@pytest.mark.parametrize("width, height, message", [
    (SIDE, SIDE, "its 11000 x 11000 pixels cannot be in 370 bytes; is the file cut short?"),
    (2**27, 1, "its 134217728 x 1 pixels cannot be in 370 bytes"), (1, 2**27, "its 1 x 134217728 pixels cannot be in 370"),
    (2**30, 2**30, HEADER), (-5, 4, HEADER)])
def test_exr_windows(width, height, message, tmp_path):
    good = tmp_path / "good.exr"
    OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage},
                 {"RGB": np.zeros((4, 4, 3), "f4")}).write(str(good))
    window = struct.pack("<4i", 0, 0, 3, 3)
    content = good.read_bytes()
    assert window in content
    content = content.replace(window, struct.pack("<4i", 0, 0, width - 1, height - 1))
    refused(tmp_path / "picture.exr", content, read_image, f"cannot be read as EXR: {message}")


CORNERS = struct.pack("<9f", 0, 0, 0, 1, 0, 0, 0, 1, 0)
ASCII_CORNERS = b"0 0 0\n1 0 0\n0 1 0\n"


def ply(kind, vertices, faces, body):
    return (f"ply\nformat {kind} 1.0\nelement vertex {vertices}\nproperty float x\nproperty float y\nproperty float z\n"
            f"element face {faces}\nproperty list uchar int vertex_indices\nend_header\n").encode() + body


LITTLE = "binary_little_endian"
MESHES = {
    "ply, vertices": (ply(LITTLE, 10**11, 1, CORNERS), "ends in row 3 of the 100000000000 rows of element 'vertex'"),
    "ply, faces": (ply(LITTLE, 3, 10**9, CORNERS + b"\3" + bytes(12)), "of the 1000000000 rows of element 'face'"),
    "ply, corners": (ply(LITTLE, 3, 1, CORNERS + b"\xff" + bytes(12)), "ends in row 0 of the 1 rows of element 'face'"),
    "ply, vertices in ascii": (ply("ascii", 10**11, 1, ASCII_CORNERS), "it has 3 of the 100000000000 rows"),
    "ply, faces in ascii": (ply("ascii", 3, 10**9, ASCII_CORNERS + b"3 0 1 2\n"), "it has 1 of the 1000000000 rows"),
    "ply, corners in ascii": (ply("ascii", 3, 1, ASCII_CORNERS + b"2000000000 0 1 2\n"), "a list of 2e+09 entries, but"),
    "obj": (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99999999999\n", "line 4"),
    "obj, backwards": (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf -1 -2 -99999999999\n", "line 4"),
    "serialized, vertices": (struct.pack("<QQ", 2**32 - 1, 1), "cut short, it ends in its vertices (4294967295 rows)"),
    "serialized, more": (struct.pack("<QQ", 2**40, 1), "the mesh has 1099511627776 vertices and 1 faces"),
    "serialized, faces": (struct.pack("<QQ", 3, 2**60) + CORNERS, "cut short, it ends in its faces (115292150460684"),
}


@pytest.mark.parametrize("case", MESHES)
def test_meshes(case, tmp_path):
    content, message = MESHES[case]
    kind = case.split(",")[0]
    if kind == "serialized":
        content = struct.pack("<HH", 0x041C, 4) + zlib.compress(struct.pack("<I", 0x1000) + b"mesh\0" + content)
        content += struct.pack("<QI", 0, 1)
    refused(tmp_path / f"mesh.{kind}", content, read_mesh, message)


def test_a_table_of_serialized_meshes(tmp_path):
    content = serialized(mesh(np.eye(3), [[0, 1, 2]]))[:-4] + struct.pack("<I", 2**32 - 1)
    refused(tmp_path / "mesh.serialized", content, lambda path: read_mesh(path, shape_index=1),
            "the table of its meshes is damaged or cut short, it has 4294967295 of them")


@pytest.mark.parametrize("size", [(2**31 - 1,) * 3, (1000,) * 3, (2**31 - 1, 1, 1)])
def test_volumes(size, tmp_path):
    content = struct.pack("<3sB5i6f", b"VOL", 3, 1, *size, 1, 0, 0, 0, 1, 1, 1)
    refused(tmp_path / "grid.vol", content, read_volume, "bytes after the header, got 0; is the file cut short?")


def square():
    file = GltfFile()
    file.node(file.square(), name="sheet")
    return file


def claim_zeros(count, kind="VEC3", name="POSITION"):
    def spoil(file):
        number = file.add("accessors", componentType=5126, count=count, type=kind)
        file.document["meshes"][0]["primitives"][0]["attributes"][name] = number

    return spoil


def claim_sparse(**entries):
    def spoil(file):
        sparse = {"count": 1, "indices": {"bufferView": file.view(b"\0"), "componentType": 5121},
                  "values": {"bufferView": file.view(bytes(12))}}
        number = file.add("accessors", componentType=5126, count=4, type="VEC3", sparse=sparse)
        for path, value in entries.items():
            inner = file.document["accessors"][number]
            *parents, last = path.split("__")
            for key in parents:
                inner = inner[key]
            inner[last] = value
        file.document["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = number

    return spoil


ZEROS = "so that its {} elements are zeros that the file does not hold; of such numbers a scene may have 1048576"
ASSETS = {
    "positions that are nowhere": (claim_zeros(2**26), "accessors[4]: it has no bufferView, " + ZEROS.format(2**26)),
    "a few more than allowed": (claim_zeros(349_526), ZEROS.format(349_526)),
    "attributes that are nowhere": (claim_zeros(2**27, "SCALAR", "_HEAT"), "_HEAT has 134217728 elements"),
    "2^53 of them": (claim_zeros(2**53), "with its 27021597764222976 numbers the scene has more than 268435456 numbers"),
    "sparse, nowhere": (claim_sparse(count=2**26), ZEROS.format(2**26)),
    "sparse, more entries than bytes": (claim_sparse(sparse__count=4), "its 4 elements end at byte"),
    "sparse, more entries than elements": (claim_sparse(sparse__count=2**40), "count must be an integer from 1 to 4"),
    "sparse without indices": (claim_sparse(sparse__indices={}), "componentType"),
    "sparse without a view of indices": (claim_sparse(sparse__indices={"componentType": 5121}), "'bufferView' is missing"),
    "sparse without values": (claim_sparse(sparse__values={}), "'bufferView' is missing"),
    "sparse, no such view": (claim_sparse(sparse__values={"bufferView": 99}), "bufferView 99 does not exist"),
    "sparse that is no object": (claim_sparse(sparse=[]), "sparse: must be an object, got []"),
    "a view of 2^53 bytes": (set_to("bufferViews", 0, "byteLength", to=2**53), "it ends at byte 9007199254740992 of"),
    "a buffer of 2^53 bytes": (
        set_to("buffers", 0, "byteLength", to=2**53), "byteLength is 9007199254740992, but there are"),
    "elements of 2^40": (set_to("accessors", 0, "count", to=2**26), "elements end at byte 805306368 of bufferViews[0]"),
}


@pytest.mark.parametrize("case", ASSETS)
def test_assets(case, tmp_path):
    spoil, message = ASSETS[case]
    file = square()
    spoil(file)
    if case.startswith("attributes"):
        message = ZEROS.format(2**27)
    refused(tmp_path / "asset.glb", file.save(tmp_path / "good.glb").read_bytes(), rb.load, message)


def test_zeros_of_several_accessors_count_together(tmp_path, monkeypatch):
    monkeypatch.setattr("torch_radbp.io.gltf.accessor.MAX_ZEROS", 20)
    file = square()
    claim_zeros(4, name="_A")(file)
    claim_zeros(4, name="_B")(file)
    refused(tmp_path / "asset.glb", file.save(tmp_path / "good.glb").read_bytes(), rb.load, "a scene may have 20")


def enlarged(path, size):
    """`path` with a hole up to `size` bytes, which takes no place on the disk."""
    with open(path, "r+b") as file:
        file.truncate(size)
    return path


def loads_with_little_memory(path):
    with little_memory(), pytest.warns(rb.GltfWarning, match="no light"):
        assert len(rb.load(path).shapes) == 1


def test_of_a_large_file_that_holds_a_small_buffer_only_that_is_read(tmp_path):
    file = square()
    file.document["buffers"][0] = {"uri": "buffer.bin", "byteLength": len(file.binary)}
    (tmp_path / "buffer.bin").write_bytes(file.binary)
    enlarged(tmp_path / "buffer.bin", 20 * 10**9)
    loads_with_little_memory(file.save(tmp_path / "asset.gltf"))


def test_a_buffer_that_claims_more_than_its_file_holds(tmp_path):
    file = square()
    file.document["buffers"][0] = {"uri": "buffer.bin", "byteLength": 2**40}
    (tmp_path / "buffer.bin").write_bytes(file.binary)
    refused(tmp_path / "asset.gltf", file.save(tmp_path / "good.gltf").read_bytes(), rb.load,
            f"byteLength is 1099511627776, but there are {len(file.binary)} bytes; is the file cut short?")


def test_of_a_large_glb_only_what_its_header_says_is_read(tmp_path):
    loads_with_little_memory(enlarged(square().save(tmp_path / "asset.glb"), 20 * 10**9))


def test_chunks_that_are_not_known_are_not_read(tmp_path):
    path = square().save(tmp_path / "asset.glb")
    content = path.read_bytes()
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, len(content) + 8 + 2**31) + content[12:]
                     + struct.pack("<I4s", 2**31, b"MORE"))
    loads_with_little_memory(enlarged(path, len(content) + 8 + 2**31))


@pytest.mark.parametrize("name", ["asset.gltf", "asset.glb"])
def test_long_documents_are_refused(name, tmp_path, monkeypatch):
    monkeypatch.setattr("torch_radbp.io.gltf.container.LONGEST_JSON", 100)
    path = square().save(tmp_path / name)
    refused(path, path.read_bytes(), rb.load, "its JSON has ", " bytes, more than 100; keep buffers in files of their own")


def test_a_large_file_is_no_image_of_an_asset(tmp_path):
    file = square()
    file.add("images", uri="picture.png")
    file.add("textures", source=0)
    file.add("materials", pbrMetallicRoughness={"baseColorTexture": {"index": 0}})
    file.document["meshes"][0]["primitives"][0]["material"] = 0
    (tmp_path / "picture.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    enlarged(tmp_path / "picture.png", 20 * 10**9)
    refused(tmp_path / "asset.glb", file.save(tmp_path / "good.glb").read_bytes(), rb.load,
            "picture.png: an image's file may have at most 1073741824 bytes, this one has 20000000000")


def test_an_image_of_an_asset_that_claims_more_than_it_holds(tmp_path):
    file = square()
    file.document["meshes"][0]["primitives"][0]["material"] = 0
    file.add("images", bufferView=file.view(jpeg(SIDE, SIDE)), mimeType="image/jpeg")
    file.add("textures", source=0)
    file.add("materials", pbrMetallicRoughness={"baseColorTexture": {"index": 0}})
    refused(tmp_path / "asset.glb", file.save(tmp_path / "good.glb").read_bytes(), rb.load,
            "images[0]: cannot be read as JPEG: its 11000 x 11000 pixels cannot be in ")


def test_a_mesh_of_many_nodes_is_read_once(tmp_path, monkeypatch):
    from torch_radbp.io.gltf import primitive

    read, places = primitive.read_primitive, []
    monkeypatch.setattr(primitive, "read_primitive", lambda part, *rest: places.append(part.place) or read(part, *rest))
    file = square()
    for number in range(20):
        file.node(name=f"copy_{number}", mesh=0, translation=[number, 0, 0], scale=[1, 1, -1 if number % 2 else 1])
    with pytest.warns(rb.GltfWarning, match="no light"):
        scene = rb.load(file.save(tmp_path / "asset.glb"))
    assert places == ["meshes[0].primitives[0]"] and len(scene.shapes) == 21
    first, second, third = (scene.get_submodule(name) for name in ("sheet", "copy_0", "copy_1"))
    assert second.vertex_positions.data_ptr() != first.vertex_positions.data_ptr()  # each has its own
    assert third.faces.tolist() != first.faces.tolist()  # which is mirrored
