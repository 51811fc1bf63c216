"""The triangle that contains each texel of a bitmap, by a mesh's surface coordinates."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch import Tensor

PAIRS = 1 << 22  # of a triangle and a texel that are looked at together
ON_EDGE = 1e-9  # of weights: centres on an edge belong to both triangles
WITHIN = 1e-5  # of weights: centres that lie in a triangle and not on its edge
REACH = 4.0  # texels around a triangle up to which its plane is continued


class TexelPlaces(NamedTuple):
    """The positions of the (H, W) texels of a bitmap on a mesh; row 0 is at v = 0."""

    triangle: Tensor  # (H, W) int64
    weights: Tensor  # (H, W, 3) float64, barycentric; negative where the texel is outside of the triangle
    shared: int  # number of texels whose centre is in several triangles

    def of_vertices(self, rows: Tensor, faces: Tensor) -> Tensor:
        """Interpolates vertex attributes, (V, K), at texels, (H, W, K); faces: (F, 3)."""
        return (rows[faces[self.triangle]] * self.weights.to(rows)[..., None]).sum(2)


def texels_of(uv: Tensor, faces: Tensor, height: int, width: int) -> TexelPlaces:
    """The triangle that contains each texel, or else one nearby.

    Bilinear reading at the borders of a chart mixes texels outside of it. Up to `REACH` texels away these continue the plane
    of the triangle, which leaves the surface right to the border; farther away they repeat what is nearest. A triangle that
    is so small that no centre lies in it has the texel that is closest to its middle, unless others are in there.

    Args:
        uv: (V, 2) within [0, 1], on the CPU.
        faces: (F, 3).
        height, width: of the bitmap.

    Raises:
        ValueError: if all triangles are degenerate in surface coordinates.
    """
    from scipy.ndimage import distance_transform_edt  # takes long to import

    size = torch.tensor([width, height], dtype=torch.float64)
    corners = (uv.double() * size - 0.5)[faces]  # (F, 3, 2), in texels from the centre of the first
    edges = corners[:, 1:] - corners[:, :1]
    usable = torch.linalg.det(edges).abs() > 0
    if not bool(usable.any()):
        raise ValueError("all triangles are degenerate in surface coordinates: they cover nothing of a bitmap")
    triangle = torch.full((height * width,), -1)
    count = torch.zeros(height * width, dtype=torch.int32)
    for owner, texel in pairs(corners, usable, height, width):
        weights = weights_in(corners[owner], texel % width, texel // width)
        inside = weights.min(1).values >= -ON_EDGE
        triangle[texel[inside]] = owner[inside]
        count += torch.bincount(texel[weights.min(1).values > WITHIN], minlength=len(count)).int()
    met = torch.zeros(len(faces), dtype=torch.bool).index_fill_(0, triangle[triangle >= 0], True)
    small = (usable & ~met).nonzero().squeeze(1)
    column, row = (corners[small].mean(1).round().long().clamp_min(0).minimum(size.long() - 1)).unbind(1)
    free = triangle[row * width + column] < 0
    triangle[(row * width + column)[free]] = small[free]
    distance, nearest = distance_transform_edt((triangle < 0).view(height, width).numpy(), return_indices=True)
    distance, (row, column) = torch.from_numpy(distance), torch.from_numpy(nearest).long()
    triangle = triangle[row * width + column]
    place = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    y, x = (torch.where(distance <= REACH, coordinate, other) for coordinate, other in zip(place, (row, column)))
    weights = weights_in(corners[triangle.flatten()], x.flatten(), y.flatten())
    return TexelPlaces(triangle, weights.view(height, width, 3), int((count > 1).sum()))


def pairs(corners: Tensor, usable: Tensor, height: int, width: int) -> Iterator[tuple[Tensor, Tensor]]:
    """Yields pairs of triangles and texels whose centres are in the triangles' bounding boxes: (P,) each, in parts.

    Args:
        corners: (F, 3, 2) x and y, in texels from the centre of the first.
        usable: (F,) those that count.
        height, width: of the bitmap.
    """
    most = torch.tensor([width, height]) - 1
    low = corners.amin(1).sub(1e-6).ceil().long().clamp_min(0)
    extent = (corners.amax(1).add(1e-6).floor().long().minimum(most) - low + 1).clamp_min(0)
    boxes = extent.prod(1) * usable
    part = (boxes.cumsum(0) // PAIRS).tolist()
    triangles = torch.arange(len(corners)).split([part.count(number) for number in sorted(set(part))])
    for some in triangles:
        owner = some.repeat_interleave(boxes[some])
        first = boxes[some].cumsum(0) - boxes[some]
        number = torch.arange(len(owner)) - first.repeat_interleave(boxes[some])
        across = extent[owner, 0]
        yield owner, (low[owner, 1] + number // across) * width + low[owner, 0] + number % across


def weights_in(corners: Tensor, x: Tensor, y: Tensor) -> Tensor:
    """(P, 3) barycentric coordinates of points x, y in triangles, (P, 3, 2); negative ones outside."""
    first = corners[:, 0]
    (a, b), (c, d) = ((corners[:, corner] - first).unbind(1) for corner in (1, 2))
    right, down = x - first[:, 0], y - first[:, 1]
    area = a * d - b * c
    second, third = (right * d - down * c) / area, (down * a - right * b) / area
    return torch.stack([1 - second - third, second, third], 1)
