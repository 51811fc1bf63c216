"""A glTF asset, and the XML that the package writes of it for Mitsuba, which cannot read glTF."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np

import torch_radbp as rb
from tests.io.gltf_files import GltfFile
from tests.scenes.xml.files import Folder, picture
from torch_radbp.film.box import Box

OPTIONS = {"resolution": 24, "light": 0.2, "max_depth": 4, "spp": 16}
BALL = 12  # rows of quadrilaterals


def pixels(folder: Folder, height: int, width: int, seed: int, low: int = 0) -> np.ndarray:
    """(height, width, 3) bytes from `low` to 255, noted in the digest."""
    values = np.round(low + (255 - low) * picture(height, width, seed)).astype(np.uint8)
    folder.contents.update(values.tobytes())
    return values


def ball(file: GltfFile) -> dict:
    """A ball with normals and surface coordinates."""
    v, u = np.mgrid[:BALL + 1, :2 * BALL + 1]
    theta, phi = v * math.pi / BALL, u * math.pi / BALL
    normals = np.stack([np.sin(theta) * np.sin(phi), np.cos(theta), np.sin(theta) * np.cos(phi)], -1).reshape(-1, 3)
    corner = (np.arange(BALL)[:, None] * (2 * BALL + 1) + np.arange(2 * BALL)).reshape(-1)
    below = corner + 2 * BALL + 1
    faces = np.concatenate([np.stack([corner, below, below + 1], 1), np.stack([corner, below + 1, corner + 1], 1)])
    uv = np.stack([u / (2 * BALL), v / BALL], -1).reshape(-1, 2)
    return {"attributes": {"POSITION": file.array(normals), "NORMAL": file.array(normals), "TEXCOORD_0": file.array(uv)},
            "indices": file.array(faces.reshape(-1), "uint16")}


def asset(folder: Folder) -> GltfFile:
    """Maps of everything on two balls, a cut out sheet, a painted wall, a glowing panel and a spot."""
    file = GltfFile()
    turned = {"extensions": {"KHR_texture_transform": {"offset": [0.2, 0.1], "rotation": 0.5, "scale": [2, 1.5]}}}
    maps = {"baseColorTexture": file.texture(pixels(folder, 6, 8, 81), wrapS=33648, wrapT=33648) | turned,
            "metallicRoughnessTexture": file.texture(pixels(folder, 5, 7, 82, 60)), "baseColorFactor": [0.9, 0.8, 1, 1]}
    bumps = pixels(folder, 6, 6, 83, 80) * np.array([1, 1, 0], "u1") + np.array([0, 0, 255], "u1")
    gold = file.add("materials", name="gold", pbrMetallicRoughness=maps, normalTexture=file.texture(bumps) | {"scale": 0.6})
    frosted = {"metallicFactor": 0, "roughnessFactor": 0.35}
    glass = file.add("materials", name="glass", pbrMetallicRoughness=frosted, extensions={
        "KHR_materials_transmission": {"transmissionFactor": 0.9}, "KHR_materials_ior": {"ior": 1.4},
        "KHR_materials_volume": {"thicknessFactor": 1}})
    leaf = np.concatenate([pixels(folder, 5, 5, 84), pixels(folder, 5, 5, 85)[..., :1]], 2)
    leaf = file.add("materials", name="leaf", alphaMode="BLEND", doubleSided=True, pbrMetallicRoughness={
        "baseColorTexture": file.texture(leaf), "metallicFactor": 0, "roughnessFactor": 0.6})
    wall = file.add("materials", name="wall", pbrMetallicRoughness={"metallicFactor": 0, "roughnessFactor": 0.8})
    panel = file.add("materials", name="panel", emissiveFactor=[1, 0.8, 0.5], extensions={
        "KHR_materials_emissive_strength": {"emissiveStrength": 6}})
    file.node(ball(file) | {"material": gold}, name="pot", translation=[-0.7, 0, 0], rotation=[0.1, 0.2, 0, 0.97])
    file.node(ball(file) | {"material": glass}, name="bowl", translation=[0.9, -0.3, 0.3], scale=[0.7, 0.7, 0.7])
    file.node(file.square(leaf), name="leaf", translation=[0.2, 0.8, 1], scale=[0.5, -0.4, 1], rotation=[0, 0.3, 0, 0.95])
    colours = file.array([[0.9, 0.2, 0.1], [0.2, 0.8, 0.3], [0.1, 0.3, 0.9], [0.8, 0.8, 0.8]])
    file.node(file.square(wall, COLOR_0=colours), name="wall", translation=[0, 0, -1.2], scale=[3, 2, 1])
    file.node(file.square(panel), name="panel", translation=[0, 2.4, 0.5], rotation=[0.7, 0, 0, 0.7])
    light = {"type": "spot", "intensity": 6, "color": [0.5, 0.8, 1], "spot": {"innerConeAngle": 0.2, "outerConeAngle": 0.5}}
    file.document["extensions"] = {"KHR_lights_punctual": {"lights": [light]}}
    file.node(name="stage", translation=[-1.5, 1, 2.5], rotation=[-0.15, -0.25, 0, 0.95],
              extensions={"KHR_lights_punctual": {"light": 0}})
    lens = {"yfov": 0.75, "aspectRatio": 1.5, "znear": 0.05}
    file.node(name="eye", translation=[0, 0.2, 5], camera=file.add("cameras", type="perspective", perspective=lens))
    plain = {key: file.document[key] for key in ("materials", "nodes", "cameras", "extensions", "samplers", "textures")}
    folder.contents.update(json.dumps([plain, OPTIONS], sort_keys=True).encode())
    return file


def load_asset(path: Path) -> rb.Scene:
    """The asset as it is rendered: with pixels that are alone, so that they are independent."""
    scene = rb.load(path, strict=True, **OPTIONS)
    scene.sensors[0].film.rfilter = Box()
    return scene


def gltf(folder: Folder) -> Path:
    """The XML of the asset, which lies beside it."""
    path = folder.path / "scene.xml"
    rb.save(load_asset(asset(folder).save(folder.path / "asset.glb")), path)
    return path
