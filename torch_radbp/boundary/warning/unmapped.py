"""Warns of textures on meshes without surface coordinates, where they have one value."""

from __future__ import annotations

from torch_radbp.boundary.curve.rendering import Rendering, listed, texture_name
from torch_radbp.plugin import SceneWarning, Texture
from torch_radbp.scene.packing.attributes import textures_of
from torch_radbp.texture.bitmap import reader_of


def unmapped_textures(rendering: Rendering) -> SceneWarning | None:
    """The warning that textures read texture coordinates of meshes that have none, or None."""
    scene, shapes, textures = rendering.scene, [], []
    for number, shape in enumerate(rendering.shapes):
        owners = filter(None, (shape.bsdf, shape.emitter))
        read = [texture for owner in owners for _, texture in textures_of(owner) if varies_with_uv(texture)]
        if read and rendering.placed(number).surface.uv is None:
            shapes.append(rendering.names[id(shape)])
            textures += (texture_name(scene, texture) for texture in read)
    if not shapes:
        return None
    return SceneWarning(f"{listed(shapes)} {'has' if len(shapes) == 1 else 'have'} no surface coordinates, which "
                        f"{listed(textures)} {'is' if len(set(textures)) == 1 else 'are'} read at: (0, 0) is taken "
                        f"everywhere, so that such a texture has one value all over the surface. Give the mesh coordinates, "
                        f"`vertex_texcoords` or those of its file, or read another kind of texture there, such as "
                        f"mesh_attribute or NeuralTexture(module, of='position')")


def varies_with_uv(texture: Texture) -> bool:
    """True if a texture may vary with texture coordinates."""
    of_one_texel = texture.tabulated and not texture.parts() and texture.resolution() == (1, 1)
    return reader_of(texture).needs_uv and not of_one_texel
