"""Makes assets/shapes: a torus in four formats of meshes, a dish, distances of two balls that touch, a puff and a
plume of smoke, and fibres.

    python -m assets.make_shapes
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

from tests.formats.serialized_files import mesh, serialized
from torch_radbp.formats.mesh_arrays import MeshArrays
from torch_radbp.formats.ply import write_ply
from torch_radbp.formats.volume import write_volume

FOLDER = Path(__file__).parent / "shapes"
AROUND, ACROSS, GRID, FINE = 20, 10, 16, 24


def torus() -> MeshArrays:
    """A torus of radius 1 with a tube of 0.35, which leans towards -y; colours follow the angle around it."""
    u, v = np.meshgrid(np.linspace(0, 1, AROUND + 1), np.linspace(0, 1, ACROSS + 1), indexing="ij")
    u, v = u.ravel(), v.ravel()
    around, across = 2 * np.pi * u, 2 * np.pi * v
    outwards = np.stack([np.cos(around), np.sin(around), np.zeros_like(u)], 1)
    normals = np.cos(across)[:, None] * outwards + np.sin(across)[:, None] * np.array([0.0, 0.0, 1.0])
    corner = np.arange(AROUND)[:, None] * (ACROSS + 1) + np.arange(ACROSS)
    a, b, c, d = (corner + shift for shift in (0, ACROSS + 1, ACROSS + 2, 1))
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    leaning = np.array([[1.0, 0, 0], [0, np.cos(0.9), -np.sin(0.9)], [0, np.sin(0.9), np.cos(0.9)]])
    positions = 0.65 * outwards + 0.35 * normals
    colours = 0.45 + 0.4 * np.cos(around[:, None] + np.array([0.0, 2.1, 4.2]))
    return MeshArrays((positions @ leaning.T).astype(np.float32), faces,
                      (normals @ leaning.T).astype(np.float32), np.stack([u, v], 1).astype(np.float32),
                      {"vertex_color": colours.astype(np.float32)})


def dish() -> MeshArrays:
    """A paraboloid of radius 1 that opens towards +y from the origin, with its focus at a height of 0.5."""
    r, phi = np.meshgrid(np.linspace(0, 1, ACROSS + 1), 2 * np.pi * np.arange(2 * AROUND) / (2 * AROUND), indexing="ij")
    x, z = (r * np.cos(phi)).ravel(), (r * np.sin(phi)).ravel()
    normals = np.stack([-x, np.ones_like(x), -z], 1) / np.sqrt(1 + x**2 + z**2)[:, None]
    ring, at = np.arange(ACROSS)[:, None] * 2 * AROUND, np.arange(2 * AROUND)
    a, b = ring + at, ring + (at + 1) % (2 * AROUND)
    c, d = a + 2 * AROUND, b + 2 * AROUND
    faces = np.concatenate([np.stack([c, a, d], -1).reshape(-1, 3), np.stack([a, b, d], -1)[1:].reshape(-1, 3)])
    return MeshArrays(np.stack([x, 0.5 * (x**2 + z**2), z], 1).astype(np.float32), faces, normals.astype(np.float32), None)


def two_balls() -> np.ndarray:
    """(Z, Y, X, 1) signed distances in the unit cube of two balls that touch."""
    z, y, x = np.meshgrid(*[np.linspace(0, 1, GRID)] * 3, indexing="ij")
    lower = np.sqrt((x - 0.5) ** 2 + (y - 0.5) ** 2 + (z - 0.3) ** 2) - 0.28
    upper = np.sqrt((x - 0.5) ** 2 + (y - 0.5) ** 2 + (z - 0.7) ** 2) - 0.2
    return np.minimum(lower, upper)[..., None].astype(np.float32)


def puff() -> np.ndarray:
    """(Z, Y, X, 1) a puff of smoke in the unit cube: 1 in the middle of three overlapping balls, 0 outside of them."""
    z, y, x = np.meshgrid(*[(np.arange(GRID) + 0.5) / GRID] * 3, indexing="ij")
    balls = (0.4, 0.5, 0.35, 0.3), (0.65, 0.45, 0.5, 0.25), (0.45, 0.55, 0.7, 0.22)
    density = sum(np.maximum(1 - ((x - a) ** 2 + (y - b) ** 2 + (z - c) ** 2) / r**2, 0) for a, b, c, r in balls)
    return np.minimum(density, 1)[..., None].astype(np.float32)


def plume() -> np.ndarray:
    """(Z, Y, X, 1) smoke in the unit cube that rises along y, turns, and becomes wider and thinner."""
    z, y, x = np.meshgrid(*[(np.arange(FINE) + 0.5) / FINE] * 3, indexing="ij")
    across = (x - 0.5 - 0.25 * y * np.cos(6 * y)) ** 2 + (z - 0.5 - 0.25 * y * np.sin(6 * y)) ** 2
    return (np.maximum(1 - across / (0.07 + 0.2 * y) ** 2, 0) * (1 - y))[..., None].astype(np.float32)


def fibres() -> np.ndarray:
    """(1, 1, 1, 6) the matrix of flakes around fibres along x: they turn their sides to y and z."""
    return np.array([0.01, 1, 1, 0, 0, 0], np.float32).reshape(1, 1, 1, 6)


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    arrays = torus()
    made = trimesh.Trimesh(arrays.vertices, arrays.faces, process=False)
    write_ply(FOLDER / "torus.ply", arrays)
    write_ply(FOLDER / "dish.ply", dish())
    lines = [f"v {x:.5f} {y:.5f} {z:.5f}" for x, y, z in arrays.vertices] + [f"vt {u:.5f} {v:.5f}" for u, v in arrays.uv]
    lines += [f"f {' '.join(f'{corner}/{corner}' for corner in face)}" for face in arrays.faces + 1]
    (FOLDER / "torus.obj").write_text("\n".join(lines) + "\n")
    made.export(FOLDER / "torus.stl")
    (FOLDER / "torus.serialized").write_bytes(serialized(mesh(arrays.vertices, arrays.faces, uv=arrays.uv)))
    for name, values in (("two_balls", two_balls()), ("puff", puff()), ("plume", plume()), ("fibres", fibres())):
        write_volume(FOLDER / f"{name}.vol", values)
