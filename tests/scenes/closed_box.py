"""A box from which no path escapes."""

from __future__ import annotations

import torch

import torch_radbp as rb


def closed_box(material: dict, lamps: int = 1) -> rb.Scene:
    """A closed box, in which no path ends before its time; with balls of another material, and lamps in its corners."""
    def at(x: float, y: float, z: float, size: float) -> torch.Tensor:
        return torch.tensor([[size, 0, 0, x], [0, size, 0, y], [0, 0, size, z], [0, 0, 0, 1]])

    corners = [(x, y, z) for x in (-0.6, 0.6) for y in (-0.6, 0.6) for z in (-0.6, 0.6)][:lamps]
    return rb.load_dict({
        "type": "scene",
        "sensor": {"type": "perspective", "fov": 60.0, "film": {"type": "hdrfilm", "width": 6, "height": 6}},
        "walls": {"type": "cube", "to_world": at(0, 0, 0, 3.0), "bsdf": {"type": "twosided", "bsdf": {"type": "diffuse"}}},
        "thing": {"type": "cube", "to_world": at(0, 0, 1.8, 0.5), "bsdf": material},
        **{f"lamp_{k}": {"type": "cube", "to_world": at(*place, 0.1), "emitter": {"type": "area"}}
           for k, place in enumerate(corners)}})
