"""Which media shapes enclose, so that every ray in them must meet a surface.

A flight that ends nearer to the boundary than numbers are exact may lie beyond it, and a ray may slip through between two
triangles. Such a ray is in the medium and meets nothing: a way of no end, on which the medium would emit, scatter and absorb
without limit. Where shapes enclose the medium it is known that the ray has left it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.plugin import Medium
from torch_radbp.scene.cache.pack_cache import PackCache
from torch_radbp.scene.packing.geometry import PlacedShape
from torch_radbp.shape.surface import Surface
from torch_radbp.shape.welding import cells_of, weld_size, welded


class Enclosure(NamedTuple):
    """The orientation of a closed surface's triangles, and its bounding box."""

    outwards: bool  # its triangles face outwards
    low: tuple[float, ...]  # (3,) of its bounding box
    high: tuple[float, ...]

    def holds(self, other: Enclosure) -> bool:
        """True if this bounding box contains that of another enclosure."""
        return all(a <= b for a, b in zip((*self.low, *other.high), (*other.low, *self.high)))


class Side(NamedTuple):
    """One side of a shape that a medium borders on."""

    shape: Surface
    enclosure: Enclosure | None  # None: the shape is not closed
    inner: bool


def enclosed_media(cache: PackCache, shapes: Sequence[Surface], placed: Sequence[PlacedShape], media: Sequence[Medium],
                   around: Medium | None) -> tuple[int, ...]:
    """The numbers of the homogeneous media that closed shapes enclose, so that each ray in them meets a surface.

    A medium lies on the inner sides of closed shapes, and possibly on the outer side of those inside such a shape. Sensors
    stand in none of them.

    Args:
        cache: of the part of the scene to which this belongs.
        shapes, placed: all of the scene.
        media: all of the scene.
        around: the medium in which the sensors stand.
    """
    sides: dict[Medium, list[Side]] = {
        medium: [] for medium in media if medium is not around and not medium.kind().heterogeneous}
    for shape, triangles in zip(shapes, placed):
        if sides and (shape.interior in sides or shape.exterior in sides):
            enclosure = cache(enclosure_of, triangles.vertices, triangles.faces)
            for medium, behind in ((shape.interior, True), (shape.exterior, False)):
                if medium is not None and medium in sides:
                    sides[medium].append(Side(shape, enclosure, enclosure is not None and enclosure.outwards == behind))
    return tuple(number for number, medium in enumerate(media) if sides.get(medium) and all(
        side.enclosure is not None and (side.inner or any(
            other.inner and other.shape is not side.shape and other.enclosure.holds(side.enclosure)
            for other in sides[medium])) for side in sides[medium]))


def enclosure_of(vertices: Tensor, faces: Tensor) -> Enclosure | None:
    """The orientation and the bounding box of a closed surface; None: it is open, or its triangles do not face one way.

    Args:
        vertices: (V, 3), detached.
        faces: (F, 3) integers.
    """
    if not is_without_borders(vertices, faces):
        return None
    first, second, third = (vertices.double() - vertices[0].double())[faces].unbind(1)
    volume = float((first * torch.linalg.cross(second, third)).sum())
    low, high = vertices.aminmax(dim=0)
    return None if volume == 0.0 else Enclosure(volume > 0.0, tuple(low.tolist()), tuple(high.tolist()))


def is_without_borders(vertices: Tensor, faces: Tensor) -> bool:
    """True if a surface is closed and consistently oriented: along each edge as many triangles run in one direction as in
    the other. Vertices at the same place count as one; args as for `enclosure_of`."""
    if not len(faces):
        return False
    label = welded(cells_of(vertices, weld_size(vertices)))
    start = (faces if label is None else label[faces]).long()
    end = start.roll(-1, 1)
    forwards, backwards = start * len(vertices) + end, end * len(vertices) + start
    apart = start != end
    return torch.equal(forwards[apart].sort().values, backwards[apart].sort().values)
