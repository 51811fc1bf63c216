"""What is left to paths from the camera where all other light is that of paths from lamps; see `path/light_share.py`."""

from __future__ import annotations

from torch_radbp.boundary.curve.triangles_in_view import is_quick, may_see
from torch_radbp.call.lamps import narrow_triangles
from torch_radbp.call.render_call import RenderCall


def cameras_see_own_light(call: RenderCall) -> bool:
    """False if no camera of a call sees a lamp or a surface of small roughness, so that with light_paths="all" paths from
    cameras bring nothing; true also where it would take long to find out.

    Args:
        call: whose scene tells the materials of small roughness.
    """
    scene, layout = call.still_scene, call.scene.layout
    paths = call.spp * sum(view.width * view.height for view in call.views)
    around = layout.surround is not None or layout.media or layout.traces_segments
    if around or not is_quick(scene, paths):
        return True
    own = narrow_triangles(scene)
    if layout.lit_surfaces:
        own = own | (scene.triangles.emitter >= 0)
    return any(may_see(view, scene, own) for view in call.views)
