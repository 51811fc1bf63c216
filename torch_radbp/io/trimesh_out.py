"""Converts shapes and scenes to trimesh, with their current values; materials by the writer of glTF.

It sets `Surface.converter` and `Scene.converter`, which `to_trimesh` of shapes and scenes calls.
"""

from __future__ import annotations

import math
import warnings
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from PIL import Image
from torch import Tensor, nn

from torch_radbp.io.gltf import lamp_out
from torch_radbp.io.gltf.appearance import Appearances, PrimitiveMaterial
from torch_radbp.io.gltf.document import Losses
from torch_radbp.io.gltf.image_slot import LINEAR, WRAPS
from torch_radbp.io.gltf.lamp_out import matrix_of
from torch_radbp.io.gltf.read import said
from torch_radbp.io.gltf.write import is_upright_in_v
from torch_radbp.io.gltf.written import Written
from torch_radbp.plugin import Emitter, SceneError, SceneWarning, Sensor
from torch_radbp.scene.modules.scene import Scene
from torch_radbp.shape.instance import Instance
from torch_radbp.shape.surface import Surface, Triangles

if TYPE_CHECKING:
    import trimesh

STRENGTH = "KHR_materials_emissive_strength"  # which trimesh does without


class Pictured(Written):
    """A glTF document whose images stay unencoded."""

    def __init__(self) -> None:
        super().__init__()
        self.pictures: list[Image.Image] = []

    def image(self, pixels: np.ndarray, name: str) -> int:
        self.pictures.append(Image.fromarray(pixels))
        return len(self.pictures) - 1


class Meshes:
    """Converts the shapes of one scene to trimesh meshes; shapes with the same look share a material."""

    def __init__(self, root: nn.Module) -> None:
        self.root, self.out, self.losses = root, Pictured(), Losses()
        self.appearances = Appearances(root, self.out, self.losses)
        self.materials: dict[int, Any] = {}

    def of(self, name: str, shape: Surface) -> trimesh.Trimesh:
        """Converts a shape to a trimesh mesh, in world space or in the space of its group."""
        import trimesh
        surface = shape.oriented()
        appearance = self.appearances.of(shape, is_upright_in_v(surface))
        mesh = trimesh.Trimesh(array_of(surface.vertices), array_of(surface.faces), process=False)
        if surface.normals is not None:
            mesh.vertex_normals = array_of(surface.normals)
        kept = appearance.colours[0] if appearance.colours else ""
        for attribute, values in surface.attributes:
            kind, _, short = attribute.partition("_")
            if attribute != kept:
                (mesh.vertex_attributes if kind == "vertex" else mesh.face_attributes)[short] = array_of(values)
        mesh.visual = self.visual(name, surface, appearance)
        return mesh

    def visual(self, name: str, surface: Triangles, appearance: PrimitiveMaterial) -> Any:
        """The trimesh visual of a mesh: vertex or face colours if these are its base colour, or its material."""
        from trimesh.visual import ColorVisuals, TextureVisuals
        material = self.material(appearance.material)
        uv = None if surface.uv is None else array_of(surface.uv) * (1, -1) + (0, 1)
        if appearance.colours is None:
            return TextureVisuals(uv=uv, material=material)
        attribute, factor = appearance.colours
        if attribute not in dict(surface.attributes):
            raise SceneError(f"{name}: it has no attribute {attribute!r}, which its material reads")
        values = array_of(dict(surface.attributes)[attribute]) * factor
        self.appearances.lose_beyond(f"{name}.{attribute}", values)
        colours = np.full((len(values), 4), 255, dtype=np.uint8)
        colours[:, :3] = np.round(values.clip(0, 1) * 255)
        if self.out.lists["materials"][appearance.material].keys() - {"name"} != {"pbrMetallicRoughness"} or uv is not None \
                or (material.metallicFactor, material.roughnessFactor) != (1, 1):
            self.losses.add(name, f"beside {attribute} neither the rest of its material nor surface coordinates are kept: "
                                  "trimesh has colours, or a material")
        return ColorVisuals(**{f"{attribute.partition('_')[0]}_colors": colours})

    def material(self, number: int) -> Any:
        """A material of the document as a `PBRMaterial`."""
        if number not in self.materials:
            self.materials[number] = self.made(self.out.lists["materials"][number])
        return self.materials[number]

    def made(self, entries: dict[str, Any]) -> Any:
        """Converts a glTF material to trimesh's; notes what trimesh has no entry for."""
        from trimesh.visual.material import PBRMaterial
        flat = {**entries, **entries["pbrMetallicRoughness"]}
        extensions = flat.pop("extensions", {})
        name, strength = flat["name"], extensions.pop(STRENGTH, {}).get("emissiveStrength", 1.0)
        for extension in extensions:
            self.losses.add(name, f"what {extension} says is not kept: materials of trimesh have no place for it")
        for key in [key for key in flat if key.endswith("Texture")]:
            flat[key] = self.picture(f"{name}: its {key}", flat[key])
        del flat["pbrMetallicRoughness"]
        white = {"baseColorFactor": [1.0, 1.0, 1.0, 1.0], "metallicFactor": 1.0, "roughnessFactor": 1.0}
        material = PBRMaterial(**{**white, **flat})
        if strength != 1.0:
            try:
                material.emissiveFactor = np.multiply(flat["emissiveFactor"], strength)
            except ValueError:
                self.losses.add(name, f"it emits {strength:g} times as much: this version of trimesh takes 1 at most")
        return material

    def picture(self, what: str, info: dict[str, Any]) -> Image.Image:
        """The image of a texture info; notes it if it is not repeated and bilinear, as trimesh assumes."""
        texture = self.out.lists["textures"][info["index"]]
        plain = {"wrapS": WRAPS["repeat"], "wrapT": WRAPS["repeat"], "magFilter": LINEAR}
        if self.out.lists["samplers"][texture["sampler"]] != plain or "extensions" in info:
            self.losses.add(what, "wrap_mode, filter_type and to_uv are not kept: trimesh has no place for them")
        return self.out.pictures[texture["source"]]

    def warn(self) -> None:
        """Warns of all that trimesh cannot represent."""
        if losses := list(self.losses):
            warnings.warn(f"trimesh: {said(losses)}", SceneWarning, stacklevel=4)


def array_of(values: Tensor) -> np.ndarray:
    """Converts a tensor to an array of float64, or of its integers."""
    values = values.detach().cpu()
    return (values.double() if values.is_floating_point() else values).numpy()


def mesh_of_shape(shape: Surface) -> trimesh.Trimesh:
    """Converts a shape to a `trimesh.Trimesh`, for `Surface.to_trimesh`."""
    with torch.no_grad():
        meshes = Meshes(shape)
        mesh = meshes.of(shape.id or shape.type, shape)
    meshes.warn()
    return mesh


def scene_of_scene(scene: Scene) -> trimesh.Scene:
    """Converts a scene to a `trimesh.Scene`, for `Scene.to_trimesh`."""
    import trimesh
    meshes, converted = Meshes(scene), trimesh.Scene()

    def add(name: str, shape: Surface, node: str, to_world: np.ndarray | None = None) -> None:
        if name not in converted.geometry:
            converted.geometry[name] = meshes.of(name, shape)
        converted.graph.update(frame_to=node, matrix=np.eye(4) if to_world is None else to_world, geometry=name)

    with torch.no_grad():
        for name, child in scene.named_children():
            if isinstance(child, Instance):
                group = scene.name_of(child.shapegroup)
                for leaf, shape in child.shapegroup.shapes.items():
                    add(f"{group}_{leaf}", shape, f"{name}_{leaf}", matrix_of(child.to_world))
            elif isinstance(child, Surface):
                add(name, child, name)
            elif isinstance(child, Emitter):
                meshes.losses.add(name, f"a {child.type} emitter is left out: only surfaces shine in what trimesh keeps")
            elif isinstance(child, Sensor):
                look_through(converted, name, child, meshes.losses)
    meshes.warn()
    return converted


def look_through(scene: trimesh.Scene, name: str, sensor: Sensor, losses: Losses) -> None:
    """Sets a trimesh scene's camera from a sensor, if it has none yet."""
    import trimesh
    written = None if scene.has_camera else lamp_out.camera_of_sensor(sensor, name, losses)
    if written is None or "perspective" not in written[0]:
        losses.add(name, "is left out: a trimesh.Scene has one camera, a perspective one")
        return
    (entries, place), lens = written, written[0]["perspective"]
    across = 2 * math.atan(math.tan(lens["yfov"] / 2) * lens["aspectRatio"])
    scene.camera = trimesh.scene.Camera(
        name=name, resolution=(entries["extras"]["width"], entries["extras"]["height"]),
        fov=(math.degrees(across), math.degrees(lens["yfov"])), z_near=lens["znear"], z_far=lens["zfar"])
    scene.camera_transform = place


Surface.converter = staticmethod(mesh_of_shape)
Scene.converter = staticmethod(scene_of_scene)
