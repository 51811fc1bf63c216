"""Builds a scene from Mitsuba's dict vocabulary, for XML and dicts alike.

Nothing here knows a plugin: types come from the registry, attributes from the constructors' signatures.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import Any

from torch import nn

import torch_radbp.io.absent  # noqa: F401 (registers why plugins are missing)
from torch_radbp.formats.files import otherwise_spelled
from torch_radbp.formats.leniency import Repairs
from torch_radbp.io.gltf.document import Losses
from torch_radbp.io.gltf.names import Names
from torch_radbp.io.gltf.read import said
from torch_radbp.io.trimesh_shape import Looks, with_arrays, with_shapes
from torch_radbp.io.values.attribute_values import (
    convert,
    is_list,
    is_named,
    options,
    plugin_categories,
    value_text,
    with_article,
)
from torch_radbp.io.values.bitmap_object import is_bitmap_object, linear_values
from torch_radbp.io.values.colour_values import colour_value, is_colour
from torch_radbp.io.values.spd import read_spectrum
from torch_radbp.io.xml_scene import XMLObject, find_file
from torch_radbp.plugin import (
    ABSENT,
    REGISTRY,
    Emitter,
    Filename,
    Plugin,
    SceneError,
    SceneWarning,
    Sensor,
    attributes,
    nearest,
    no_gradient,
)
from torch_radbp.scene.modules.scene import Scene
from torch_radbp.shape.mesh import TensorMesh

MAX_DEPTH = 100  # of objects in objects, references followed
MAX_OBJECTS = 100_000

PLACE_OF = {"medium": "; a medium is the interior or exterior of a shape, or that of the sensors"}
PARTS_OF_SENSORS = ("sampler", "film", "rfilter")  # stand there to be referred to


def build_scene(description: dict[str, Any], base_dir: str | os.PathLike | None = None) -> Scene:
    """The scene that a dict of Mitsuba's vocabulary describes.

    Args:
        description: {"type": "scene", name: object, ...}; an object is a dict with "type", or a plugin already made.
        base_dir: folder of relative file names in dicts; the current one if None.

    Raises:
        SceneError: names the place (XML: file, line and element; dict: path of keys) and what is supported.
    """
    return _Builder(description, Path(base_dir or ".")).scene()


def build_plugin(description: dict[str, Any], category: str) -> Plugin:
    """Builds one object of a category from a dict, without a scene; its parameters have torch's default dtype.

    Raises:
        SceneError: as `build_scene`.
    """
    builder = _Builder({category: description}, Path("."))
    builder.collect_ids((), builder.description)
    return builder.plugin((category,), description, [category])


class _Builder:
    def __init__(self, description: dict[str, Any], base_dir: Path):
        self.description = description
        self.base_dir = base_dir
        self.ids: dict[str, tuple[tuple[str, ...], Any]] = {}  # id -> key path and object
        self.built: dict[tuple[str, ...], Plugin] = {}  # by key path
        self.open: list[str] = []  # ids of the references being followed
        self.losses = Losses()  # of meshes of trimesh
        self.looks = Looks(self.losses, Names(), {})
        self.depth = self.objects = 0  # of the object being made, and how many there are, to be limited

    def scene(self) -> Scene:
        """Builds all objects of the top level, and the `Scene` of them."""
        root = self.description
        if not isinstance(root, dict) or root.get("type") != "scene":
            got = repr(root.get("type")) if isinstance(root, dict) else type(root).__name__
            raise SceneError(f"a scene dict must have \"type\": \"scene\" and contain its objects by name, got {got}")
        self.collect_ids((), root)
        for name, value in with_shapes(root):
            if name not in self.ids and _is_object(value) and not _is_reference(value):
                self.ids[name] = ((name,), value)  # which has another id as well
        children: dict[str, Plugin] = {}
        integrators: list[str] = []
        for name, value in with_shapes(root):
            if name == "type":
                continue
            if not _is_object(value):
                raise self.error((name,), value, f"a scene takes only objects, dicts with a \"type\", got "
                                 f"{value_text(value)}{_advice(value)}")
            if _is_reference(value):
                raise self.error((name,), value, "a reference cannot stand directly in the scene; put it inside the "
                                 "object that uses it")
            plugin = self.plugin((name,), value, REGISTRY)
            if plugin.category not in PARTS_OF_SENSORS:
                children[name] = plugin
            if plugin.category == "integrator":
                integrators.append(name)
        if len(integrators) > 1:
            raise self.error((integrators[1],), root[integrators[1]], "the scene already has an integrator; keep one")
        integrator = children.pop(integrators[0]) if integrators else None
        warn_of_poles(children)
        if losses := list(self.losses):
            with Repairs() as repairs:
                strict = repairs.strict
            if strict:
                raise SceneError(said(losses))
            warnings.warn(said(losses), SceneWarning, stacklevel=5)
        try:
            return Scene(children, integrator=integrator)
        except ValueError as error:
            raise self.error((), root, str(error)) from error

    def collect_ids(self, path: tuple[str, ...], node: dict[str, Any]) -> None:
        """Collects all objects that references may name: top-level ones by key, others by "id"."""
        if len(path) > MAX_DEPTH:
            raise self.error(path[:3], node, f"objects are nested more than {MAX_DEPTH} deep; does a dict contain itself?")
        self.objects += 1
        if self.objects > MAX_OBJECTS:
            raise self.error(path[:3], node, f"the scene has more than {MAX_OBJECTS} objects; a dict that stands in several "
                             "places makes an object in each: give it an id and refer to it")
        for key, value in with_shapes(node):
            if not isinstance(key, str):
                raise self.error(path, node, f"keys must be strings, got {key!r}")
            if not _is_object(value) or _is_reference(value):
                continue
            name = _given_id(value) or (key if not path else None)
            if name is not None and not isinstance(name, str):
                raise self.error((*path, key), value, f"an id must be a string, got {value_text(name)}")
            if name in self.ids:
                other = self.place(self.ids[name][0], self.ids[name][1])
                raise self.error((*path, key), value, f"the id {name!r} is already taken by {other}; use another")
            if name is not None:
                self.ids[name] = ((*path, key), value)
            if isinstance(value, dict):
                self.collect_ids((*path, key), value)

    def plugin(self, path: tuple[str, ...], value: Any, expected: Iterable[str]) -> Plugin:
        """Builds the object at `path`, of one of the categories `expected`; once however often it is used."""
        if _is_reference(value):
            return self.referenced(path, value, expected)
        if isinstance(value, dict) and path not in self.built:
            cls = self.plugin_class(path, value, expected)
            self.depth += 1
            if self.depth > MAX_DEPTH:
                raise self.error(path, value, f"objects are nested more than {MAX_DEPTH} deep, references followed")
            arguments = self.arguments(path, value, cls)
            if isinstance(value, XMLObject):
                with Repairs() as repairs:
                    arguments = cls.of_file(arguments, partial(repairs.add, self.place(path, value)))
            self.depth -= 1
            try:
                self.built[path] = cls(**with_arrays(arguments, self.looks) if cls is TensorMesh else arguments)
            except (ValueError, TypeError, RuntimeError, OSError, ImportError) as error:
                raise self.error(path, value, _with_file(str(error), cls, arguments)) from error
            self.check_live(path, value, arguments, self.built[path])
            self.built[path].id = _given_id(value)
        plugin = self.built[path] if isinstance(value, dict) else value
        if not isinstance(plugin, Plugin) and ("texture" not in expected or len(path) == 1):
            raise self.error(path, value, f"a {type(plugin).__name__} cannot stand here; supported: {', '.join(expected)}")
        if isinstance(plugin, Plugin) and plugin.category not in expected:
            got = with_article(plugin.category)
            raise self.error(path, value, f"{got} cannot stand here; supported: {', '.join(expected)}")
        return plugin

    def check_live(self, path: tuple[str, ...], node: dict[str, Any], arguments: dict[str, Any], plugin: Plugin) -> None:
        """Raises SceneError if an `nn.Parameter` was given that has not become a parameter of the plugin."""
        ids = {id(parameter) for parameter in plugin.parameters()}
        for key, value in arguments.items():
            if isinstance(value, nn.Parameter) and id(value) not in ids:
                raise self.error((*path, key), node, str(no_gradient(key)), key)

    def referenced(self, path: tuple[str, ...], value: dict[str, Any], expected: Iterable[str]) -> Plugin:
        """Builds the object that a reference names."""
        unknown = [str(key) for key in value if key not in ("type", "id")]
        name = value.get("id")
        if unknown or not isinstance(name, str):
            raise self.error(path, value, "a reference has the entries type and id, a string, got "
                             f"{', '.join([f'id {value_text(name)}', *unknown])}")
        if name not in self.ids:
            raise self.error(path, value, f"no object has the id {name!r}; {nearest(name, self.ids)}")
        if name in self.open:
            raise self.error(path, value, f"references in a circle: {' -> '.join([*self.open, name])}")
        target_path, target = self.ids[name]
        self.open.append(name)
        plugin = self.plugin(target_path, target, REGISTRY)
        self.open.pop()
        if plugin.category not in expected:
            raise self.error(path, value, f"{name!r} is {with_article(plugin.category)}, which cannot stand here; "
                             f"supported: {', '.join(expected)}")
        return plugin

    def plugin_class(self, path: tuple[str, ...], node: dict[str, Any], expected: Iterable[str]) -> type[Plugin]:
        """The plugin class of an object, by its type and, in XML, its tag."""
        name = str(node["type"])
        tag = node.category if isinstance(node, XMLObject) else None
        if tag is not None and tag not in expected:
            raise self.error(path, node, f"{with_article(tag)} cannot stand here; supported: {', '.join(expected)}"
                             f"{PLACE_OF.get(tag, '')}")
        possible = [tag] if tag else list(expected)
        plugin_class = next((REGISTRY[category][name] for category in possible if name in REGISTRY[category]), None)
        if plugin_class is not None:
            return plugin_class
        elsewhere = next((category for category in REGISTRY if name in REGISTRY[category]), None)
        if elsewhere and tag:
            raise self.error(path, node, f"{name!r} is {with_article(elsewhere)}, not {with_article(tag)}; "
                             f"write <{elsewhere} type=\"{name}\">")
        if elsewhere:
            raise self.error(path, node, f"{name!r} is {with_article(elsewhere)}, which cannot stand here; supported: "
                             f"{', '.join(expected)}{PLACE_OF.get(elsewhere, '')}")
        known = [known for category in possible for known in REGISTRY[category]]
        missing = next((category for category, other in ABSENT if other == name and (not tag or category == tag)), None)
        if missing is not None:
            instead = f"; known: {', '.join(sorted(REGISTRY[missing]))}" if missing in REGISTRY else ""
            raise self.error(path, node, f"the {missing} type {name!r} is not supported: {ABSENT[missing, name]}{instead}")
        raise self.error(path, node, f"the {'/'.join(possible)} type {name!r} is not supported; "
                         f"{nearest(name, known)}")

    def arguments(self, path: tuple[str, ...], node: dict[str, Any], cls: type[Plugin]) -> dict[str, Any]:
        """The constructor's arguments for an object, all checked against the schema of its class."""
        schema = attributes(cls)
        arguments: dict[str, Any] = {}
        for key, value in with_shapes(node):
            if key in ("type", "id"):
                continue
            if _is_object(value) and not is_colour(value):
                name, nested = self.nested((*path, key), key, value, node, cls)
                if is_list(schema[name].annotation):
                    arguments.setdefault(name, []).append(nested)
                    continue
                if is_named(schema[name].annotation):
                    arguments.setdefault(name, {})[_given_id(value) or key] = nested
                    continue
                if name in arguments:
                    raise self.error((*path, key), value, f"{node['type']} takes one {name}, and has one already")
                arguments[name] = nested
            elif key not in schema:
                message = f"{node['type']} has no attribute {key!r}; {nearest(key, schema)}{_advice(value)}"
                raise self.error((*path, key), node, message, key)
            else:
                arguments[key] = self.value(path, key, value, node, cls)
        for name, attribute in schema.items():
            if attribute.required and name not in arguments:
                raise self.error(path, node, f"{node['type']} needs {name!r}, which is missing; it has the attributes "
                                 f"{', '.join(schema)}")
        return arguments

    def nested(self, path: tuple[str, ...], key: str, value: Any, parent: dict[str, Any],
               cls: type[Plugin]) -> tuple[str, Plugin]:
        """Builds a nested object, and finds its attribute: by its name, or else by its category."""
        schema = attributes(cls)
        accepted = {name: plugin_categories(attribute.annotation) for name, attribute in schema.items()}
        if accepted.get(key):
            return key, self.plugin(path, value, accepted[key])
        # Textures are told apart by their names, so that only the other categories are found without one.
        expected = [category for name in accepted for category in accepted[name]
                    if category != "texture" or name == cls.object_of_any_name]
        is_texture = isinstance(value, XMLObject) and value.category == "texture"
        if key in schema or (is_texture and cls.object_of_any_name is None) or not expected:
            takes = f"{key!r} is a plain value" if key in schema else nearest(key, schema)
            instead = f"; {cls.instead_of_objects}" if cls.instead_of_objects else ""
            raise self.error(path, value, f"{parent['type']} does not take an object called {key!r}; {takes}{instead}")
        plugin = self.plugin(path, value, list(dict.fromkeys(expected)))
        category = getattr(plugin, "category", "texture")  # a plain module stands for a texture
        places = [name for name in accepted if category in accepted[name]]
        if len(places) > 1 and category in PLACE_OF:
            raise self.error(path, value, f"{parent['type']} has {with_article(category)} in each of {', '.join(places)}: "
                             "call it by one of these names")
        return places[0], plugin

    def value(self, path: tuple[str, ...], key: str, value: Any, node: dict[str, Any], cls: type[Plugin]) -> Any:
        """Converts the attribute `key` of the object `node` at `path`: a plain value or a colour, as annotated."""
        annotation = attributes(cls)[key].annotation
        try:
            if is_colour(value):
                value = self.colour(key, value, node, cls)
            elif is_bitmap_object(value):
                value = linear_values(value, raw=node.get("raw") is True)
            converted = convert(key, value, annotation)
            is_file = Filename in options(annotation) and converted is not None
            return self.file(key, converted, node) if is_file else converted
        except (ValueError, TypeError, OSError) as error:
            raise self.error((*path, key), node, f"{error}{_advice(value)}", key) from error

    def file(self, key: str, name: str, node: dict[str, Any]) -> str:
        """The path of a file that the object `node` names."""
        folders = node.folders if isinstance(node, XMLObject) else [self.base_dir]
        path = find_file(name, folders)
        if path is None:
            looked = ", ".join(str(folder.resolve()) for folder in folders)
            like = next(filter(None, (otherwise_spelled(folder / name) for folder in folders)), None)
            raise ValueError(f"{key} {value_text(name)} not found; looked in {looked}"
                             f"{f'; did you mean {like}?' if like else ''}")
        return str(path)

    def colour(self, key: str, value: dict[str, Any], node: dict[str, Any], cls: type[Plugin]) -> Any:
        """Converts a colour to one number, three, or a spectrum, for the attribute `key` of the object `node`."""
        if value["type"] == "spectrum" and set(value) == {"type", "filename"}:
            return read_spectrum(self.file("filename", convert("filename", value["filename"], str), node))
        return colour_value(key, value, of_emitter=cls.category == "emitter")

    def place(self, path: tuple[str, ...], node: Any, key: str | None = None) -> str:
        """The place of an object for messages: the line of the XML file, or the path of keys in the dict."""
        if isinstance(node, XMLObject):
            if key in node.places:
                kind = "".join(f' {name}="{node[name]}"' for name in ("type", "id") if name in node)
                return f"{node.places[key]} of <{node.element.tag}{kind}>"
            return str(node.element)
        kind = f" (type {node['type']!r})" if isinstance(node, dict) and "type" in node and path and key is None else ""
        return (".".join(path) or "scene dict") + kind

    def error(self, path: tuple[str, ...], node: Any, message: str, key: str | None = None) -> SceneError:
        """The error about an object, or about its attribute `key`."""
        return SceneError(f"{self.place(path, node, key)}: {message}")


def warn_of_poles(children: dict[str, Plugin]) -> None:
    """Warns of an environment whose pole is not at the data set's up direction."""
    ups = {child.up for child in children.values() if isinstance(child, Sensor)} - {None}
    for name, child in children.items():
        pole = child.up() if isinstance(child, Emitter) else None
        for up in ups if pole is not None else ():
            if float(pole @ pole.new_tensor(up)) < 0.5 * float(pole.norm()):
                warnings.warn(f"{name}: its pole is {value_text(pole.tolist())}, but in the world of the cameras "
                              f"{value_text(up)} points up; turn it, with "
                              "to_world=[[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]] from y to z", stacklevel=5)


def _is_object(value: Any) -> bool:
    return isinstance(value, nn.Module) or (isinstance(value, dict) and "type" in value)


def _is_reference(value: Any) -> bool:
    return isinstance(value, dict) and value.get("type") == "ref"


def _with_file(message: str, cls: type[Plugin], arguments: dict[str, Any]) -> str:
    """The message with the name of the file that the object is made of, if that is missing."""
    schema = attributes(cls)
    files = [value for name, value in arguments.items() if Filename in options(schema[name].annotation)]
    return ": ".join([*(file for file in files if isinstance(file, str) and file not in message), message])


def _advice(value: Any) -> str:
    """What to do about an object that Mitsuba has already made, for an error message."""
    is_made = type(value).__module__.startswith("mitsuba") and hasattr(value, "class_name")
    if is_made and hasattr(value, "vertex_positions_buffer"):
        return ("; a mesh that Mitsuba has made is given as {\"type\": \"mesh\"} with arrays: vertex_positions of its "
                "vertex_positions_buffer(), (V, 3), and faces of its faces_buffer(), (F, 3)")
    return "; what Mitsuba has made of a description cannot be read: give the description, a dict" if is_made else ""


def _given_id(value: Any) -> str | None:
    return value.get("id") if isinstance(value, dict) else getattr(value, "id", None)
