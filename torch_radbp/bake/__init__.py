"""Optimised textures and shapes in forms that other programs read: `rb.bake.bitmap` of networks, `rb.bake.mesh` of shapes.

    scene.body.bsdf.reflectance = rb.bake.bitmap(scene.body.bsdf.reflectance, 512, scene.body)
    rb.save(scene, "found.glb")
"""

from torch_radbp.bake.bitmap_of_network import bitmap
from torch_radbp.bake.mesh_of_shape import mesh

__all__ = ["bitmap", "mesh"]
