"""A plate of glass in parallel light whose caustic is a picture: the scene, and pictures drawn here."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from PIL import Image, ImageDraw, ImageFilter, ImageFont
from torch import Tensor
from torch.nn.functional import interpolate

import torch_radbp as rb

PIXELS = 128  # of an image, a side


def letters() -> Tensor:
    """(H, W) rings, a disk and letters."""
    picture = Image.new("L", (512, 512), 15)
    draw = ImageDraw.Draw(picture)
    for number in range(5):
        draw.arc((60 + 30 * number, 120 + 20 * number, 452 - 30 * number, 500 - 10 * number), 200, 340, fill=255, width=10)
    draw.ellipse((330, 60, 430, 160), fill=230)
    draw.text((60, 380), "radbp", fill=255, font=ImageFont.load_default(size=150))
    return tones(picture)


def sea() -> Tensor:
    """(H, W) waves in many tones, with foam, below a sun."""
    picture = Image.new("L", (512, 512), 150)
    draw, across = ImageDraw.Draw(picture), np.linspace(0, 512, 129)
    draw.ellipse((300, 60, 400, 160), fill=255)
    for number in range(7):
        up = 250 + 38 * number - (90 - 11 * number) * np.abs(np.sin(across / (150 - 12 * number) + 1.7 * number)) ** 1.5
        line = list(zip(across.tolist(), up.tolist()))
        draw.polygon([*line, (512, 512), (0, 512)], fill=(110, 40, 85, 25, 70, 35, 55)[number])
        draw.line(line, fill=240, width=9 - number)
    return tones(picture)


def tones(picture: Image.Image) -> Tensor:
    """(PIXELS, PIXELS) of a picture of bytes, over the mean."""
    grey = torch.from_numpy(np.asarray(picture.filter(ImageFilter.GaussianBlur(2)), dtype=np.float32))
    grey = interpolate(grey[None, None], size=(PIXELS, PIXELS), mode="area")[0, 0]
    return grey / grey.mean()


PICTURES = {"letters": letters, "sea": sea}


def rectangle(height: float, upwards: bool, size: float, **more: Any) -> dict[str, Any]:
    """A horizontal square, with what more it has."""
    sign = 1.0 if upwards else -1.0
    pose = np.array([[size, 0, 0, 0], [0, 0, sign, height], [0, -sign * size, 0, 0], [0, 0, 0, 1.0]])
    return {"type": "rectangle", "to_world": pose, **more}


def grey(value: float) -> dict[str, Any]:
    """The same value at all wavelengths."""
    return {"type": "spectrum", "value": value}


GLASS = {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0, "specular_reflectance": grey(0.0)}


def plate_scene(top: dict[str, Any]) -> dict[str, Any]:
    """The scene in Mitsuba's vocabulary, with the upper side of the plate."""
    film = {"type": "hdrfilm", "width": PIXELS, "height": PIXELS, "rfilter": {"type": "gaussian"}, "pixel_format": "rgb"}
    eye = rb.look_at([0, -4.65, 0], [0, -20, 0], up=[0, 0, 1]).numpy()
    return {"type": "scene", "integrator": {"type": "ptracer", "max_depth": 4},
            "sensor": {"type": "perspective", "fov": 45.0, "near_clip": 0.01, "to_world": eye, "film": film},
            "floor": rectangle(-7, True, 5, bsdf={"type": "diffuse", "reflectance": grey(1.0)}),
            "lamp": rectangle(5, False, 1, emitter={"type": "directionalarea", "radiance": grey(0.8)}),
            "top": top, "bottom": rectangle(-0.2, False, 1, bsdf=GLASS)}
