"""A folder of photographs as a NeRF data set: three cameras around a ball, exposed differently."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

import torch_radbp as rb

WIDTH, HEIGHT = 16, 12
TO_OPENGL = torch.diag(torch.tensor([-1.0, 1.0, -1.0, 1.0]))
GAINS = torch.tensor([1.0, 0.6, 1.4])
REFLECTANCE = (0.6, 0.3, 0.1)


def ball_in_the_open(*reflectance: float) -> dict[str, Any]:
    """A ball beside the middle, under a sky of one radiance."""
    ball = {"type": "diffuse", "reflectance": {"type": "rgb", "value": list(reflectance)}}
    sphere = {"type": "sphere", "center": [0.4, 0.2, -0.1], "radius": 0.8, "bsdf": ball}
    return {"sky": {"type": "constant", "radiance": 0.5}, "ball": sphere}


def write_transforms(folder: Path, **entries: Any) -> Path:
    """transforms.json of the three cameras, with `view_0.png`, ... as images and further entries."""
    frames = []
    for number, angle in enumerate((-0.6, 0.0, 0.7)):
        origin = (3 * math.sin(angle), 0.4, 3 * math.cos(angle))
        pose = rb.look_at(origin, (0, 0, 0), (0, 1, 0)) @ TO_OPENGL
        frames.append({"file_path": f"view_{number}.png", "transform_matrix": pose.tolist()})
    document = {"camera_angle_x": 0.7, "w": WIDTH, "h": HEIGHT, "frames": frames} | entries
    path = folder / "transforms.json"
    path.write_text(json.dumps(document))
    return path


def write_photographs(folder: Path) -> Tensor:
    """transforms.json and 8-bit sRGB photographs; what they show before the gains, (3, 3, H, W)."""
    path = write_transforms(folder)
    scene = rb.load_dict({"type": "scene", **rb.cameras_from_nerf(path), **ball_in_the_open(*REFLECTANCE)})
    with torch.no_grad():
        images = rb.render(scene, spp=256, seed=9)
    for number, (image, gain) in enumerate(zip(images, GAINS)):
        rb.save_image(folder / f"view_{number}.png", image * gain)
    return images
