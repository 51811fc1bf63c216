"""The nodes of a glTF scene with their transforms to the world."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from torch_radbp.io.gltf.accessor import Buffers
from torch_radbp.io.gltf.document import Document, DocumentPart
from torch_radbp.io.values.transform import scale, translate

MAX_NODES = 100_000


class PlacedNode(NamedTuple):
    """A node with its transform to the world."""

    node: DocumentPart
    to_world: np.ndarray  # (4, 4) float64, column vectors
    visible: bool  # False if it or an ancestor is hidden by KHR_node_visibility; cameras ignore this


def placed_nodes(document: Document, scene: int | None) -> Iterator[PlacedNode]:
    """Yields the nodes of a scene, each after its parent.

    Args:
        document: the whole of it.
        scene: the number of the scene; None: the one that the document names, or else the first. A document without scenes
            shows all nodes.

    Raises:
        SceneError: if a node has two parents or is its own ancestor, or refers to nodes that do not exist.
    """
    waiting = [(index, user, np.eye(4), True) for index, user in reversed(roots(document, scene))]
    seen: set[int] = set()
    while waiting:
        index, user, parent, visible = waiting.pop()
        node = document.of("nodes", index, user, "the node")
        if index in seen:
            raise node.fail(f"{user.place} refers to it, which is not its only parent, or is one of its own descendants")
        seen.add(index)
        if len(seen) > MAX_NODES:
            raise node.fail(f"the scene has more than {MAX_NODES} nodes")
        to_world = parent @ local_transform(node)
        visibility = node.extension("KHR_node_visibility")
        visible = visible and (visibility is None or visibility.flag("visible", True))
        yield PlacedNode(node, to_world, visible)
        waiting += [(child, node, to_world, visible) for child in reversed(indices(node, "children"))]


def roots(document: Document, scene: int | None) -> list[tuple[int, DocumentPart]]:
    """The indices of the top-level nodes, each with the object that refers to it."""
    number = document.integer("scene", 0) if scene is None else scene
    if scene is None and not document.items("scenes"):
        children = {child for node in document.parts("nodes") for child in indices(node, "children")}
        return [(index, document) for index in range(len(document.items("nodes"))) if index not in children]
    part = document.of("scenes", number, document, "scene")
    return [(index, part) for index in indices(part, "nodes")]


def indices(part: DocumentPart, name: str) -> list[int]:
    """Reads a list of indices of other objects."""
    items = part.items(name)
    for item in items:
        if isinstance(item, bool) or not isinstance(item, int) or item < 0:
            raise part.fail(f"{name} must be indices, got {item!r:.60}")
    return items


def local_transform(node: DocumentPart) -> np.ndarray:
    """(4, 4) the node's local transform: its matrix, or translation times rotation times scale."""
    if node.has("matrix"):
        matrix = np.reshape(node.numbers("matrix", 16), (4, 4)).T  # column after column
        if not np.allclose(matrix[3], (0, 0, 0, 1)):
            raise node.fail(f"matrix must be affine, its last row 0, 0, 0, 1, got {matrix[3].tolist()}")
        return matrix
    turn = _rotation(node, np.asarray(node.numbers("rotation", 4, [0, 0, 0, 1])))
    return translate(node.numbers("translation", 3, [0, 0, 0])) @ turn @ scale(node.numbers("scale", 3, [1, 1, 1]))


def instance_transforms(place: PlacedNode, buffers: Buffers) -> list[np.ndarray]:
    """The (4, 4) transforms at which a node's mesh is shown: its own, or those of EXT_mesh_gpu_instancing."""
    instancing = place.node.extension("EXT_mesh_gpu_instancing")
    if instancing is None:
        return [place.to_world]
    part = instancing.part("attributes")
    columns = {name: buffers.array(part.integer(name), part, name, (kind,)).astype(np.float64)
               for name, kind in (("TRANSLATION", "VEC3"), ("ROTATION", "VEC4"), ("SCALE", "VEC3")) if part.has(name)}
    counts = {len(values) for values in columns.values()}
    if len(counts) != 1 or max(counts) > MAX_NODES:
        raise part.fail(f"TRANSLATION, ROTATION and SCALE must have the same number of elements, at most {MAX_NODES}, got "
                        f"{', '.join(f'{len(values)} of {name}' for name, values in columns.items()) or 'none'}")
    if not all(np.isfinite(values).all() for values in columns.values()):
        raise part.fail("TRANSLATION, ROTATION and SCALE must be finite")
    default = {"TRANSLATION": np.zeros(3), "ROTATION": np.array([0.0, 0.0, 0.0, 1.0]), "SCALE": np.ones(3)}
    return [place.to_world @ translate(move) @ _rotation(part, turn) @ scale(size)
            for move, turn, size in zip(*(columns.get(name, [default[name]] * max(counts)) for name in default))]


def _rotation(part: DocumentPart, quaternion: np.ndarray) -> np.ndarray:
    """The (4, 4) rotation of a quaternion x, y, z, w of any length."""
    length = np.linalg.norm(quaternion)
    if not length > 1e-12:
        raise part.fail(f"rotation must be a quaternion of length 1, got {quaternion.tolist()}")
    x, y, z, w = quaternion / length
    matrix = np.eye(4)
    matrix[:3, :3] = [[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                      [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                      [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]]
    return matrix
