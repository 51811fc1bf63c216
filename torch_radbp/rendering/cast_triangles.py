"""The triangles of a scene as ray casters are built from them."""

from __future__ import annotations

from collections.abc import Sequence

from torch_radbp.raycast.caster_cache import CastTriangles
from torch_radbp.scene.packing.geometry import PlacedShape
from torch_radbp.scene.tables.scene_tensors import TriangleTable
from torch_radbp.tensors.differentiated import primal


def cast_triangles(triangles: TriangleTable, placed: Sequence[PlacedShape] = ()) -> CastTriangles:
    """The triangles of a scene, detached; `placed`: the shapes to which they belong, if these are known."""
    return CastTriangles(triangles.vertices.p.map(primal), triangles.corners, triangles.balls, triangles.casting_instances,
                         tuple(shape.vertices for shape in placed))
