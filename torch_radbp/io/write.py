"""Writes a scene as Mitsuba 3 XML or glTF, with the parameters' current values."""

from __future__ import annotations

import os
import re
import tempfile
import warnings
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import torch
from torch import Tensor, nn

from torch_radbp.formats.atomic import check_target, naming
from torch_radbp.formats.image import save_image
from torch_radbp.formats.mesh_arrays import MeshArrays
from torch_radbp.formats.ply import write_ply
from torch_radbp.formats.volume import UNIT_BOX, write_volume
from torch_radbp.io.gltf.read import said
from torch_radbp.io.gltf.write import gltf_files
from torch_radbp.io.values.attribute_values import is_list, is_named, options
from torch_radbp.plugin import REGISTRY, Filename, Matrix4, Plugin, Point3, SceneError, attributes
from torch_radbp.public_call import public_call
from torch_radbp.scene.modules.scene import Scene
from torch_radbp.texture.rgb import RGB
from torch_radbp.transforms import transform_normals, transform_points

VERSION = "3.0.0"
FILED = ("data", "grid")  # attributes that are written as files
# So that what is referred to comes first.
ORDER = ("texture", "volume", "phase", "medium", "bsdf", "sensor", "emitter", "shape")
MESH_PARAMETERS = ("vertex_positions", "vertex_normals", "vertex_texcoords")


@public_call
def save(scene: Scene, path: str | os.PathLike, strict: bool = False) -> None:
    """Writes a scene as Mitsuba 3 XML or as glTF 2.0, by the extension of the file's name.

    XML is loaded to the same image by this package and by Mitsuba 3, which refuses what it does not have: the filter
    `trilinear` of bitmaps, and sensors `calibrated` that no `perspective` is exactly, since they are distorted or their
    pixels are not square; others are written as `perspective`. Bitmaps are written beside it as EXR, values on a grid as
    VOL, and meshes as PLY in world space, where their pose has put them, with the normals that they have now; all named
    after the scene and the object and all float32 (PLY: of the parameter's dtype). The saved scene needs no file of the
    original one.

    glTF has shapes as meshes under their pose, materials as metallic-roughness and its extensions, textures as PNG of 8 bits
    inside the file, lights and cameras, under the names that they have in the scene; a .gltf has a .bin beside it. An
    environment map, of which glTF has none, is an EXR beside it, which `load` finds there. What glTF cannot say is listed in
    one `GltfWarning`: `torch_radbp.io.gltf.surface` has the table. Settings of the renderer, samplers and filters are not
    written.

    Nothing is left half-written: files appear when all of them are complete, the one called `path` last.

    Args:
        scene: as it is now; parameters that are outputs of other modules are evaluated.
        path: the .xml, .glb or .gltf file; its folder must exist.
        strict: raise an error about what glTF cannot say, or what Mitsuba lacks, instead of a warning.

    Raises:
        SceneError: if something has no counterpart in the format (a network in the place of a texture), or is not finite.
        ValueError: if `path` has another extension.
        FileNotFoundError: if the folder does not exist.
        OSError: names `path` if a file of the scene cannot be written.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in WRITERS:
        raise ValueError(f"{path}: a scene is written as .xml, .glb or .gltf, got {path.suffix!r}")
    check_target(path)
    with naming(path), tempfile.TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as folder:
        for file in WRITERS[suffix](scene, Path(folder) / path.name, strict):
            os.replace(file, path.parent / file.name)


def xml_files(scene: Scene, target: Path, strict: bool) -> list[Path]:
    """Writes a scene as XML, in a folder of its own; returns all files, `target` last."""
    writer = _Writer(scene, target.stem, target.parent)
    with torch.no_grad(), torch.device("cpu"):
        root = writer.scene_element()
    if writer.lacking:
        message = f"{target.name}: Mitsuba cannot read this file: {said(writer.lacking)}"
        if strict:
            raise SceneError(message)
        warnings.warn(f"{message}; torch_radbp can", UserWarning, stacklevel=3)
    ElementTree.indent(root, "    ")
    target.write_bytes(ElementTree.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n")
    return [*writer.files, target]


WRITERS = {".xml": xml_files, ".glb": gltf_files, ".gltf": gltf_files}


class _Writer:
    def __init__(self, scene: Scene, stem: str, folder: Path):
        self.scene, self.stem, self.folder = scene, stem, folder
        self.ids = {id(child): name for name, child in scene.named_children()}
        plugins = [module for module in scene.modules() if isinstance(module, Plugin)]
        owners = Counter(id(part) for plugin in plugins for part in _parts(plugin))
        self.shared = {part for part, count in owners.items() if count > 1}
        self.used = {*self.ids.values(), *(plugin.id for plugin in plugins)}
        self.files: list[Path] = []
        self.lacking: list[str] = []  # what Mitsuba has no counterpart of

    def scene_element(self) -> ElementTree.Element:
        """The XML of the whole scene."""
        root = ElementTree.Element("scene", version=VERSION)
        root.append(self.plugin_element(self.scene.integrator, "integrator"))
        children = [(name, child) for name, child in self.scene.named_children() if self.check(name, child)]
        for name, child in sorted(children, key=lambda item: ORDER.index(item[1].category)):
            element = self.plugin_element(child, name)
            element.set("id", _text(name))
            root.append(element)
        return root

    def check(self, name: str, module: nn.Module) -> bool:
        """True if a module is a registered plugin, which can be written."""
        if not isinstance(module, Plugin) or not module.type:
            raise SceneError(f"{name}: a {type(module).__name__} cannot be written as XML, only Mitsuba's plugins can; "
                             "save its `state_dict()` with torch.save or safetensors, or put a bitmap in its place")
        return True

    def plugin_element(self, plugin: Plugin, name: str) -> ElementTree.Element:
        """The XML of a plugin called `name`, with the attributes that differ from their defaults."""
        try:
            plugin = plugin.for_mitsuba()
        except ValueError as error:
            self.lacking.append(f"{name}: {error}")
        if hasattr(plugin, "vertex_positions") and not _is_as_constructed(plugin):
            return self.mesh_element(plugin, name)
        if isinstance(plugin, RGB):
            element = ElementTree.Element("texture", type="rawconstant")
            kind = "float" if plugin.value.ndim == 0 else "vector"
            ElementTree.SubElement(element, kind, name="value", value=_numbers(plugin.value, name))
            return element
        element = ElementTree.Element(plugin.category, type=plugin.type)
        for attribute in attributes(type(plugin)):
            if attribute not in FILED or not hasattr(plugin, attribute):
                self.add(element, plugin, attribute, name)
        for attribute in FILED:
            if getattr(plugin, attribute, None) is not None:
                file = self.values_file(plugin, attribute, name)
                ElementTree.SubElement(element, "string", name="filename", value=_text(file.name))
        return element

    def values_file(self, plugin: Plugin, attribute: str, name: str) -> Path:
        """Writes an image as EXR, or values on a grid as VOL, and returns the file."""
        values = getattr(plugin, attribute)
        if values.ndim == 3:
            file = self.file(name, ".exr")
            save_image(file, values.movedim(-1, 0))
            return file
        if not torch.isfinite(values).all():
            raise SceneError(f"{name}.{attribute}: not written, it has values that are NaN or infinite")
        file = self.file(name, ".vol")
        write_volume(file, values.detach().cpu().numpy(), getattr(plugin, "box", UNIT_BOX))
        return file

    def mesh_element(self, plugin: Plugin, name: str) -> ElementTree.Element:
        """The XML of a mesh, which is written as a PLY file; without vertex normals it is marked flat."""
        surface = plugin.triangles()
        arrays = (surface.vertices, surface.normals, surface.uv)
        for parameter, values in zip(MESH_PARAMETERS, arrays, strict=True):
            if values is not None and not torch.isfinite(values).all():
                raise SceneError(f"{name}.{parameter}: not written, it has values that are NaN or infinite")
        positions, normals, uv = (None if values is None else values.detach().cpu().numpy() for values in arrays)
        file = self.file(name, ".ply")
        attributes = {key: values.detach().cpu().numpy() for key, values in surface.attributes}
        for key, values in attributes.items():
            if not np.isfinite(values).all():
                raise SceneError(f"{name}.{key}: not written, it has values that are NaN or infinite")
        write_ply(file, MeshArrays(positions, plugin.faces.cpu().numpy(), normals, uv, attributes))
        element = ElementTree.Element("shape", type="ply")
        ElementTree.SubElement(element, "string", name="filename", value=_text(file.name))
        if normals is None:
            ElementTree.SubElement(element, "boolean", name="face_normals", value="true")
        for attribute in ("flip_normals", "bsdf", "emitter", "interior", "exterior"):
            self.add(element, plugin, attribute, name)
        return element

    def add(self, element: ElementTree.Element, plugin: Plugin, attribute: str, name: str) -> None:
        """Appends the XML of one attribute of `plugin`, called `name`, unless it has its default value."""
        annotation, default, _ = attributes(type(plugin))[attribute]
        try:
            value = plugin.as_written(attribute)
        except ValueError as error:
            raise SceneError(f"{name}: not written, {error}") from error
        if is_list(annotation):
            for number, item in enumerate(value):
                element.append(self.nested(item, attribute, f"{name}.{attribute}_{number}"))
        elif is_named(annotation):
            for key, item in value.items():
                element.append(self.nested(item, attribute, f"{name}.{key}"))
                element[-1].set("name", _text(key))
        elif isinstance(value, nn.Module):
            element.append(self.nested(value, attribute, f"{name}.{attribute}"))
        elif value is not None and Filename not in options(annotation) and not _is_default(value, annotation, default):
            element.append(_value_element(attribute, value, annotation, f"{name}.{attribute}"))

    def nested(self, plugin: nn.Module, attribute: str, name: str) -> ElementTree.Element:
        """The XML of a nested plugin: a reference, a plain colour or an element of its own."""
        if id(plugin) in self.ids:
            element = ElementTree.Element("ref", id=_text(self.ids[id(plugin)]))
        elif self.check(name, plugin) and isinstance(plugin, RGB) and id(plugin) not in self.shared:
            return _colour_element(attribute, plugin.value, name)
        else:
            element = self.plugin_element(plugin, name)
            if plugin.id is not None or id(plugin) in self.shared:  # others may refer to it, or do
                self.ids[id(plugin)] = self.new_id(name) if plugin.id is None else plugin.id
                element.set("id", _text(self.ids[id(plugin)]))
        categories = ("texture", "volume", "medium")  # told apart by names
        if isinstance(plugin, Plugin) and plugin.category in categories and attribute != plugin.category:
            element.set("name", attribute)
        return element

    def new_id(self, name: str) -> str:
        """An id made of `name` that no other object has, without the dots that Mitsuba refuses."""
        unused = name.replace(".", "_")
        while unused in self.used:
            unused += "_"
        self.used.add(unused)
        return unused

    def file(self, name: str, suffix: str) -> Path:
        """A new path for a file of the scene."""
        used = {file.name for file in self.files}
        stem = f"{self.stem}_{re.sub(r'[^A-Za-z0-9_.-]', '_', name)}"
        while f"{stem}{suffix}" in used:
            stem += "_"
        self.files.append(self.folder / f"{stem}{suffix}")
        return self.files[-1]


def _parts(plugin: Plugin) -> Iterator[nn.Module]:
    """The modules that are attributes of a plugin, shared ones included."""
    for name, attribute in attributes(type(plugin)).items():
        value = getattr(plugin, name, None)
        if isinstance(value, nn.Module) and not is_list(attribute.annotation) and not is_named(attribute.annotation):
            yield value
        elif is_list(attribute.annotation):
            yield from value
        elif is_named(attribute.annotation):
            yield from value.values()


def _is_as_constructed(plugin: Plugin) -> bool:
    """True if a mesh still is what its constructor makes of its plain attributes: an unchanged cube, never a file's mesh.

    It may have been made in either dtype, whatever torch's default dtype is now.
    """
    schema = attributes(type(plugin))
    if any(attribute.required or Tensor in options(attribute.annotation) for attribute in schema.values()):
        return False
    plain = {name: getattr(plugin, name) for name in schema if not isinstance(getattr(plugin, name), nn.Module)}
    fresh = REGISTRY[plugin.category][plugin.type](**plain | {"to_world": None})

    def made_in(dtype: torch.dtype) -> bool:
        matrix = plugin.to_world.detach().cpu().to(dtype)
        made = {"vertex_positions": transform_points(matrix, fresh.vertex_positions.to(dtype)),
                "vertex_texcoords": fresh.vertex_texcoords, "faces": fresh.faces}
        if fresh.has_normals:
            made["vertex_normals"] = transform_normals(matrix, fresh.vertex_normals.to(dtype))
        return all(_equal(getattr(plugin, name), value) for name, value in made.items())

    return made_in(torch.float32) or made_in(torch.float64)


def _is_default(value: Any, annotation: Any, default: Any) -> bool:
    if default is None and Matrix4 in options(annotation):
        default = torch.eye(4, dtype=value.dtype, device=value.device)
    return _equal(value, default)


def _equal(value: Any, other: Any) -> bool:
    if isinstance(value, Tensor) and isinstance(other, Tensor | int | float):
        other = torch.as_tensor(other, device=value.device).to(value)
        return value.shape == other.shape and bool((value == other).all())
    return not isinstance(value, Tensor) and not isinstance(other, Tensor) and value == other


def _value_element(name: str, value: Any, annotation: Any, place: str) -> ElementTree.Element:
    """The XML of a plain value, such as a number, a vector or a transform."""
    kinds = options(annotation)
    if Matrix4 in kinds:
        element = ElementTree.Element("transform", name=name)
        ElementTree.SubElement(element, "matrix", value=_numbers(value, place, " "))
        return element
    if Point3 in kinds:
        return ElementTree.Element("point", name=name, value=_numbers(value, place))
    if bool in kinds:
        return ElementTree.Element("boolean", name=name, value="true" if value else "false")
    if int in kinds:
        return ElementTree.Element("integer", name=name, value=str(int(value)))
    if float in kinds:
        return ElementTree.Element("float", name=name, value=_numbers(value, place))
    if str in kinds:
        text = _numbers(value, place) if isinstance(value, Tensor) else _text(value)
        return ElementTree.Element("string", name=name, value=text)
    raise SceneError(f"{place}: a {type(value).__name__} cannot be written as XML")


def _colour_element(name: str, value: Tensor, place: str) -> ElementTree.Element:
    return ElementTree.Element("float" if value.ndim == 0 else "rgb", name=name, value=_numbers(value, place))


def _numbers(values: Any, place: str, separator: str = ", ") -> str:
    """Numbers as text, with as many digits as restore the same value of their dtype."""
    array = np.ravel(values.detach().cpu().numpy() if isinstance(values, Tensor) else np.float64(values))
    if not np.isfinite(array).all():
        raise SceneError(f"{place}: not written, it is NaN or infinite: {array.tolist()}")
    return separator.join(str(number) for number in array)


def _text(text: str) -> str:
    """Escapes a text so that it is not read as a variable."""
    return str(text).replace("$", "\\$")
