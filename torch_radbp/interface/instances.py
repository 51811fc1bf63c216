"""The poses of instances, by which each triangle of a group is in many places."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import torch
from torch import Tensor


class Instances(NamedTuple):
    """The I instances of the G groups of a scene, detached; all instances of a group one after the other.

    Vertices and triangles of groups come after those of the scene itself, and each once, in the frame of its group. A hit
    counts instances from 1; 0 is the scene itself.
    """

    to_world: Tensor  # (I, 3, 4) the upper rows of affine transforms from the group's frame
    first_vertex: tuple[int, ...]  # G + 1; the end of each group is the beginning of the next one
    first_triangle: tuple[int, ...]  # G + 1
    first_instance: tuple[int, ...]  # G + 1
    boxes: Tensor  # (I, 8, 3) corners of a box around each instance, world space

    def by_hit(self, dtype: torch.dtype) -> Tensor:
        """(I + 1, 3, 4) the transforms, indexed by a hit's instance; row 0 is the identity."""
        identity = torch.eye(4, dtype=dtype, device=self.to_world.device)[None, :3]
        return torch.cat([identity, self.to_world.to(dtype)])

    def extent(self, vertices: Tensor) -> Tensor:
        """() the longest side of the scene's bounding box; `vertices` (V, 3) are those of the scene and of all groups."""
        corners = torch.cat([vertices[:self.first_vertex[0]], self.boxes.reshape(-1, 3).to(vertices)])
        return (corners.amax(0) - corners.amin(0)).max()

    def counts(self) -> list[int]:
        """The number of instances of each group."""
        return [end - start for start, end in pairwise(self.first_instance)]

    def shown_triangles(self) -> int:
        """The number of triangles that instances show, those of a group once for each instance."""
        return sum((end - start) * count for (start, end), count in zip(pairwise(self.first_triangle), self.counts()))

    def triangles(self) -> int:
        """The number of triangles of the whole scene, those of a group once for each instance."""
        return self.first_triangle[0] + self.shown_triangles()


class Expanded(NamedTuple):
    """The triangles of a scene in the world, with a copy for every instance."""

    vertices: Tensor  # (V', 3)
    faces: Tensor  # (T', 3) int32
    triangle: Tensor  # (T',) int32, the scene's triangle that each is a copy of
    instance: Tensor  # (T',) int32, its instance as in a hit


def expanded(vertices: Tensor, faces: Tensor, instances: Instances, most: int | None = None) -> Expanded:
    """Copies the triangles of a scene and of its instances to the world.

    Args:
        vertices: (V, 3) of the scene and of its groups.
        faces: (T, 3) int32, likewise.
        instances: of the groups.
        most: number of triangles of each group to stop at, after whole instances spread over all of them, at least one;
            None: all.
    """
    vertex, triangle, instance = instances[1:4]
    device = faces.device
    points, corners = [vertices[:vertex[0]]], [faces[:triangle[0]].to(torch.int32)]
    of, shown, count = [torch.arange(triangle[0], device=device)], [torch.zeros(triangle[0], device=device)], vertex[0]
    for group in range(len(vertex) - 1):
        size, length = triangle[group + 1] - triangle[group], vertex[group + 1] - vertex[group]
        step = 1 if most is None else max(1, -(-(instance[group + 1] - instance[group]) * size // max(most, size)))
        chosen = torch.arange(instance[group], instance[group + 1], step, device=device)
        matrices, local = instances.to_world[chosen].to(vertices.dtype), vertices[vertex[group]:vertex[group + 1]]
        points.append((matrices[:, None, :, :3] * local[None, :, None]).sum(-1).add_(matrices[:, None, :, 3]).flatten(0, 1))
        local = faces[triangle[group]:triangle[group + 1]].to(torch.int32) - vertex[group]
        shift = count + length * torch.arange(len(chosen), dtype=torch.int32, device=device)
        corners.append((local + shift[:, None, None]).flatten(0, 1))
        of.append(torch.arange(triangle[group], triangle[group + 1], device=device).repeat(len(chosen)))
        shown.append((chosen + 1).repeat_interleave(size))
        count += length * len(chosen)
    return Expanded(torch.cat(points), torch.cat(corners), torch.cat(of).to(torch.int32), torch.cat(shown).to(torch.int32))
