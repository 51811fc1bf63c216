"""Meshes of trimesh with materials, and their images."""

from __future__ import annotations

import numpy as np
import torch
import trimesh
from PIL import Image

import torch_radbp as rb

LOOK = {"type": "perspective", "fov": 35, "to_world": rb.look_at([0.8, 1.5, 5], [0, 0, 0], [0, 1, 0]),
        "film": {"type": "hdrfilm", "width": 24, "height": 24}}
OTHERS = {"integrator": {"type": "path", "max_depth": 3}, "camera": LOOK, "sky": {"type": "constant", "radiance": 0.5},
          "lamp": {"type": "point", "position": [2.0, 3.0, 3.0], "intensity": 20.0}}


def image(scene: rb.Scene) -> torch.Tensor:
    return rb.render(scene, spp=16, seed=3)[0]


def loaded(strict: bool = False, /, **objects) -> rb.Scene:
    return rb.load_dict({"type": "scene", **OTHERS, **objects}, strict=strict)


def assert_same(first: torch.Tensor, second: torch.Tensor, atol: float = 1e-4) -> None:
    """Equal images, of the same random numbers: measured 0 to 1.5e-8; texts have 8 digits, normals are normalised twice."""
    assert first.mean() > 0.1 and first.std() > 0.02
    torch.testing.assert_close(first.detach(), second.detach(), rtol=0, atol=atol)


def ball(smooth: bool = True) -> trimesh.Trimesh:
    """A ball with surface coordinates that are no mirror image of themselves, and perhaps normals."""
    mesh = trimesh.creation.icosphere(2)
    mesh.visual = trimesh.visual.TextureVisuals(uv=0.5 + 0.4 * mesh.vertices[:, :2] * (1, 0.8))
    if smooth:
        assert mesh.vertex_normals.shape == (162, 3)  # which it holds from here on
    return mesh


def picture(seed: int = 0, height: int = 4) -> Image.Image:
    return Image.fromarray(np.random.default_rng(seed).integers(0, 256, (height, 5, 3), dtype=np.uint8))


def material(**more) -> trimesh.visual.material.PBRMaterial:
    return trimesh.visual.material.PBRMaterial(**{"name": "gold", "baseColorFactor": [230, 180, 90, 255],
                                                  "metallicFactor": 0.4, "roughnessFactor": 0.6, **more})
