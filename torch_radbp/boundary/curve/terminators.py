"""Edges inside of smoothly shaded surfaces at which a lamp's light ends (shadow terminators).

Interpolated normals go on across an edge between two triangles, but light does not if one of them faces the lamp and the
other faces away: the latter lies in the shade of the mesh itself. The cosine of the interpolated normal need not be 0 there,
so that the image jumps, the more the larger triangles are: on a ball of 320 triangles that a lamp lights from the side that
makes 5 % of the derivative (`tests/boundary/test_terminators.py`).

Where a mesh turns, or a lamp moves about it, whole triangles turn from the lamp as well: a derivative at one moment misses
that. Lamps that surround the scene are left out, too: what a triangle hides of them is as small as the square of the angle
between triangles.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from torch_radbp.boundary.curve.silhouette import Eye, is_silhouette
from torch_radbp.call.render_call import RenderCall
from torch_radbp.interface.emitter import EmittingTriangles
from torch_radbp.tensors.vec import Vec3

MOST_LAMPS = 8  # that are told apart; of more, light may end at every edge


def lamps_of(call: RenderCall) -> tuple[Eye, ...]:
    """The lamps of a scene as viewpoints, area lights as bounding spheres of all of one kind; empty without smooth shading.

    Args:
        call: detached.
    """
    scene = call.scene
    if scene.triangles.vertices.n is None:
        return ()
    places = [source.place for emitter in call.module.emitters
              for source in [emitter.source()] if source is not None]
    eyes = [Eye.of(place.to(scene.device)) for place in places]
    eyes += [_around(table) for kind, table in zip(scene.layout.lights, scene.lights.tables) if kind.on_surface]
    if len(eyes) > MOST_LAMPS:
        nowhere = torch.zeros(4, dtype=torch.float64, device=scene.device)
        return (Eye.of(nowhere, torch.full_like(nowhere[0], torch.inf)),)
    return tuple(eyes)


def _around(table: EmittingTriangles) -> Eye:
    """The viewpoint in the middle of emitting triangles, with the radius of a sphere around them."""
    corners = torch.cat([corner.stack() for corner in table.p]).double()
    low, high = corners.amin(0), corners.amax(0)
    middle = 0.5 * (low + high)
    return Eye.of(torch.cat([middle, torch.ones_like(middle[:1])]), 0.5 * (high - low).norm())


def light_may_end(lamps: Sequence[Eye], a: Vec3, b: Vec3, opposite: Sequence[Vec3]) -> Tensor:
    """(N,) bool: edges that may lie between a triangle that faces a lamp and one that faces away.

    Args:
        lamps: of the scene.
        a, b, opposite: as for `is_silhouette`.
    """
    found = torch.zeros_like(a.x, dtype=torch.bool)
    for lamp in lamps:
        found = found | is_silhouette(a, b, opposite, lamp.towards(a), lamp.radius)
    return found
