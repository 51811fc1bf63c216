"""Edges that scattered directions slide over, since they follow a parameter, and that no boundary term has.

Attached directions follow the roughness, the index of refraction or the normals of a surface; those of ideal mirrors and of
all glass follow the surface itself and the camera, too. That attached directions at other materials do so as well is not
examined. Edges that cameras see by way of ideal mirrors and ideal glass alone are computed (`reflections`), and those that
are met by chance (`followed_light.py`), but not others seen in mirrors.
"""

from __future__ import annotations

from typing import NamedTuple

from torch_radbp.boundary.curve.rendering import Rendering
from torch_radbp.scene.packing.material_tables import one_sided
from torch_radbp.vertex.material import followed


class SlidOver(NamedTuple):
    """The parameters that turn scattered directions over edges for which there is no boundary term, and where these are."""

    names: dict[str, bool]  # True: hybrid sampling follows at all these surfaces, too
    seen_by_surfaces: bool  # alone: those that cameras see are computed
    lamps: bool  # some may be edges of lamps in ideal mirrors or glass, over which paths from lamps do not slide


def slid_over(rendering: Rendering) -> SlidOver:
    """The parameters of a rendering that turn scattered directions, as far as no boundary term counts it."""
    sampling = rendering.sampling
    names: dict[str, bool] = {}
    materials = [(bsdf, kind) for bsdf, kind in rendering.materials()
                 if followed(kind, sampling) and not (rendering.shadows and kind.smooth and not kind.delta)]
    computed = {id(bsdf) for bsdf, kind in materials if rendering.primary and kind.delta and not kind.follows
                and (rendering.shadows or not (sampling == "attached" and kind.smooth))}
    seen_by_others = rendering.max_depth > 2 and any(kind.smooth for _, kind in rendering.materials())
    if not seen_by_others:
        materials = [(bsdf, kind) for bsdf, kind in materials if id(bsdf) not in computed]
    for bsdf, kind in materials:
        names |= {name: kind.follows or not kind.smooth for name in rendering.turning(bsdf, kind)}
    hybrid = {id(bsdf): followed(kind, "hybrid") for bsdf, kind in materials}
    for shape, movers in zip(rendering.shapes, rendering.movers):
        delta = [hybrid[id(bsdf)] for bsdf in one_sided([shape.bsdf]) if id(bsdf) in hybrid]
        names |= {name: all(delta) for name in rendering.moving(shape, ("vertex_normals",)) if delta}
        names |= {name: True for name in movers if any(delta)}
    if sampling != "detached" and any(hybrid.values()):
        names |= {name: True for cameras in rendering.camera_movers for name in cameras}
    ideal = any(kind.delta for _, kind in materials)
    return SlidOver(names, all(id(bsdf) in computed for bsdf, _ in materials),
                    ideal and seen_by_others and lamps_beside_mirrors(rendering))


def lamps_beside_mirrors(rendering: Rendering) -> bool:
    """True if a scene has lamps of finite extent, and ideal mirrors or glass in which surfaces might see them."""
    def found() -> bool:
        lamps = any(not (kind.delta or kind.surround) for kind in (emitter.kind() for emitter in rendering.emitters))
        return lamps and any(kind.delta for _, kind in rendering.materials())

    return rendering.known("lamps beside mirrors", found)
