"""Whether a camera sees any of some triangles, by the planes of its frustum alone."""

from __future__ import annotations

from torch import Tensor

from torch_radbp.boundary.curve.places import known_view
from torch_radbp.call.lamps import narrow_triangles
from torch_radbp.call.view import View
from torch_radbp.scene.tables.scene_tensors import SceneTensors
from torch_radbp.scene.tables.triangle_corners import at_corners
from torch_radbp.tensors.differentiated import detached
from torch_radbp.tensors.vec import Vec3


def may_see(view: View, scene: SceneTensors, some: Tensor) -> bool:
    """False if each of some triangles lies outside of the camera's view, behind one and the same plane of its frustum.

    Args:
        view: the view of the camera.
        scene: detached, without instances.
        some: (T,) bool, True for the triangles.
    """
    rows = tuple(corner[some] for corner in scene.triangles.corners)
    corners = tuple(Vec3(*(part.double() for part in corner)) for corner in at_corners(scene.triangles.vertices.p, rows))
    _, frustum = known_view(detached(view.camera), view.width, view.height)
    return bool((~frustum.misses(corners)).any())


def is_quick(scene: SceneTensors, paths: int) -> bool:
    """True if `may_see` is quicker than tracing `paths` paths, and the scene has no instances or invisible surfaces."""
    triangles, appearances = scene.triangles, scene.layout.appearances
    invisible = any(appearance.kind.invisible for appearance in appearances)
    return triangles.instances is None and len(triangles.material) <= paths and not invisible


def may_see_ideal_surfaces(view: View, scene: SceneTensors, paths: int) -> bool:
    """False if no surface with an ideal lobe, or flagged as of small roughness, is in view; True if that takes long to tell.

    Args as of `may_see` and `is_quick`.
    """
    return not is_quick(scene, paths) or may_see(view, scene, narrow_triangles(scene))
