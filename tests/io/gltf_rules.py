"""Rules of the glTF 2.0 specification that a file can break without looking broken, checked without the package's reader."""

from __future__ import annotations

import io
import json
import struct
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
from PIL import Image

DTYPES = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
FRACTIONS = ("metallicFactor", "roughnessFactor", "transmissionFactor", "clearcoatFactor", "clearcoatRoughnessFactor",
             "specularFactor", "anisotropyStrength", "sheenRoughnessFactor")


def read_parts(path: Path) -> tuple[dict[str, Any], bytes]:
    """The document and the buffer of a file, whose framing is checked (GLB: section 4.4)."""
    content = path.read_bytes()
    if path.suffix == ".gltf":
        document = json.loads(content)
        return document, (path.parent / unquote(document["buffers"][0]["uri"])).read_bytes()
    magic, version, length = struct.unpack("<4sII", content[:12])
    assert (magic, version, length) == (b"glTF", 2, len(content)) and length % 4 == 0
    size, kind = struct.unpack("<I4s", content[12:20])
    assert kind == b"JSON" and size % 4 == 0
    document, rest = json.loads(content[20:20 + size]), content[20 + size:]
    size, kind = struct.unpack("<I4s", rest[:8])
    assert kind == b"BIN\0" and size == len(rest) - 8
    assert 0 <= size - document["buffers"][0]["byteLength"] < 4
    return document, rest[8:]


def check_rules(path: Path) -> dict[str, Any]:
    """Raises AssertionError where a file breaks a rule; returns its document."""
    document, binary = read_parts(path)
    assert document["asset"]["version"] == "2.0" and document["scene"] < len(document["scenes"])
    for view in document["bufferViews"]:
        assert view["byteOffset"] + view["byteLength"] <= document["buffers"][view["buffer"]]["byteLength"]
    arrays = [check_accessor(document, accessor, binary) for accessor in document["accessors"]]
    for mesh in document["meshes"]:
        for primitive in mesh["primitives"]:
            check_primitive(document, primitive, arrays)
    for material in document.get("materials", []):
        check_material(document, material)
    for image in document.get("images", []):
        view = document["bufferViews"][image["bufferView"]]
        assert "byteStride" not in view and "target" not in view and image["mimeType"] == "image/png"
        with Image.open(io.BytesIO(binary[view["byteOffset"]:][:view["byteLength"]])) as png:
            assert png.mode in ("RGB", "RGBA")
    for texture in document.get("textures", []):
        assert texture["source"] < len(document["images"]) and texture["sampler"] < len(document["samplers"])
    check_nodes(document)
    used = set(extensions(document))
    assert used == set(document.get("extensionsUsed", [])), used
    assert len(document.get("extensionsUsed", [])) == len(used)
    return document


def check_accessor(document: dict[str, Any], accessor: dict[str, Any], binary: bytes) -> np.ndarray:
    """Sections 3.6.2.4 (alignment) and 3.6.2.5 (bounds)."""
    view, dtype = document["bufferViews"][accessor["bufferView"]], np.dtype(DTYPES[accessor["componentType"]])
    width, start = WIDTHS[accessor["type"]], view["byteOffset"] + accessor.get("byteOffset", 0)
    assert start % dtype.itemsize == 0 and start % 4 == 0
    assert accessor.get("byteOffset", 0) + accessor["count"] * width * dtype.itemsize <= view["byteLength"]
    values = np.frombuffer(binary, dtype, accessor["count"] * width, start).reshape(-1, width)
    assert dtype.kind != "f" or np.isfinite(values).all()
    for bound, found in (("min", values.min(0)), ("max", values.max(0))):
        assert bound not in accessor or accessor[bound] == found.astype(float).tolist()
    return values


def check_primitive(document: dict[str, Any], primitive: dict[str, Any], arrays: list[np.ndarray]) -> None:
    """Section 3.7.2.1."""
    attributes = {name: arrays[index] for name, index in primitive["attributes"].items()}
    assert {"min", "max"} <= set(document["accessors"][primitive["attributes"]["POSITION"]])
    assert len({len(values) for values in attributes.values()}) == 1
    for name, index in primitive["attributes"].items():
        assert document["bufferViews"][document["accessors"][index]["bufferView"]]["target"] == 34962, name
    if "NORMAL" in attributes:
        np.testing.assert_allclose(np.linalg.norm(attributes["NORMAL"], axis=1), 1, atol=1e-5)
    if "COLOR_0" in attributes:
        assert 0 <= attributes["COLOR_0"].min() and attributes["COLOR_0"].max() <= 1
    indices = arrays[primitive["indices"]]
    reserved = np.iinfo(indices.dtype).max
    assert len(indices) % 3 == 0 and indices.max() < len(attributes["POSITION"]) and indices.max() < reserved
    assert primitive["material"] < len(document["materials"])


def check_material(document: dict[str, Any], material: dict[str, Any]) -> None:
    """Sections 3.9.2 to 3.9.4: factors are fractions, textures exist."""
    def walk(key: str, value: Any) -> None:
        if key in FRACTIONS:
            assert 0 <= value <= 1, key
        if key.endswith("ColorFactor") or key == "emissiveFactor":
            assert all(0 <= component <= 1 for component in value), key
        if key.endswith("Texture"):
            assert value["index"] < len(document["textures"]) and value.get("texCoord", 0) == 0, key
        for inner, item in value.items() if isinstance(value, dict) else ():
            walk(inner, item)

    walk("", material)
    assert material.get("alphaMode", "OPAQUE") in ("OPAQUE", "MASK", "BLEND")


def check_nodes(document: dict[str, Any]) -> None:
    """Sections 3.5.2 and 3.5.3: a forest; matrices are scale, rotation and translation."""
    children = [child for node in document["nodes"] for child in node.get("children", [])]
    assert len(children) == len(set(children))
    assert all(root not in children for scene in document["scenes"] for root in scene["nodes"])
    for node in document["nodes"]:
        linear = np.reshape(node.get("matrix", np.eye(4)), (4, 4)).T[:3, :3]
        columns = linear / np.linalg.norm(linear, axis=0)
        np.testing.assert_allclose(columns.T @ columns, np.eye(3), atol=1e-4)
    for camera in document.get("cameras", []):
        lens = camera[camera["type"]]
        assert lens["zfar"] > lens["znear"] and (camera["type"] != "perspective" or lens["znear"] > 0)


def extensions(value: Any) -> list[str]:
    """The names of all extensions that a document has objects of."""
    if isinstance(value, list):
        return [name for item in value for name in extensions(item)]
    if not isinstance(value, dict):
        return []
    return [*value.get("extensions", {}), *(name for key, item in value.items() for name in
                                            (extensions(item) if key != "extensions" else
                                             [inner for each in item.values() for inner in extensions(each)]))]
