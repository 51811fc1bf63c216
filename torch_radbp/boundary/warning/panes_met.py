"""Warns of panes and masks in scenes with media that paths meet, instead of passing them straight."""

from __future__ import annotations

from torch_radbp.boundary.curve.rendering import Rendering, listed, texture_name
from torch_radbp.interface.bsdf import Kind
from torch_radbp.plugin import BSDF, SceneWarning, Texture
from torch_radbp.texture.bitmap import reader_of


def panes_met(rendering: Rendering) -> SceneWarning | None:
    """The warning that textures keep rays in media from passing panes or masks straight, without a bounce; or None."""
    if not rendering.call.scene.layout.traces_segments:
        return None
    met = {texture_name(rendering.scene, texture): rendering.scene.name_of(bsdf)
           for bsdf, kind in rendering.materials() for texture in in_the_way(bsdf, kind)}
    if not met:
        return None
    return SceneWarning(f"in a scene with media rays pass straight through panes and masks without a bounce, but not "
                        f"through {listed(met.values())}: networks and bitmaps of the filter_type 'trilinear', as "
                        f"{listed(met)}, are not read on the way. There passing is a bounce, and connections to "
                        f"lights are blocked. Give a bitmap of another filter_type; rb.bake.bitmap makes one of a network")


def in_the_way(bsdf: BSDF, kind: Kind) -> list[Texture]:
    """The textures of a material by which rays in media bounce at it, though some light passes straight; mostly none.

    They are networks, and bitmaps filtered by a sample's footprint, neither of which is read between two bounces.
    """
    if not kind.straight or kind.invisible:
        return []
    return [texture for texture in bsdf.textures() if reader_of(texture).outside or reader_of(texture).needs_footprint]
