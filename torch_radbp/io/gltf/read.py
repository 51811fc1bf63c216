"""Reads a glTF file into a scene."""

from __future__ import annotations

import itertools
import os
import warnings
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

from torch_radbp.emitter.area import Area
from torch_radbp.emitter.constant import Constant
from torch_radbp.integrator.path import Path as PathIntegrator
from torch_radbp.io.gltf.accessor import Buffers
from torch_radbp.io.gltf.container import read_container
from torch_radbp.io.gltf.document import Document, DocumentPart, GltfWarning, Losses, without_nulls
from torch_radbp.io.gltf.environment import environment
from torch_radbp.io.gltf.extension import check_extensions
from torch_radbp.io.gltf.lamp import emitter_of_light, overview, sensor_of_camera
from torch_radbp.io.gltf.material import VERTEX_COLOUR, GltfMaterials
from torch_radbp.io.gltf.names import Names
from torch_radbp.io.gltf.nodes import PlacedNode, instance_transforms, placed_nodes
from torch_radbp.io.gltf.picture import Pictures
from torch_radbp.io.gltf.primitive import SETS, Primitive, Primitives
from torch_radbp.io.gltf.texture import GltfTextures
from torch_radbp.plugin import Integrator, Plugin, SceneError, nearest
from torch_radbp.scene.modules.scene import Scene
from torch_radbp.shape.mesh import Mesh, TensorMesh, has_area

LISTED = 20  # losses in a message


class Options(NamedTuple):
    """Settings for what a glTF file does not contain."""

    resolution: int | None = None  # pixels of the longer side of the image; None: as `save` has noted, or 512
    spp: int = 16  # samples per pixel
    max_depth: int = -1  # see the integrator `path`
    light: float | None = None  # radiance of a constant environment; None: the file's lights, or 1 if it has none at all
    camera: bool = True  # False: ignore the file's cameras, and frame the scene
    scene: int | None = None  # index of the scene in the file
    lumens_per_watt: float = 1.0  # see `lamp`


def gltf_options(file: str, given: dict[str, Any]) -> Options:
    """The options from keyword arguments, or from text on a command line.

    Raises:
        SceneError: on unknown names and values of another type.
    """
    values = {}
    for name, value in given.items():
        if name not in Options._fields:
            raise SceneError(f"{file}: a glTF file has no variables, and there is no option {name!r}; "
                             f"{nearest(name, Options._fields)}")
        values[name] = option(file, name, value)
    return Options(**values)


def option(file: str, name: str, value: Any) -> Any:
    """Converts one option of a glTF reader from text, or checks its type."""
    if name == "camera":
        words = {"true": True, "false": False}
        value = words.get(value, value) if isinstance(value, str) else value
        if not isinstance(value, bool):
            raise SceneError(f"{file}: the option {name} must be true or false, got {value!r}")
        return value
    kind, word = (float, "a number") if name in ("light", "lumens_per_watt") else (int, "an integer")
    try:
        if isinstance(value, bool) or (kind is int and isinstance(value, float)):
            raise ValueError
        number = kind(value)
    except (TypeError, ValueError):
        raise SceneError(f"{file}: the option {name} must be {word}, got {value!r}") from None
    least = {"max_depth": -1, "light": 0, "scene": 0, "lumens_per_watt": 1e-6}.get(name, 1)
    if not least <= number < 1e6:
        raise SceneError(f"{file}: the option {name} must be at least {least}, got {value!r}")
    return number


def read_gltf(path: str | os.PathLike, given: dict[str, Any], allow_outside: bool = False, strict: bool = False) -> Scene:
    """Reads a scene from a glTF file.

    Args:
        path: the .glb or .gltf file.
        given: see `Options`.
        allow_outside: read files that do not lie in the folder of this one, or below.
        strict: an error instead of a warning about what cannot be read.

    Raises:
        SceneError: names the file and the place in its document.
    """
    file = os.fspath(path)
    chosen = gltf_options(file, given)
    return _Reader(file, chosen, allow_outside, strict).scene()


class _Reader:
    def __init__(self, file: str, chosen: Options, allow_outside: bool, strict: bool):
        container = read_container(file)
        self.file, self.options, self.strict, self.losses = file, chosen, strict, Losses()
        self.document = Document(file, without_nulls(container.document, self.losses))
        check_extensions(self.document, self.losses)
        self.buffers = Buffers(self.document, container.binary, Path(file).parent, allow_outside)
        self.primitives = Primitives(self.buffers, self.losses)
        self.children: dict[str, Plugin] = {}
        self.names = Names()
        textures = GltfTextures(self.document, Pictures(self.document, self.buffers), self.losses)
        self.materials = GltfMaterials(self.document, textures, self.losses, self.names, self.children)
        self.low, self.high = np.full(3, np.inf), np.full(3, -np.inf)

    def scene(self) -> Scene:
        """Reads the scene; adds what is missing, and warns of what is lost."""
        placed = [place for place in placed_nodes(self.document, self.options.scene) if not self.is_hidden(place)]
        for place in placed:
            if place.visible:
                self.add_shapes(place)
        if not np.isfinite(self.low).all():
            raise SceneError(f"{self.file}: {said(['the scene has no triangles', *self.losses])}")
        for place in placed:
            if place.visible:
                self.add_light(place)
            if self.options.camera:
                self.add_camera(place)
        if self.document.items("animations"):
            self.losses.add("animations", "are not read: nodes stand where they begin")
        losses = list(self.losses)
        added = complete(self.children, self.names, (self.low, self.high), self.options)
        if losses and self.strict:
            raise SceneError(f"{self.file}: {said(losses)}")
        if losses or added:
            warnings.warn(f"{self.file}: {said([*losses, *added])}", GltfWarning, stacklevel=7)
        integrator: Integrator = PathIntegrator(max_depth=self.options.max_depth)
        try:
            return Scene(self.children, integrator)
        except ValueError as error:
            raise SceneError(f"{self.file}: {error}") from error

    def is_hidden(self, place: PlacedNode) -> bool:
        """True if a node's transform is singular, by which some writers hide its subtree."""
        linear = place.to_world[:3, :3]
        flat = abs(np.linalg.det(linear)) <= 1e-30 or not np.isfinite(linear).all()
        if flat:
            self.losses.add(place.node.place, "is left out: its transform flattens space")
        return flat

    def name(self, part: DocumentPart, other: DocumentPart, fallback: str) -> str:
        """A free name for an object at a node: the node's, or that of what it refers to."""
        return self.names.free(part.text("name", "") or other.text("name", "") or fallback)

    def add_shapes(self, place: PlacedNode) -> None:
        """Adds a shape for each primitive of the node's mesh; a mesh of several nodes is copied."""
        mesh = self.document.referred("meshes", place.node, "mesh", None)
        if mesh is None:
            return
        if place.node.has("skin"):
            self.losses.add(place.node.place, "its skin is not read: the mesh has the pose in which it was bound")
        parts = mesh.parts("primitives")
        title = place.node.text("name", "") or mesh.text("name", "") or f"mesh_{place.node.integer('mesh')}"
        if not parts:
            self.losses.add(mesh.place, "is left out: it has no primitives")
        copied = instance_transforms(place, self.buffers)
        for to_world, (number, part) in itertools.product(copied, enumerate(parts)):
            primitive, copy = self.primitives.of(part), place._replace(to_world=to_world)
            if primitive is None or (len(copied) > 1 and self.is_hidden(copy)):
                continue
            if not self.has_area(primitive, to_world):
                self.losses.add(part.place, "is left out: its triangles have no area")
                continue
            if np.linalg.det(to_world[:3, :3]) < 0:  # which mirrors: triangles face outwards still
                primitive = primitive._replace(faces=primitive.faces[:, [0, 2, 1]])
            colours = None if primitive.colour is None else VERTEX_COLOUR
            look = self.materials.look(part, colours, self.is_mirrored(part, primitive))
            name = self.names.free(title if len(parts) == 1 else f"{title}_{number}")
            uv = self.coordinates(part, primitive, look.uv_set)
            try:
                shape = self.shape(primitive, to_world, uv, look.bsdf)
                if look.radiance is not None:
                    shape.emitter = Area(radiance=look.radiance)
                if primitive.colour is not None:
                    shape.add_attribute(VERTEX_COLOUR, torch.from_numpy(primitive.colour * look.factor))
            except (ValueError, RuntimeError) as error:
                raise part.fail(f"{place.node.place}: {error}") from error
            self.children[name] = shape
            corners = shape.vertex_positions.detach().double().numpy()
            self.low, self.high = np.minimum(self.low, corners.min(0)), np.maximum(self.high, corners.max(0))

    def has_area(self, primitive: Primitive, to_world: np.ndarray) -> bool:
        """True if a triangle has an area in the world, in the scene's precision, or corners that are not finite."""
        world = torch.from_numpy(primitive.positions @ to_world[:3, :3].T + to_world[:3, 3]).to(torch.get_default_dtype())
        return not bool(world.isfinite().all()) or has_area(world, torch.from_numpy(np.ascontiguousarray(primitive.faces)))

    def shape(self, primitive: Primitive, to_world: np.ndarray, uv: np.ndarray | None, bsdf: Plugin) -> Mesh:
        """Makes a mesh from a primitive."""
        moved = not np.array_equal(to_world, np.eye(4))
        shape = TensorMesh(
            vertex_positions=torch.from_numpy(primitive.positions),
            faces=torch.from_numpy(np.ascontiguousarray(primitive.faces)),
            vertex_normals=None if primitive.normals is None else torch.from_numpy(primitive.normals),
            vertex_texcoords=None if uv is None else torch.from_numpy(np.asarray(uv, dtype=np.float64)),
            to_world=torch.from_numpy(to_world) if moved else None, bsdf=bsdf)
        for name, values in primitive.custom.items():
            shape.add_attribute(f"vertex_{name}", torch.from_numpy(values))
        return shape

    def coordinates(self, part: DocumentPart, primitive: Primitive, number: int | None) -> np.ndarray | None:
        """The texture coordinates of a primitive: the set that its textures read, or the first without textures."""
        uv = primitive.uv[number or 0] if (number or 0) < len(primitive.uv) else None
        if uv is None and number is not None:
            lacks = "which it does not have" if number < SETS else f"of which only the first {SETS} are read"
            self.losses.add(part.place, "textures of its material are read at (0, 0) everywhere: they use "
                                        f"TEXCOORD_{number}, {lacks}")
            return np.zeros((len(primitive.positions), 2))
        return uv

    def is_mirrored(self, part: DocumentPart, primitive: Primitive) -> bool:
        """True if the normal map of a primitive is mirrored on most of its triangles.

        The y of a normal map points to where v falls in glTF, and across the direction of u here: that is the same where
        corners that are counter-clockwise on the surface are so in the image.
        """
        material = self.materials.material(part)
        number = material.part("normalTexture").integer("texCoord", 0)
        uv = primitive.uv[number] if number < len(primitive.uv) and material.has("normalTexture") else None
        if uv is None:
            return False
        return lies_mirrored(uv, primitive.faces, part.place, self.losses)

    def add_light(self, place: PlacedNode) -> None:
        """Adds the light of a node, or the environment map that it names."""
        if self.options.light is None:
            sky = self.checked(place.node, environment, place.to_world, self.buffers, self.losses)
            if sky is not None:
                self.children[self.name(place.node, place.node, "sky")] = sky
        reference, lights = (part.extension("KHR_lights_punctual") for part in (place.node, self.document))
        if reference is None:
            return
        if lights is None:
            raise place.node.fail("it refers to a light, but the document has no KHR_lights_punctual")
        number, entries = reference.integer("light"), lights.items("lights")
        if number >= len(entries):
            raise reference.fail(f"light {number} does not exist; there are {len(entries)}")
        part = DocumentPart(self.file, f"{lights.inside('lights')}[{number}]", entries[number])
        name = self.name(place.node, part, f"light_{number}")
        self.children[name] = self.checked(part, emitter_of_light, place.to_world, self.options.lumens_per_watt, self.losses)

    def add_camera(self, place: PlacedNode) -> None:
        """Adds the camera of a node."""
        part = self.document.referred("cameras", place.node, "camera", None)
        if part is None:
            return
        reach = 4 * float(np.abs([self.low - place.to_world[:3, 3], self.high - place.to_world[:3, 3]]).max())
        name = self.name(place.node, part, f"camera_{place.node.integer('camera')}")
        self.children[name] = self.checked(part, sensor_of_camera, place.to_world, self.options.resolution, self.options.spp,
                                           reach)

    def checked(self, part: DocumentPart, make, *arguments) -> Plugin:
        """Calls `make` for a part of the document; errors get its place."""
        try:
            return make(part, *arguments)
        except SceneError:
            raise
        except (ValueError, RuntimeError) as error:
            raise part.fail(str(error)) from error


def lies_mirrored(uv: np.ndarray, faces: np.ndarray, place: str, losses: Losses) -> bool:
    """True if a normal map read at (V, 2) uv, v down, is mirrored on most triangles; notes those that differ."""
    first, second, third = (uv[faces[:, corner]] for corner in range(3))
    (a, b), (c, d) = (second - first).T, (third - first).T
    mirrored = a * d - b * c > 0
    most = bool(2 * mirrored.sum() > len(mirrored))
    others = int((mirrored != most).sum())
    if others:
        losses.add(place, f"the normal map is read wrongly on {others} of {len(mirrored)} triangles, where it lies the "
                          "other way round")
    return most


def complete(children: dict[str, Plugin], names: Names, corners: tuple[np.ndarray, np.ndarray],
             options: Options) -> list[str]:
    """Adds the light and the camera that a scene lacks; returns sentences about these.

    Args:
        children: of the scene; filled in.
        names: those in use.
        corners: (3,) least and (3,) greatest coordinates of the scene.
        options: whether and how.
    """
    categories, added = {child.category for child in children.values()}, []
    emits = "emitter" in categories or any(getattr(child, "emitter", None) is not None for child in children.values())
    if options.light is not None or not emits:
        radiance = 1.0 if options.light is None else options.light
        children[names.free("sky")] = Constant(radiance=radiance)
        if options.light is None:
            added.append(f"it has no light: a constant light of radiance {radiance:g} is added (option light)")
    if "sensor" not in categories:
        name = names.free("camera")
        children[name] = overview(*corners, options.resolution, options.spp)
        if options.camera:
            added.append(f"it has no camera: {name!r} is added, which looks at all of it from the front")
    return added


def said(losses: list[str]) -> str:
    """Joins messages about losses to one, shortened if long."""
    more = f"; and {len(losses) - LISTED} more" if len(losses) > LISTED else ""
    return "; ".join(losses[:LISTED]) + more
