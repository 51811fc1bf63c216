"""Lamps in glTF files, and what loading a file warns of."""

from __future__ import annotations

import warnings

import pytest

import torch_radbp as rb
from torch_radbp.io.gltf.document import GltfWarning
from torch_radbp.plugin import SceneError


def load_quietly(file, folder, name="asset.glb", **options):
    """The scene of a file that has nothing to warn of but that it lacks lights and cameras."""
    path = file.save(folder / name)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GltfWarning)
        scene = rb.load(path, **options)
        rb.load(path, strict=True)
    return scene


def load_with_loss(file, folder, message, **options):
    """The scene of a file of which something is lost, as a warning says; strictly it is an error."""
    path = file.save(folder / "asset.glb")
    with pytest.raises(SceneError, match=message):
        rb.load(path, strict=True, **options)
    with pytest.warns(GltfWarning, match=f"asset.glb: .*{message}"):
        return rb.load(path, **options)


def lamp(file, root=True, **light):
    lights = file.document.setdefault("extensions", {}).setdefault("KHR_lights_punctual", {"lights": []})["lights"]
    lights.append(light)
    return {"KHR_lights_punctual": {"light": len(lights) - 1}}
