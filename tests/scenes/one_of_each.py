"""One of everything of which tables are made."""

from __future__ import annotations

import torch
from torch import nn

import torch_radbp as rb
from tests.scenes import load, rectangle, rgb, sensor, texels
from tests.scenes.meshes import grid


def scene_of(dtype=torch.float64, **more) -> rb.Scene:
    """One of everything of which tables are made."""
    sheet = {"type": "bitmap", "data": 0.2 + 0.6 * texels(4, 4)}
    hills = grid(4, bsdf={"type": "diffuse", "reflectance": sheet})
    hills["vertex_texcoords"] = 0.5 + 0.45 * hills["vertex_positions"][:, :2]
    return load(dtype, camera=sensor(6), hills=hills,
                ball={"type": "sphere", "radius": 0.3, "bsdf": {"type": "roughconductor", "alpha": 0.3}},
                sky={"type": "envmap", "bitmap": 0.1 + texels(3, 4)},
                spot={"type": "spot", "intensity": rgb(3, 2, 1), "texture": {"type": "bitmap", "data": texels(2, 2)},
                      "to_world": rb.look_at((1, 1, 2), (0, 0, 0), (0, 1, 0))},
                lamp=rectangle((0.5, 0, 1), 0.3, emitter={"type": "area", "radiance": rgb(4, 5, 6)}), **more)


class Half(nn.Module):
    """A module without parameters."""

    def forward(self, value: torch.Tensor) -> torch.Tensor:
        return 0.5 * value
