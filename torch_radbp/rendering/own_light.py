"""What is left to paths from the camera where all other light is that of paths from lamps; see `path/light_share.py`."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.boundary.curve.places import known_view
from torch_radbp.call.lamps import narrow_triangles
from torch_radbp.call.render_call import RenderCall
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.scene.tables.triangle_corners import at_corners
from torch_radbp.tensors.differentiated import detached
from torch_radbp.tensors.vec import Vec3


def cameras_see_own_light(call: RenderCall) -> bool:
    """False if no camera of a call sees a lamp or a surface that scatters narrowly, so that with "all" paths from it bring
    nothing. True where that would take long to find out.

    Args:
        call: with the narrow materials that there are.
    """
    scene, layout = call.still_scene, call.scene.layout
    paths = call.spp * sum(view.width * view.height for view in call.views)
    around = layout.surround is not None or layout.media or layout.traces_segments
    if around or scene.triangles.instances is not None or len(scene.triangles.material) > paths:
        return True
    corners = own_corners(scene)
    return any(bool((~known_view(detached(view.camera), view.width, view.height)[1].misses(corners)).any())
               for view in call.views)


def own_corners(scene: SceneTensors) -> tuple[Vec3, Vec3, Vec3]:
    """The corners of the triangles that shine or scatter narrowly, (N,) float64 each."""
    triangles = scene.triangles
    own = narrow_triangles(scene)
    if scene.layout.lit_surfaces:
        own = own | (triangles.emitter >= 0)
    rows: list[Tensor] = [corner[own] for corner in triangles.corners]
    return tuple(Vec3(*(part.double() for part in corner)) for corner in at_corners(triangles.vertices.p, rows))
