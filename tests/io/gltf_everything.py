"""A glTF file with everything that the package reads and writes."""

from __future__ import annotations

import numpy as np

from tests.io.gltf_files import GltfFile
from tests.io.gltf_loading import lamp as punctual


def everything():
    """A file with everything that both sides can say."""
    file = GltfFile()
    random = np.random.default_rng(0)
    textures = [file.texture(random.integers(128, 256, (4, 6, 4))) for _ in range(5)]
    turned = {"extensions": {"KHR_texture_transform": {"offset": [0.25, 0.5], "rotation": 0.4, "scale": [2, 3]}}}
    gold = file.add("materials", name="gold", pbrMetallicRoughness={
        "baseColorTexture": textures[0] | turned, "baseColorFactor": [0.9, 0.8, 0.7, 0.6], "roughnessFactor": 0.5,
        "metallicRoughnessTexture": textures[1]}, normalTexture=textures[2] | {"scale": 0.7}, doubleSided=True,
        alphaMode="BLEND")
    glow = file.add("materials", name="glow", emissiveFactor=[1, 0.5, 0.2], emissiveTexture=textures[3],
                    extensions={"KHR_materials_emissive_strength": {"emissiveStrength": 5}})
    smooth = {"metallicFactor": 0, "roughnessFactor": 0.1}
    glass = file.add("materials", name="glass", pbrMetallicRoughness=smooth, extensions={
        "KHR_materials_transmission": {"transmissionFactor": 0.9, "transmissionTexture": textures[4]},
        "KHR_materials_ior": {"ior": 1.3}, "KHR_materials_volume": {"thicknessFactor": 1.0}})
    painted = file.add("materials", name="painted", pbrMetallicRoughness={"metallicFactor": 0})
    colours = file.array(random.uniform(0, 1, (4, 3)))
    file.node(file.square(gold), file.square(glass), name="sheets", rotation=[0.1, 0.2, 0.3, 0.927], scale=[1, 2, -1])
    file.node(file.square(glow), name="lamp", translation=[0, 3, 0])
    heat = file.array([0, 0.5, 1, 0.25])
    file.node(file.square(painted, COLOR_0=colours, _HEAT=heat), name="wall", translation=[0, 0, -2])
    file.node(name="sun", extensions=punctual(file, type="directional", intensity=2, color=[1, 0.5, 0.25]))
    lens = {"yfov": 0.9, "aspectRatio": 1.5, "znear": 0.1, "zfar": 100}
    file.node(name="eye", translation=[0, 0, 6], camera=file.add("cameras", type="perspective", perspective=lens))
    return file
