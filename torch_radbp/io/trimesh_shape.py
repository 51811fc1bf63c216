"""Converts trimesh meshes to shapes with materials, as their glTF would be (`io.gltf.material`).

A `PBRMaterial` is read by the reader of glTF, and so are colours, which glTF multiplies with its default material, a rough
metal. A `SimpleMaterial`, as of OBJ files, is what trimesh makes of it for glTF, but no metal. A mesh without either has no
look.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import torch

from torch_radbp.emitter.area import Area
from torch_radbp.formats.mesh_arrays import MeshArrays
from torch_radbp.formats.trimesh_arrays import (
    colours_of,
    is_trimesh,
    joined_meshes,
    mesh_arrays,
    placed_meshes,
    transformed_mesh,
)
from torch_radbp.formats.trimesh_file import read_trimesh
from torch_radbp.io.gltf.document import Document, DocumentPart, Losses
from torch_radbp.io.gltf.material import GltfMaterials, Look
from torch_radbp.io.gltf.names import Names
from torch_radbp.io.gltf.picture import bytes_of
from torch_radbp.io.gltf.read import lies_mirrored, said
from torch_radbp.io.gltf.texture import GltfTextures
from torch_radbp.plugin import BSDF, REGISTRY, Emitter, Plugin, SceneError, SceneWarning, attributes
from torch_radbp.shape.mesh import TensorMesh

if TYPE_CHECKING:
    import trimesh

SOURCE = "trimesh"  # in the place of a file's name in messages
PLAIN = ("name", "emissiveFactor", "alphaMode", "alphaCutoff", "doubleSided")
ROUGH = ("baseColorFactor", "metallicFactor", "roughnessFactor", "baseColorTexture", "metallicRoughnessTexture")
SURFACE = ("normalTexture", "emissiveTexture", "occlusionTexture")


class Dressed(NamedTuple):
    """A mesh with its look: material, emission and texture coordinates."""

    arrays: MeshArrays
    look: Look | None  # None: trimesh has no material for it


class ImagesInMemory:
    """Images in memory, in place of those of a glTF document."""

    def __init__(self) -> None:
        self.pictures: list[np.ndarray] = []

    def pixels(self, index: int, user: DocumentPart) -> np.ndarray:
        """(H, W, 4) bytes of an image as they are coded."""
        return self.pictures[index]


class Looks:
    """The looks of meshes, one for each distinct material.

    Args:
        losses: what cannot be represented is added to them.
        names: those in use in the scene.
        children: of the scene; materials are added.
    """

    def __init__(self, losses: Losses, names: Names, children: dict[str, Plugin]):
        self.losses, self.images, self.numbers = losses, ImagesInMemory(), dict[int, int]()
        empty: dict[str, Any] = {"asset": {"version": "2.0"}, "materials": [], "textures": []}
        self.document = Document(SOURCE, empty)
        textures = GltfTextures(self.document, self.images, losses)
        self.materials = GltfMaterials(self.document, textures, losses, names, children)

    def dressed(self, mesh: trimesh.Trimesh, place: str) -> Dressed:
        """A mesh with its look; `place` names it in messages."""
        arrays, visual = mesh_arrays(mesh), mesh.visual
        colours = colours_of(visual)[0] or None
        material = getattr(visual, "material", None) if visual.kind == "texture" else None
        if colours is None and material is None:
            return Dressed(arrays, None)
        part = DocumentPart(SOURCE, place, {} if material is None else {"material": self.number(material, place)})
        mirrored = False
        if arrays.uv is not None and self.materials.material(part).has("normalTexture"):
            mirrored = lies_mirrored(arrays.uv, arrays.faces, place, self.losses)
        look = self.materials.look(part, colours, mirrored)
        if look.uv_set is not None and arrays.uv is None:
            self.losses.add(place, "textures of its material are read at (0, 0) everywhere: the mesh has no uv")
            arrays = arrays._replace(uv=np.zeros((len(arrays.vertices), 2)))
        if colours is not None:
            arrays = arrays._replace(attributes={**arrays.attributes, colours: arrays.attributes[colours] * look.factor})
        return Dressed(arrays, look)

    def number(self, material: Any, place: str) -> int:
        """The index of a material in the document, to which it is added if it is new."""
        key = hash(material)
        if key not in self.numbers:
            if hasattr(material, "materials"):
                raise ValueError(f"{place}: a shape has one material, got a {type(material).__name__}: make a mesh of the "
                                 "faces of each (mesh.submesh), or give a bsdf")
            self.numbers[key] = len(self.document.value["materials"])
            self.document.value["materials"].append(self.entries(material))
        return self.numbers[key]

    def entries(self, material: Any) -> dict[str, Any]:
        """Converts a trimesh material to entries of a glTF document."""
        if hasattr(material, "baseColorFactor"):
            pbr, entries = material, {}
        else:
            pbr, entries = material.to_pbr(), {"metallicFactor": 0.0, "name": material.name}
        for name in (*PLAIN, *ROUGH, *SURFACE):
            value = getattr(pbr, name)
            if value is None:
                continue
            if name.endswith("Texture"):
                self.images.pictures.append(bytes_of(value))
                self.document.value["textures"].append({"source": len(self.images.pictures) - 1})
                entries[name] = {"index": len(self.images.pictures) - 1}
            elif name == "baseColorFactor":
                entries[name] = (np.asarray(value) / 255.0).tolist()
            else:
                entries[name] = value.tolist() if isinstance(value, np.ndarray) else value
        entries["pbrMetallicRoughness"] = {name: entries.pop(name) for name in ROUGH if name in entries}
        return {name: value for name, value in entries.items() if value is not None}


def shape_of_mesh(source: trimesh.Trimesh | trimesh.Scene) -> TensorMesh:
    """Converts a mesh, or all meshes of a scene joined, to a shape, in torch's default dtype.

    Raises:
        ValueError: as `with_arrays`.
    """
    losses = Losses()
    shape = TensorMesh(**with_arrays({"mesh": source}, Looks(losses, Names(), {})))
    if list(losses):
        warnings.warn(f"{SOURCE}: {said(list(losses))}", SceneWarning, stacklevel=5)
    return shape.to(torch.get_default_dtype())


def _shapes_of(name: str, value: Any, others: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yields descriptions of shapes for a trimesh mesh, or for each node of a trimesh scene that shows a mesh."""
    try:
        placed = placed_meshes(value)
    except ValueError as error:
        raise SceneError(f"{name}: {error}") from error
    for each in placed:
        key = name if len(placed) == 1 else f"{name}_{each.name}".replace(".", "_")
        while key != name and key in others:
            key += "_"
        yield key, {"type": "mesh", "mesh": each.mesh, "to_world": each.to_world}


def with_shapes(node: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yields the entries of an object, with trimesh objects replaced by descriptions of shapes."""
    for key, value in node.items():
        cls = REGISTRY["shape"].get(str(node.get("type"))) if is_trimesh(value) else None
        if not is_trimesh(value) or (cls is not None and key in attributes(cls)):
            yield key, value
        else:
            yield from _shapes_of(str(key), value, node)


def with_arrays(arguments: dict[str, Any], looks: Looks) -> dict[str, Any]:
    """The arguments of a shape `mesh`, with a trimesh mesh or a file replaced by arrays and a material.

    Raises:
        ValueError: if there are several materials, and none is given; as the shape.
    """
    source, file = arguments.get("mesh"), arguments.get("filename")
    if (source is None) == (file is None) or "vertex_positions" in arguments:
        return arguments  # the shape says what is wrong
    changed = {name: value for name, value in arguments.items() if name != "filename"}
    placed = placed_meshes(read_trimesh(file) if source is None else source)
    if arguments.get("bsdf") is not None:
        parts = [Dressed(mesh_arrays(each.mesh), None) for each in placed]
    else:
        parts = [looks.dressed(each.mesh, each.name) for each in placed]
    if len({id(part.look) for part in parts}) > 1:
        raise ValueError(f"one shape has one material, and the {len(parts)} meshes have several: give a bsdf for all of "
                         "them, or put the trimesh.Scene (of a file: trimesh.load_scene(filename)) into the dict by itself, "
                         "which makes a shape of each")
    changed["mesh"] = joined_meshes([transformed_mesh(part.arrays, each.to_world) for part, each in zip(parts, placed)])
    bsdf, emitter = dress(parts[0].look)
    if bsdf is not None:
        changed["bsdf"] = bsdf
    if emitter is not None:
        changed.setdefault("emitter", emitter)
    return changed


def dress(look: Look | None) -> tuple[BSDF | None, Emitter | None]:
    """The material of a look, and a new emitter for one shape with that look."""
    if look is None:
        return None, None
    return look.bsdf, None if look.radiance is None else Area(radiance=look.radiance)


TensorMesh.of_trimesh = staticmethod(shape_of_mesh)
