"""Writes a scene as glTF 2.0."""

from __future__ import annotations

import json
import warnings
from pathlib import Path
from urllib.parse import quote

import numpy as np
import torch

from torch_radbp.emitter.envmap import Envmap
from torch_radbp.io.gltf import lamp_out
from torch_radbp.io.gltf.appearance import Appearances
from torch_radbp.io.gltf.container import glb
from torch_radbp.io.gltf.document import GltfWarning, Losses
from torch_radbp.io.gltf.environment import written_environment
from torch_radbp.io.gltf.image_slot import checked_values
from torch_radbp.io.gltf.lamp_out import column_major, matrix_of
from torch_radbp.io.gltf.read import said
from torch_radbp.io.gltf.written import Written
from torch_radbp.plugin import Plugin, SceneError, Shape
from torch_radbp.scene.modules.scene import Scene
from torch_radbp.shape.instance import Instance, instanced
from torch_radbp.shape.shapegroup import ShapeGroup
from torch_radbp.shape.surface import Triangles

SHEAR = 1e-5  # cosine between axes: what glTF's nodes cannot say


def gltf_files(scene: Scene, target: Path, strict: bool) -> list[Path]:
    """Writes a scene as glTF; a `.gltf` has its buffer in a `.bin` beside it, and environment maps are files beside either.

    See `torch_radbp.save`.

    Args:
        scene: as it is now.
        target: where to write, in a folder of its own.
        strict: an error instead of a warning about what glTF cannot say.

    Returns:
        All files, `target` last.
    """
    writer = _Writer(scene, target)
    with torch.no_grad(), torch.device("cpu"):
        writer.write()
    losses = list(writer.losses)
    if losses and strict:
        raise SceneError(f"{target.name}: {said(losses)}")
    if losses:
        warnings.warn(f"{target.name}: {said(losses)}", GltfWarning, stacklevel=4)
    if target.suffix.lower() == ".glb":
        target.write_bytes(glb(writer.out.document(None), bytes(writer.out.binary)))
        return [*writer.files, target]
    buffer = target.with_suffix(".bin")
    buffer.write_bytes(bytes(writer.out.binary))
    target.write_text(json.dumps(writer.out.document(quote(buffer.name)), indent=1, allow_nan=False))
    return [*writer.files, buffer, target]


class _Writer:
    def __init__(self, scene: Scene, target: Path):
        self.scene, self.target, self.out, self.losses = scene, target, Written(), Losses()
        self.files: list[Path] = []  # beside the document
        self.appearances = Appearances(scene, self.out, self.losses)

    def write(self) -> None:
        """Fills the document: a node for each shape, light and camera."""
        for name, child in self.scene.named_children():
            if not isinstance(child, Plugin) or not child.type:
                raise SceneError(f"{name}: a {type(child).__name__} cannot be written as glTF, only Mitsuba's plugins can")
            if isinstance(child, Instance):
                for leaf, shape in child.shapegroup.shapes.items():
                    self.losses.add(f"{name}.{leaf}", "is written as a copy: instances are not shared")
                    self.add_shape(f"{name}_{leaf}", shape, child)
            elif child.category == "shape" and not isinstance(child, ShapeGroup):
                self.add_shape(name, child)
            elif child.category == "emitter":
                self.add_light(name, child)
            elif child.category == "sensor":
                self.add_camera(name, child)
        for medium in self.scene.media:
            self.losses.add(self.scene.name_of(medium), f"a {medium.type} medium is not written: glTF has none")

    def add_shape(self, name: str, shape: Shape, instance: Instance | None = None) -> None:
        """Adds a node with a mesh, in the frame of the shape's pose, or where an instance shows it."""
        surface = shape.oriented()
        if surface.ball is not None:
            self.losses.add(name, f"a {shape.type} is written as {len(surface.faces)} triangles")
        pose = matrix_of(shape.to_world) if isinstance(getattr(shape, "to_world", None), torch.Tensor) else np.eye(4)
        if instance is not None:
            surface, pose = instanced(surface, instance.to_world), matrix_of(instance.to_world) @ pose
        if is_sheared(pose):
            pose = np.eye(4)
        appearance = self.appearances.of(shape, is_upright_in_v(surface))
        attributes = self.geometry(name, surface, pose) | self.attributes(name, surface, appearance.colours)
        faces = surface.faces.cpu().numpy()
        faces = faces[:, [0, 2, 1]] if np.linalg.det(pose[:3, :3]) < 0 else faces
        primitive = {"attributes": attributes, "indices": self.out.indices(faces, len(surface.vertices)),
                     "material": appearance.material}
        mesh = self.out.add("meshes", {"name": name, "primitives": [primitive]})
        self.out.add("nodes", {"name": name, "mesh": mesh, **column_major(pose)})

    def geometry(self, name: str, surface: Triangles, pose: np.ndarray) -> dict[str, int]:
        """Writes positions, normals and texture coordinates of a mesh."""
        inverse = np.linalg.inv(pose)
        positions = checked_values(surface.vertices, f"{name}.vertex_positions") @ inverse[:3, :3].T + inverse[:3, 3]
        accessors = {"POSITION": self.out.vertices(positions, bounds=True)}
        if surface.normals is not None:
            normals = checked_values(surface.normals, f"{name}.vertex_normals") @ pose[:3, :3]
            length = np.linalg.norm(normals, axis=1, keepdims=True)
            accessors["NORMAL"] = self.out.vertices(normals / np.where(length > 0, length, 1.0))
        if surface.uv is not None:
            accessors["TEXCOORD_0"] = self.out.vertices(checked_values(surface.uv, f"{name}.vertex_texcoords"))
        return accessors

    def attributes(self, name: str, surface: Triangles, colours: tuple[str, float] | None) -> dict[str, int]:
        """Writes mesh attributes: the base colour, and others under custom names."""
        accessors: dict[str, int] = {}
        for attribute, tensor in surface.attributes:
            values = checked_values(tensor, f"{name}.{attribute}")
            short = attribute.removeprefix("vertex_")
            if colours is not None and attribute == colours[0]:
                if attribute.startswith("face_"):
                    self.losses.add(f"{name}.{attribute}", "is written as means around vertices: glTF has none of faces")
                    values = means_around(values, surface)
                linear = np.broadcast_to(values * colours[1], (len(values), 3))
                self.appearances.lose_beyond(f"{name}.{attribute}", linear)
                accessors["COLOR_0"] = self.out.vertices(linear.clip(0.0, 1.0))
            elif attribute.startswith("vertex_") and short == short.lower() and short != "color" and short.isidentifier():
                accessors[f"_{short.upper()}"] = self.out.vertices(values)
            else:
                self.losses.add(f"{name}.{attribute}", "is not written: glTF has attributes of vertices, in capital letters")
        if colours is not None and "COLOR_0" not in accessors:
            raise SceneError(f"{name}: it has no attribute {colours[0]!r}, which its material reads")
        return accessors

    def add_light(self, name: str, emitter: Plugin) -> None:
        """Adds a node with a light, or with the file name of an environment map."""
        if isinstance(emitter, Envmap):
            file, extras = written_environment(emitter, name, self.target, self.losses)
            self.files.append(file)
            self.out.add("nodes", {"name": name, "extras": extras, **column_major(matrix_of(emitter.to_world))})
            return
        written = lamp_out.light_of_emitter(emitter, name, self.losses)
        if written is not None:
            entries, place = written
            extensions = self.out.light({"name": name, **entries})
            self.out.add("nodes", {"name": name, "extensions": extensions, **column_major(place)})

    def add_camera(self, name: str, sensor: Plugin) -> None:
        """Adds a node with a camera."""
        written = lamp_out.camera_of_sensor(sensor, name, self.losses)
        if written is not None:
            entries, place = written
            number = self.out.add("cameras", {"name": name, **entries})
            self.out.add("nodes", {"name": name, "camera": number, **column_major(place)})


def means_around(values: np.ndarray, surface: Triangles) -> np.ndarray:
    """(V, C) averages of (F, C) face values over the faces around each vertex; 0 at a vertex without a face."""
    corners, total = surface.faces.cpu().numpy(), np.zeros((len(surface.vertices), values.shape[1]))
    np.add.at(total, corners.reshape(-1), values.repeat(3, axis=0))
    return total / np.bincount(corners.reshape(-1), minlength=len(total)).clip(1)[:, None]


def is_sheared(pose: np.ndarray) -> bool:
    """True if a transform cannot be written as scale, rotation and translation of a node."""
    columns = pose[:3, :3] / np.linalg.norm(pose[:3, :3], axis=0)
    return bool(np.abs(columns.T @ columns - np.eye(3)).max() > SHEAR)


def is_upright_in_v(surface: Triangles) -> bool:
    """True if most triangles are counter-clockwise in (u, v), where v points down in glTF; see `read.is_mirrored`."""
    if surface.uv is None:
        return False
    uv = surface.uv.detach().cpu().double()[surface.faces.cpu()]
    (a, b), (c, d) = (uv[:, 1] - uv[:, 0]).T, (uv[:, 2] - uv[:, 0]).T
    return bool(2 * (a * d - b * c > 0).sum() > len(uv))
