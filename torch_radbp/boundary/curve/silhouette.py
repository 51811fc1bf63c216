"""Silhouette edges in the view of a camera."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.sensor.kind import Camera
from torch_radbp.tensors.vec import Vec3, cross, dot

ROUNDING = 1e-9  # of sums of products, relative
MARGIN = 1e-4  # left out at the border of the image, as a share of its size: a surface may end exactly there


class CameraSight(NamedTuple):
    """The camera and film size of one sensor."""

    camera: Camera  # detached
    width: int  # of its crop window, pixels
    height: int


class Eye(NamedTuple):
    """A viewpoint, () float64 each: a position in homogeneous coordinates, or with w = 0 the direction towards it."""

    place: Vec3
    w: Tensor
    radius: Tensor | None = None  # of a ball around it from anywhere in which an edge may be seen; None: 0

    @staticmethod
    def of(place: Tensor, radius: Tensor | None = None) -> Eye:
        """The viewpoint at a (4,) homogeneous position."""
        x, y, z, w = place.double().unbind()
        return Eye(Vec3(x, y, z), w, radius)

    def towards(self, p: Vec3) -> Vec3:
        """Vectors from the viewpoint to (N,) points p, of any length."""
        return p * self.w - self.place


def is_silhouette(a: Vec3, b: Vec3, opposite: Sequence[Vec3], towards: Vec3, radius: Tensor | None = None) -> Tensor:
    """(N,) bool: edges that are silhouettes from a viewpoint, or within `radius` of it.

    All triangles at such an edge lie on one side of it as seen from there: the single triangle at the rim of a surface, or
    two of which one is seen from the front and the other from behind. The orientation of triangles does not matter: two
    neighbours in a plane lie on different sides. Of a triangle that is seen edge-on only the nearer edges count.

    Args:
        a, b: (N,) the ends, float64.
        opposite: (N,) each, the third vertex of each triangle; some may be the same.
        towards: (N,) from the eye to `a`, of any length.
        radius: of `Eye`.
    """
    along, one, other, either = b - a, *(torch.zeros_like(a.x, dtype=torch.bool) for _ in range(3))
    hides, length = either, dot(along, along)
    for tip in opposite:
        inwards = tip - a
        normal = cross(along, inwards)
        products = normal * towards
        side, size = products.x + products.y + products.z, products.x.abs() + products.y.abs() + products.z.abs()
        edge_on = side.abs() <= ROUNDING * size
        across = inwards * length - along * dot(inwards, along)  # of any length
        one, other = one | ((side > 0.0) & ~edge_on), other | ((side < 0.0) & ~edge_on)
        hides = hides | (edge_on & (dot(across, towards) < 0.0))
        if radius is not None:
            either = either | (side.abs() <= radius * torch.sqrt(dot(normal, normal)))
    return either | ((one ^ other) & ~hides)


def crosses_view(a: Vec3, b: Vec3, sight: CameraSight) -> Tensor:
    """(N,) bool: segments of which a part is in the camera's view.

    Args:
        a, b: (N,) the ends, float64, world space.
        sight: of the camera.
    """
    camera, width, height = sight
    x, y = limits(camera.film.crop_x, camera.film.size_x, width), limits(camera.film.crop_y, camera.film.size_y, height)
    return camera.kind.crosses_view(camera.lens, x, y, a, b)


def limits(crop: Tensor, size: Tensor, pixels: int) -> Tensor:
    """The borders of a film window on the image, enlarged by a margin, as shares of the image; (2,) float64."""
    return torch.stack([(crop + share * pixels) / size for share in (MARGIN, 1.0 - MARGIN)]).double()
