"""Reads meshes plainly, a number after the other and without mercy, for the readers to be held against.

Nothing is shared with the package but the scene that it made: what a reader leaves out or changes in silence is a
difference.
"""

from __future__ import annotations

import base64
import json
import re
import struct
import zlib
from pathlib import Path
from urllib.parse import unquote

import numpy as np

import torch_radbp as rb

Corners = dict[str, np.ndarray]  # "positions" (F, 3, 3), "normals" and "uv" (F, 3, 3 or 2) where the file has them
TYPES = {"char": "b", "int8": "b", "uchar": "B", "uint8": "B", "short": "h", "int16": "h", "ushort": "H", "uint16": "H",
         "int": "i", "int32": "i", "uint": "I", "uint32": "I", "float": "f", "float32": "f", "double": "d", "float64": "d"}
TOLERANCE = 1e-5  # relative to the largest number: positions, normals and uv are float32, transformed once


def fan(polygon: list) -> list:
    """The triangles of a polygon, around its first corner."""
    return [[polygon[0], polygon[number], polygon[number + 1]] for number in range(1, len(polygon) - 1)]


def of_obj(content: bytes, with_normals: bool) -> Corners:
    """The triangles of an OBJ file; NaN where a corner has no normal or uv, or `with_normals` is False."""
    rows: dict[bytes, list] = {b"v": [], b"vt": [], b"vn": []}
    triangles = []
    content = re.sub(rb"#[^\n]*", b"", content.removeprefix(b"\xef\xbb\xbf"))
    for line in re.sub(rb"\\[ \t\r]*\n", b" ", content).split(b"\n"):
        keyword, *words = line.split() or [b""]
        if keyword in rows and (keyword != b"vn" or with_normals):
            rows[keyword].append([float(word) for word in words[:2 if keyword == b"vt" else 3]])
        if keyword == b"f":
            corners = []
            for word in words:
                indices = [int(float(part)) if part else 0 for part in word.split(b"/")] + [0, 0]
                corners.append([index - 1 if index > 0 else len(rows[kind]) + index if index else None
                                for index, kind in zip(indices, rows)])
            triangles += fan(corners)
    found = {}
    for column, (name, kind) in enumerate((("positions", b"v"), ("uv", b"vt"), ("normals", b"vn"))):
        indices = [[corner[column] for corner in triangle] for triangle in triangles]
        if any(index is not None for triangle in indices for index in triangle):
            none = [float("nan")] * (2 if name == "uv" else 3)
            found[name] = np.array([[rows[kind][index] if index in range(len(rows[kind])) else none
                                     for index in triangle] for triangle in indices])
    return found


def of_ply(content: bytes) -> Corners:
    """The triangles of a PLY file."""
    end = re.search(rb"(?m)^\s*end_header[^\n]*\n", content).end()
    lines = [line.split() for line in content[:end].decode("latin-1").split("\n")]
    order = next({"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}[line[1]]
                 for line in lines if line[:1] == ["format"])
    elements: list[tuple] = []
    for line in lines:
        if line[:1] == ["element"]:
            elements.append((line[1], int(float(line[2])), []))
        elif line[:1] == ["property"]:
            elements[-1][2].append(line[1:])
    words, place = iter(content[end:].split()), end

    def number(kind: str) -> float:
        nonlocal place
        if not order:
            return float(next(words))
        value, = struct.unpack_from(order + TYPES[kind], content, place)
        place += struct.calcsize(order + TYPES[kind])
        return value

    tables = {}
    for element, count, properties in elements:
        table = tables[element] = []
        for _ in range(count):
            row = {}
            for kind, *more in properties:
                if kind == "list":
                    row[more[2]] = [number(more[1]) for _ in range(int(number(more[0])))]
                else:
                    row[more[0]] = number(kind)
            table.append(row)
    vertices = tables["vertex"]
    polygons = [[int(index) for index in row.get("vertex_indices", row.get("vertex_index"))] for row in tables["face"]]
    triangles = [triangle for polygon in polygons for triangle in fan(polygon)]
    found = {}
    for name, choices in (("positions", ["xyz"]), ("normals", [("nx", "ny", "nz")]),
                          ("uv", ["uv", "st", ("texture_u", "texture_v")])):
        for columns in choices:
            if columns[0] in vertices[0] and name not in found:
                found[name] = np.array([[[vertices[index][column] for column in columns] for index in triangle]
                                        for triangle in triangles])
    return found


def of_serialized(content: bytes) -> Corners:
    """The triangles of the first mesh of a serialized file."""
    version, = struct.unpack_from("<H", content, 2)
    data = zlib.decompressobj().decompress(content[4:])
    flags, = struct.unpack_from("<I", data)
    place = data.index(b"\0", 4) + 1 if version == 4 else 4
    vertices, faces = struct.unpack_from("<QQ", data, place)
    place, kind, tables = place + 16, "<f8" if flags & 0x2000 else "<f4", {}
    for name, width, flag in (("positions", 3, 0), ("normals", 3, 1), ("uv", 2, 2), ("colours", 3, 8)):
        if flag == 0 or flags & flag:
            tables[name] = np.frombuffer(data, kind, vertices * width, place).reshape(-1, width)
            place += tables[name].nbytes
    triangles = np.frombuffer(data, "<u4", 3 * faces, place).reshape(-1, 3)
    return {name: values[triangles] for name, values in tables.items() if name != "colours"}


def of_gltf(content: bytes, folder: Path) -> Corners:
    """The triangles of all meshes that the scene of a glTF file shows, in the world."""
    binary = b""
    if content.startswith(b"glTF"):
        size, = struct.unpack_from("<I", content, 12)
        binary, content = content[20 + size + 8:], content[20:20 + size]
    document = json.loads(content.decode("utf-8-sig"))

    def buffer(index: int) -> bytes:
        uri = document["buffers"][index].get("uri")
        if uri is None:
            return binary
        if uri.lower().startswith("data:"):
            return base64.b64decode(unquote(uri.partition(",")[2]) + "==")
        return (folder / unquote(uri)).read_bytes()

    def numbers(view: int, start: int, count: int, width: int, kind: str) -> list:
        part = document["bufferViews"][int(view)]
        step, code = int(part.get("byteStride", width * struct.calcsize(kind))), f"<{width}{kind}"
        data, begin = buffer(int(part["buffer"])), int(part.get("byteOffset", 0)) + start
        return [list(struct.unpack_from(code, data, begin + step * row)) for row in range(count)]

    def accessor(index: int) -> list:
        part = document["accessors"][index]
        kind = {5120: "b", 5121: "B", 5122: "h", 5123: "H", 5125: "I", 5126: "f"}[part["componentType"]]
        width, count = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[part["type"]], int(part["count"])
        rows = [[0] * width for _ in range(count)]
        if "bufferView" in part:
            rows = numbers(part["bufferView"], int(part.get("byteOffset", 0)), count, width, kind)
        if "sparse" in part:
            where, what = part["sparse"]["indices"], part["sparse"]["values"]
            code = {5121: "B", 5123: "H", 5125: "I"}[where["componentType"]]
            begins, most = [int(each.get("byteOffset", 0)) for each in (where, what)], int(part["sparse"]["count"])
            replaced = numbers(where["bufferView"], begins[0], most, 1, code)
            for (row,), value in zip(replaced, numbers(what["bufferView"], begins[1], most, width, kind)):
                rows[row] = value
        if part.get("normalized"):
            most = 2 ** (8 * struct.calcsize(kind) - kind.islower()) - 1
            rows = [[max(value / most, -1) for value in row] for row in rows]
        return rows

    def matrix(move, turn, size) -> np.ndarray:
        x, y, z, w = np.array(turn) / np.linalg.norm(turn)
        made = np.eye(4)
        made[:3, :3] = np.array([[w * w + x * x - y * y - z * z, 2 * (x * y - z * w), 2 * (x * z + y * w)],
                                 [2 * (x * y + z * w), w * w - x * x + y * y - z * z, 2 * (y * z - x * w)],
                                 [2 * (x * z - y * w), 2 * (y * z + x * w), w * w - x * x - y * y + z * z]]) * size
        made[:3, 3] = move
        return made

    found: list = []

    def visit(index: int, parent: np.ndarray) -> None:
        node = document["nodes"][index]
        extensions = node.get("extensions", {})
        place = parent @ (np.reshape(node["matrix"], (4, 4)).T if "matrix" in node else
                          matrix(node.get("translation", [0, 0, 0]), node.get("rotation", [0, 0, 0, 1]),
                                 node.get("scale", [1, 1, 1])))
        if not extensions.get("KHR_node_visibility", {}).get("visible", True):
            return
        places = [place]
        if "EXT_mesh_gpu_instancing" in extensions:
            given = {name: accessor(value) for name, value in extensions["EXT_mesh_gpu_instancing"]["attributes"].items()}
            places = [place @ matrix(*(given[name][row] if name in given else default for name, default in
                                       (("TRANSLATION", [0, 0, 0]), ("ROTATION", [0, 0, 0, 1]), ("SCALE", [1, 1, 1]))))
                      for row in range(len(next(iter(given.values()))))]
        for to_world in places if "mesh" in node else ():
            for primitive in document["meshes"][int(node["mesh"])].get("primitives", []):
                points = np.array(accessor(int(primitive["attributes"]["POSITION"])), dtype=np.float64)
                corners = ([row[0] for row in accessor(int(primitive["indices"]))] if "indices" in primitive
                           else list(range(len(points))))
                mode = int(primitive.get("mode", 4))
                if mode == 4:
                    triangles = [corners[start:start + 3] for start in range(0, len(corners), 3)]
                elif mode == 5:
                    triangles = [[corners[n], corners[n + 1 + n % 2], corners[n + 2 - n % 2]]
                                 for n in range(len(corners) - 2)]
                else:
                    triangles = [[corners[n + 1], corners[n + 2], corners[0]] for n in range(len(corners) - 2)]
                if np.linalg.det(to_world[:3, :3]) < 0:
                    triangles = [[a, c, b] for a, b, c in triangles]
                world = points @ to_world[:3, :3].T + to_world[:3, 3]
                found.append(world[np.array(triangles)])
        for child in node.get("children", []):
            visit(int(child), place)

    children = {child for node in document["nodes"] for child in node.get("children", [])}
    roots = (document["scenes"][int(document.get("scene", 0))].get("nodes", []) if document.get("scenes")
             else [index for index in range(len(document["nodes"])) if index not in children])
    for root in roots:
        visit(int(root), np.eye(4))
    return {"positions": np.concatenate(found)}


READERS = {"ply": of_ply, "serialized": of_serialized}


def corners_of(scene: rb.Scene) -> Corners:
    """The triangles of a scene's meshes as they are in it; normals and uv of the only one."""
    meshes = [shape for shape in scene.shapes if hasattr(shape, "faces")]
    found = {"positions": np.concatenate([mesh.vertex_positions.detach().numpy()[mesh.faces.numpy()] for mesh in meshes])}
    if len(meshes) == 1:
        for name in ("normals", "uv"):
            values = getattr(meshes[0], {"normals": "vertex_normals", "uv": "vertex_texcoords"}[name], None)
            if values is not None:
                found[name] = values.detach().numpy()[meshes[0].faces.numpy()]
    return found


def difference(family: str, path: Path, scene: rb.Scene) -> str:
    """What a scene has otherwise than the mesh or glTF file that it was read from; nothing if all is there."""
    content, ours = path.read_bytes(), corners_of(scene)
    try:
        theirs = (of_gltf(content, path.parent) if family in ("gltf", "glb") else
                  of_obj(content, "normals" in ours) if family == "obj" else READERS[family](content))
    except Exception as error:
        return f"is read, though plain reading ends in {error!r}"
    if family not in ("gltf", "glb"):
        mesh = next(shape for shape in scene.shapes if hasattr(shape, "faces"))
        if "uv" in theirs and mesh.flip_tex_coords:
            theirs["uv"] = theirs["uv"] * [1, -1] + [0, 1]
        if "normals" in theirs:
            if "normals" not in ours or mesh.face_normals or mesh.recompute_normals:
                del theirs["normals"]
            else:
                theirs["normals"] = theirs["normals"] / np.linalg.norm(theirs["normals"], axis=2, keepdims=True)
    for name, wanted in theirs.items():
        if name not in ours or ours[name].shape != wanted.shape:
            return f"{name}: {wanted.shape} in the file, {ours[name].shape if name in ours else 'none'} in the scene"
        apart = np.abs(ours[name] - wanted)
        if not (apart <= TOLERANCE * max(np.abs(wanted).max(), 1e-30)).all():
            return f"{name} differ by {np.nanmax(apart)} of {np.abs(wanted).max()}"
    return ""
