"""A room without silhouettes in view, whose surfaces have everything that quantities are about."""

import numpy as np
import torch

from tests.scenes import diffuse, load, rectangle, sensor, texels

NETWORK_FREE = ("depth", "position", "uv", "geo_normal", "sh_normal", "dp_du", "dp_dv", "albedo")


def hills(height: float = 0.15):
    """A bent sheet of 3 x 3 vertices with normals and coordinates of their own, which fills the view from above."""
    x, y = np.meshgrid(np.linspace(-4, 4, 3), np.linspace(-4, 4, 3), indexing="ij")
    z = height * np.random.default_rng(3).normal(size=x.shape)
    positions = np.stack([x, y, z], -1).reshape(-1, 3)
    normals = np.array([0.0, 0.0, 1.0]) + 0.3 * np.random.default_rng(4).normal(size=positions.shape)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    cell = [(0, 3, 4), (0, 4, 1)]
    faces = np.array([[corner + 3 * i + j for corner in triangle] for i in (0, 1) for j in (0, 1) for triangle in cell])
    uv = np.stack([0.13 + x / 5 + 0.1 * y, 0.2 + y / 6], -1).reshape(-1, 2)
    return {"type": "mesh", "vertex_positions": positions, "faces": faces, "vertex_normals": normals,
            "vertex_texcoords": uv}


def landscape(bsdf=None, dtype=torch.float64, size: int = 4, **objects):
    """The hills from above, textured, under a sky."""
    material = bsdf or {"type": "diffuse", "reflectance": {"type": "bitmap", "data": texels(3, 3)}}
    return load(dtype, sensor=sensor(size, (0.2, -0.3, 3), (0.1, 0.2, 0), 35, rfilter="gaussian"),
                hills={**hills(), "bsdf": material}, sky={"type": "constant"}, **objects)


def two_walls(dtype=torch.float64, size: int = 6):
    """A block and a wall side by side, with lamp and sky in view."""
    return load(dtype, sensor=sensor(size, (0, 0.5, 3.5), (0, 0, 0), 45),
                left=rectangle((-0.7, 0, 0), 0.5, (0, 1, 0), 20, bsdf=diffuse(0.2, 0.4, 0.6)) | {"type": "cube"},
                right=rectangle((0.6, 0, 0.2), 0.5, (0, 1, 0), -30, bsdf={"type": "roughconductor"}),
                lamp=rectangle((0, 0.9, 0), 0.3, emitter={"type": "area"}), sky={"type": "constant"})
