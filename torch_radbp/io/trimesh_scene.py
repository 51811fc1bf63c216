"""Converts a trimesh scene to a `Scene`."""

from __future__ import annotations

import math
import warnings
from typing import TYPE_CHECKING

import numpy as np
import torch

from torch_radbp.formats.trimesh_arrays import is_trimesh, placed_meshes
from torch_radbp.integrator.path import Path
from torch_radbp.io.gltf.document import DocumentPart, Losses
from torch_radbp.io.gltf.lamp import sensor_of_camera as camera_of
from torch_radbp.io.gltf.names import Names
from torch_radbp.io.gltf.read import Options, complete, gltf_options, said
from torch_radbp.io.load import built
from torch_radbp.io.trimesh_shape import SOURCE, Looks, dress
from torch_radbp.io.values.attribute_values import value_text
from torch_radbp.plugin import Plugin, SceneError, SceneWarning
from torch_radbp.public_call import public_call
from torch_radbp.scene.modules.scene import Scene
from torch_radbp.shape.mesh import TensorMesh

if TYPE_CHECKING:
    import trimesh


@public_call
def scene_from_trimesh(source: trimesh.Trimesh | trimesh.Scene, *, resolution: int | None = None, spp: int = 16,
                       max_depth: int = -1, light: float | None = None, camera: bool = True, strict: bool = False) -> Scene:
    """The scene that a `trimesh.Scene` shows, or a single `trimesh.Trimesh`.

        scene = rb.scene_from_trimesh(trimesh.load_scene("engine.3mf"), light=1.0)

    A node that shows a mesh becomes a shape `mesh` of its name, under the node's pose; a material a `principled` of its
    name, as with `load` of glTF. What it does not say is added as there: a camera in front of it, and an even light. Surface
    coordinates, the normals that a mesh holds (without any it is flat), colours of vertices and faces (linear, as in glTF)
    and attributes are read. A mesh without material and colours is grey, and diffuse. Lights of trimesh, which it makes for
    its viewer, are not read.

    Args:
        source: left as it is.
        resolution: pixels of the longer side of the image; None: those of the scene's camera, or 512.
        spp: samples per pixel.
        max_depth: of the integrator `path`.
        light: radiance from all around; None: 1 if no mesh emits light, else none.
        camera: False: look at the whole scene from the front instead of through the scene's camera.
        strict: an error instead of a warning about what cannot be read.

    Raises:
        TypeError: if it is neither, or `strict` is neither True nor False.
        SceneError: names the mesh, and what cannot be used of it.
    """
    if not is_trimesh(source):
        raise TypeError(f"a scene is made of a trimesh.Scene or a trimesh.Trimesh, got {value_text(source)}")
    if not isinstance(strict, bool):
        raise TypeError(f"strict must be True or False, got {value_text(strict)}")
    given = {"resolution": resolution, "spp": spp, "max_depth": max_depth, "light": light, "camera": camera}
    chosen = gltf_options(SOURCE, {name: value for name, value in given.items() if value is not None})
    return built(lambda: _read_scene(source, chosen, strict), strict)


def _read_scene(source: trimesh.Trimesh | trimesh.Scene, chosen: Options, strict: bool) -> Scene:
    """Converts a trimesh scene, in torch's default dtype."""
    losses, names = Losses(), Names()
    children: dict[str, Plugin] = {}
    looks = Looks(losses, names, children)
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    try:
        for placed in placed_meshes(source):
            arrays, look = looks.dressed(placed.mesh, placed.name)
            bsdf, emitter = dress(look)
            try:
                shape = TensorMesh(mesh=arrays, to_world=torch.from_numpy(placed.to_world), bsdf=bsdf, emitter=emitter)
            except (ValueError, RuntimeError) as error:
                raise SceneError(f"{placed.name}: {error}") from error
            children[names.free(placed.name)] = shape
            corners = shape.vertex_positions.detach().double().numpy()
            low, high = np.minimum(low, corners.min(0)), np.maximum(high, corners.max(0))
        if chosen.camera and getattr(source, "has_camera", False):
            children[names.free("camera")] = _camera_of(source, chosen, float(np.abs([low, high]).max()))
        added = complete(children, names, (low, high), chosen)
        said_of = [*losses, *added]
        if strict and list(losses):
            raise SceneError(f"{SOURCE}: {said(list(losses))}")
        if said_of:
            warnings.warn(f"{SOURCE}: {said(said_of)}", SceneWarning, stacklevel=6)
        return Scene(children, Path(max_depth=chosen.max_depth))
    except SceneError:
        raise
    except ValueError as error:
        raise SceneError(f"{SOURCE}: {error}") from error


def _camera_of(scene: trimesh.Scene, chosen: Options, reach: float) -> Plugin:
    """The camera of a trimesh scene: as in glTF it looks along -z."""
    width, height = (int(side) for side in scene.camera.resolution)
    perspective = {"yfov": math.radians(float(scene.camera.fov[1])), "aspectRatio": width / height,
                   "znear": float(scene.camera.z_near)}
    part = DocumentPart(SOURCE, "camera", {"type": "perspective", "extras": {"width": width, "height": height},
                                           "perspective": perspective})
    to_world = np.asarray(scene.camera_transform, dtype=np.float64)
    return camera_of(part, to_world, chosen.resolution, chosen.spp, 4 * (reach + float(np.abs(to_world[:3, 3]).max())))
