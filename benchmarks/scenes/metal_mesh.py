"""A mesh of rough metal on a textured floor under an environment map with a sun."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.scenes import pictures
from benchmarks.scenes.description import BenchmarkScene, Setting, camera
from torch_radbp.io.values.transform import rotate, scale, translate

SETTING = Setting(192, 16, 6)
TEXTURES = ("floor.bsdf.reflectance.data", "mesh.bsdf.alpha.value", "sky.data")
VERTICES = ("mesh.vertex_positions",)
SUBDIVISIONS = 6  # 81,920 triangles


def bumpy_sphere(subdivisions: int):
    """A sphere with smooth bumps all over, without normals and texture coordinates, as a mesh of trimesh."""
    import trimesh  # which the other scenes do without

    mesh = trimesh.creation.icosphere(subdivisions=subdivisions)
    x, y, z = mesh.vertices.T
    height = 1 + 0.06 * np.sin(9 * x + 2 * z) * np.cos(8 * y) + 0.03 * np.sin(17 * z + 5 * y)
    return trimesh.Trimesh(mesh.vertices * height[:, None], mesh.faces, process=False)


def metal_mesh(folder: Path, setting: Setting, parameters: tuple[str, ...] = TEXTURES, floor_size: int = 256,
               sky_rows: int = 128) -> BenchmarkScene:
    """The scene; its files are written into `folder`.

    Args:
        folder, setting, parameters: as in all scenes.
        floor_size: texels a side of the floor's texture.
        sky_rows: rows of the environment map, which has twice as many columns.

    Normals follow the positions of the vertices: in Mitsuba whenever these change, here by `recompute_normals`.
    """
    mesh = folder.resolve() / "mesh.ply"
    bumpy_sphere(SUBDIVISIONS).export(mesh, vertex_normal=False)
    tiles = pictures.coloured(pictures.pattern(floor_size, 6), (0.06, 0.05, 0.04), (0.8, 0.65, 0.45))
    floor = {"type": "bitmap", "filename": pictures.written(folder, "floor", tiles), "to_uv": scale((3, 3, 1))}
    return BenchmarkScene({
        "type": "scene",
        "sensor": camera((0.0, 1.9, 4.6), (0.0, 0.75, 0.0), 42.0, setting.resolution),
        "sky": {"type": "envmap", "filename": pictures.written(folder, "sky", pictures.sky(sky_rows, 2 * sky_rows))},
        "floor": {"type": "rectangle", "to_world": rotate((1, 0, 0), -90) @ scale((4, 4, 4)),
                  "bsdf": {"type": "diffuse", "reflectance": floor}},
        "mesh": {"type": "ply", "filename": str(mesh), "to_world": translate((0, 1.05, 0)),
                 "recompute_normals": parameters == VERTICES,
                 "bsdf": {"type": "roughconductor", "distribution": "ggx", "material": "Cu", "alpha": 0.2}},
    }, parameters, setting)


def metal_mesh_vertices(folder: Path, setting: Setting) -> BenchmarkScene:
    """The same scene with gradients of the positions of the mesh's vertices."""
    return metal_mesh(folder, setting, VERTICES)
