"""A furnished room: the textures of its materials and the radiance of window and lamp, from eight views."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

import torch_radbp as rb
from benchmarks.headline.task import PRB, Task, parameters, rms
from benchmarks.headline.unknown.values import Values
from benchmarks.scenes import pictures
from benchmarks.scenes.description import Setting, camera
from benchmarks.scenes.textured_interior import room

MATERIALS, TEXELS = 8, 32
TEXTURES = tuple(f"material_{number}.reflectance.data" for number in range(MATERIALS))
LAMPS = ("window.emitter.radiance.value", "lamp.emitter.radiance.value")
EYES = ((0.4, 1.5, 2.35), (-1.6, 1.7, 2.2), (1.9, 1.6, 2.2), (-2.2, 1.5, 1.2), (2.2, 2.0, 1.4), (0.0, 2.2, 2.3),
        (-1.0, 1.0, 2.3), (1.2, 1.1, 2.3))
AIMS = ((0.0, 0.85, -1.5), (1.8, 1.4, -0.5), (-1.8, 0.9, -1.0), (2.4, 1.5, 0.0), (-2.0, 0.6, -0.6), (0.0, 0.2, -0.6),
        (0.0, 2.6, -0.6), (-0.5, 1.2, -2.4))


def interior(folder: Path) -> Task:
    scene = described(folder, setting := Setting(64, 4, 6))
    loaded = rb.load_dict(scene)
    truth, seen = parameters(loaded, (*TEXTURES, *LAMPS)), shares_in_images(loaded)

    def error(found: dict[str, np.ndarray]) -> float:
        texels, lamps = (np.concatenate([what[name].ravel() for name in names])
                         for names, what in ((TEXTURES, found), (LAMPS, found)))
        true_texels, true_lamps = (np.concatenate([truth[name].ravel() for name in names]) for names in (TEXTURES, LAMPS))
        return float(np.hypot(rms(texels, true_texels, seen), rms(lamps / true_lamps, np.ones_like(lamps))))

    unknowns = (*(Values(name, start=0.5, rate=0.05, most=1.0) for name in TEXTURES),
                *(Values(name, start=5.0, rate=0.5) for name in LAMPS))
    return Task("Interior: textures and lamps", scene, scene, unknowns, error,
                "RMS of texels in view, and relative one of lamps", len(EYES), setting, 120, PRB)


def described(folder: Path, setting: Setting) -> dict:
    """The room with a bitmap on every surface, and eight cameras in it."""
    materials = {}
    for number in range(MATERIALS):
        light = (0.85 - 0.07 * number, 0.45 + 0.05 * number, 0.3 + 0.07 * (number * 3 % MATERIALS))
        picture = pictures.coloured(pictures.pattern(TEXELS, number), tuple(0.25 * value for value in light), light)
        materials[f"material_{number}"] = {"type": "diffuse", "reflectance": {
            "type": "bitmap", "filename": pictures.written(folder, f"colour_{number}", picture)}}
    scene = room(materials, setting.resolution)
    del scene["sensor"]
    views = {f"view_{number}": camera(eye, aim, 70.0, setting.resolution)
             for number, (eye, aim) in enumerate(zip(EYES, AIMS))}
    return {"type": "scene", **views, **scene}


def shares_in_images(scene: rb.Scene) -> np.ndarray:
    """How much of each texel the cameras see directly: the derivative of the images of the albedo."""
    texels = [scene.get_parameter(name).requires_grad_() for name in TEXTURES]
    albedo = rb.Renderer(scene, spp=16).aovs(["albedo"], seed=0)["albedo"]
    shares = np.concatenate([gradient.numpy().ravel() for gradient in torch.autograd.grad(albedo.sum(), texels)])
    for parameter in texels:
        parameter.requires_grad_(False)
    return shares
