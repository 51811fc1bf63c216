"""A body from eight views under a known sky, from a sphere: Mitsuba's tutorial on shapes, with a body by a formula."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from benchmarks.headline.task import Task, rms
from benchmarks.headline.unknown.vertices import Vertices
from benchmarks.scenes import pictures
from benchmarks.scenes.description import Setting, camera, rgb

VIEWS, DISTANCE = 8, 5.0
BODY = "body"
FINE, COARSE = 5, 3  # subdivisions of an icosahedron: of the body that is seen, and of what is to become it


def radius(directions: np.ndarray) -> np.ndarray:
    """(N,) distances of the body's surface from its middle along (N, 3) directions."""
    x, y, z = directions.T
    return 1.0 + 0.25 * np.sin(3 * x + z) * np.cos(2 * y) + 0.2 * y * z - 0.15 * np.cos(4 * z) * x


def shape(folder: Path) -> Task:
    setting = Setting(64, 16, 2)

    def error(found: dict[str, np.ndarray]) -> float:
        lengths = np.linalg.norm(found[BODY], axis=1)
        return rms(lengths, radius(found[BODY] / lengths[:, None]))

    return Task("Shape from 8 views", described(folder, setting, "ball", COARSE), described(folder, setting, "body", FINE),
                (Vertices(BODY, rate=0.1),), error, "RMS distance along rays from the middle, of a body of radius 1", VIEWS,
                setting, 100, {"Mitsuba, direct_projective": {"type": "direct_projective", "sppi": 0}})


def described(folder: Path, setting: Setting, file: str, subdivisions: int) -> dict:
    """Eight cameras all around, on a Fibonacci lattice, a sky, and the ball or the body."""
    import trimesh  # which the other tasks do without

    mesh = trimesh.creation.icosphere(subdivisions=subdivisions)
    lengths = radius(mesh.vertices) if file == "body" else np.ones(len(mesh.vertices))
    path = folder.resolve() / f"{file}.ply"
    trimesh.Trimesh(mesh.vertices * lengths[:, None], mesh.faces, process=False).export(path, vertex_normal=False)
    views = {f"view_{number}": camera(eye(number), (0, 0, 0), 40.0, setting.resolution) for number in range(VIEWS)}
    return {"type": "scene", **views,
            "sky": {"type": "envmap", "filename": pictures.written(folder, "sky", pictures.sky(32, 64))},
            BODY: {"type": "ply", "filename": str(path), "recompute_normals": True,
                   "bsdf": {"type": "diffuse", "reflectance": rgb(0.6, 0.6, 0.6)}}}


def eye(number: int) -> tuple[float, float, float]:
    """The place of a camera."""
    turn = 2 * math.pi * number / ((1 + 5**0.5) / 2)
    height = math.acos(1 - 2 * (number + 0.5) / VIEWS)
    across = DISTANCE * math.sin(height)
    return across * math.cos(turn), DISTANCE * math.cos(height), across * math.sin(turn)
