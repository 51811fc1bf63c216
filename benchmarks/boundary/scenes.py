"""Scenes in which a mesh moves before the camera and before lamps, and the ways in which it does."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.headline.tasks.shape import radius
from benchmarks.scenes import pictures
from benchmarks.scenes.description import BenchmarkScene, Setting, camera, rgb
from benchmarks.scenes.metal_mesh import bumpy_sphere
from torch_radbp.io.values.transform import rotate, scale, translate

VERTICES = "body.vertex_positions"
WAVES, FREQUENCY = 6, 3.0  # fields of displacement of a body, and how often they swing over a unit of length


class MovingMesh(NamedTuple):
    """A scene for both renderers, whose mesh `body` moves."""

    scene: BenchmarkScene
    directions: np.ndarray
    """(K, V, 3) velocities of the vertices, in which the gradient is taken."""
    step: float
    """Of finite differences in these directions."""


def rigid(vertices: np.ndarray) -> np.ndarray:
    """(6, V, 3) shifts along the axes, and turns about them through the middle."""
    shifts = [np.broadcast_to(axis, vertices.shape) for axis in np.eye(3)]
    turns = [np.cross(axis, vertices - vertices.mean(0)) for axis in np.eye(3)]
    return np.stack([*shifts, *turns])


def waves(vertices: np.ndarray) -> np.ndarray:
    """(K, V, 3) smooth displacements, each a sine wave along a direction and across another."""
    random = np.random.default_rng(5)
    along, across = random.normal(size=(2, WAVES, 3))
    phase = random.uniform(0, 2 * math.pi, WAVES)[:, None]
    height = np.sin(FREQUENCY * along @ vertices.T + phase)
    return height[..., None] * (across / np.linalg.norm(across, axis=1, keepdims=True))[:, None]


def moving(mesh, folder: Path, setting: Setting, ways: Callable[[np.ndarray], np.ndarray], step: float, *,
           view: dict, **surroundings: dict) -> MovingMesh:
    """A scene with a smoothly shaded mesh of trimesh.

    Args:
        mesh: in the world; it is written to a file in `folder`.
        setting: of the rendering.
        ways: in which it moves, by its vertices.
        step: of differences.
        view: the sensor.
        surroundings: all else.
    """
    path = folder.resolve() / "body.ply"
    mesh.export(path, vertex_normal=False)
    colour = {"type": "diffuse", "reflectance": rgb(0.6, 0.5, 0.4)}
    view = view | {"sampler": {"type": "independent", "sample_count": setting.spp}}
    source = {"type": "scene", "sensor": view, **surroundings,
              "body": {"type": "ply", "filename": str(path), "bsdf": colour, "recompute_normals": True}}
    return MovingMesh(BenchmarkScene(source, (VERTICES,), setting), ways(np.asarray(mesh.vertices)), step)


def plane(pose: np.ndarray, *colour: float) -> dict:
    return {"type": "rectangle", "to_world": pose, "bsdf": {"type": "diffuse", "reflectance": rgb(*colour)}}


def lamp(pose: np.ndarray, *radiance: float) -> dict:
    return {"type": "rectangle", "to_world": pose, "emitter": {"type": "area", "radiance": rgb(*radiance)}}


FLOOR = plane(rotate((1, 0, 0), -90) @ scale((4, 4, 1)), 0.7, 0.7, 0.65)


def ball(folder: Path, setting: Setting) -> MovingMesh:
    """A ball over a floor under a rectangular lamp."""
    import trimesh  # which the other benchmarks do without

    mesh = trimesh.creation.icosphere(subdivisions=4, radius=0.5).apply_translation((0.1, 0.8, 0.05))
    view = camera((0.3, 2.3, 4.2), (0.0, 0.35, 0.0), 38, setting.resolution)
    above = translate((0.8, 3.2, 0.9)) @ rotate((1, 0, 0), 90) @ scale((0.5, 0.4, 1))
    return moving(mesh, folder, setting, rigid, 0.005, view=view, floor=FLOOR, lamp=lamp(above, 14, 13, 12))


def detailed(folder: Path, setting: Setting) -> MovingMesh:
    """A bumpy body of 81,920 triangles under an environment map with a sun; the shape bends."""
    mesh = bumpy_sphere(6)
    sky = {"type": "envmap", "filename": pictures.written(folder, "sky", pictures.sky(128, 256))}
    return moving(mesh, folder, setting, waves, 0.005, view=camera((0.5, 1.3, 4.0), (0.0, 0.0, 0.0), 38, setting.resolution),
                  sky=sky)


def pose(folder: Path, setting: Setting) -> MovingMesh:
    """A body before a wall on which its shadow falls, as in Mitsuba's tutorial on poses; the body is another."""
    import trimesh

    mesh = trimesh.creation.icosphere(subdivisions=5)
    mesh.vertices *= 0.45 * radius(mesh.vertices)[:, None]
    mesh.apply_translation((-0.1, 0.05, 0.0))
    facing = translate((0.9, 1.0, 3.0)) @ rotate((0, 1, 0), 180 + 17) @ rotate((1, 0, 0), 17) @ scale((0.5, 0.5, 1))
    view = camera((0.0, 0.0, 3.4), (0.0, 0.0, -0.3), 40, setting.resolution)
    return moving(mesh, folder, setting, rigid, 0.005, view=view,
                  wall=plane(translate((0, 0, -1.2)) @ scale((4, 4, 1)), 0.75, 0.7, 0.7), lamp=lamp(facing, 12, 11, 10))


def shadow_art(folder: Path, setting: Setting) -> MovingMesh:
    """A ring in the shape of a flower between a small lamp and a wall: the camera sees its shadow alone; the shape bends."""
    import trimesh

    mesh = trimesh.creation.torus(0.42, 0.14, major_sections=128, minor_sections=32)
    x, y, _ = mesh.vertices.T
    mesh.vertices[:, :2] *= 1.0 + 0.25 * np.sin(5 * np.arctan2(y, x))[:, None]
    mesh.apply_translation((0.0, 0.0, 1.5))
    facing = translate((0.1, 0.15, 4.0)) @ rotate((0, 1, 0), 180) @ scale((0.06, 0.06, 1))
    view = camera((0.0, -2.7, 1.15), (0.0, 0.0, 0.0), 40, setting.resolution)
    return moving(mesh, folder, setting, waves, 0.01, view=view,
                  wall=plane(scale((3, 3, 1)), 0.8, 0.8, 0.8), lamp=lamp(facing, 600, 600, 600))


SCENES: dict[str, tuple[Callable[[Path, Setting], MovingMesh], int]] = {  # and the depth of paths
    "ball over a plane": (ball, 3), "detailed mesh under a sky": (detailed, 3), "pose before a wall": (pose, 3),
    "shadow art": (shadow_art, 2)}
