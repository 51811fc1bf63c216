"""Embree's objects, released with the Python objects that hold them: a device, geometries, and the trees over these."""

from __future__ import annotations

import weakref
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.raycast import library
from torch_radbp.shape.placement import Instances


class Device:
    """A device of Embree's."""

    def __init__(self) -> None:
        self.handle = library.new_device()
        weakref.finalize(self, library.load().rtcReleaseDevice, self.handle)


class Geometry:
    """Something that a tree is built of.

    Args:
        device: that makes it.
        kind: one of Embree's types.
        about: what it holds, in words, for errors.
    """

    def __init__(self, device: Device, kind: int, about: str):
        self.device, self.about = device, about
        self.handle = library.load().rtcNewGeometry(device.handle, kind)
        library.check(device.handle, f"making a geometry of {about}")
        self.held: list = []  # tensors that Embree reads in place, and what else must live as long
        weakref.finalize(self, library.load().rtcReleaseGeometry, self.handle)

    def share(self, kind: int, item: int, table: Tensor, count: int) -> None:
        """Lets Embree read the first `count` rows of a table in place."""
        self.held.append(table)
        library.load().rtcSetSharedGeometryBuffer(self.handle, kind, 0, item, table.data_ptr(), 0,
                                                  table.stride(0) * table.element_size(), count)

    @staticmethod
    def of_triangles(device: Device, vertices: Tensor, faces: Tensor) -> Geometry:
        """Triangles: (V, 3) positions, of which (F, 3) int32 `faces` are the corners."""
        made = Geometry(device, library.GEOMETRY_TYPE_TRIANGLE, f"{len(faces)} triangles")
        # Embree reads 16 bytes at a time: past the last vertex by 4.
        padded = torch.zeros(len(vertices) + 1, 3, dtype=torch.float32, device=vertices.device)
        padded[:-1] = vertices
        made.share(library.BUFFER_TYPE_VERTEX, library.FORMAT_FLOAT3, padded, len(vertices))
        made.share(library.BUFFER_TYPE_INDEX, library.FORMAT_UINT3, faces.contiguous(), len(faces))
        return made

    @staticmethod
    def of_instances(device: Device, tree: Tree, to_world: Tensor) -> Geometry:
        """A tree at several places: (I, 3, 4) float32 transforms."""
        made = Geometry(device, library.GEOMETRY_TYPE_INSTANCE_ARRAY, f"{len(to_world)} instances")
        made.held.append(tree)
        library.load().rtcSetGeometryInstancedScene(made.handle, tree.handle)
        made.share(library.BUFFER_TYPE_TRANSFORM, library.FORMAT_FLOAT3X4_ROW_MAJOR, to_world.flatten(1).contiguous(),
                   len(to_world))
        return made


class Tree:
    """A hierarchy over geometries, which rays can be cast against: a scene of Embree's.

    Raises:
        RuntimeError: Embree reports an error.
    """

    def __init__(self, device: Device, geometries: Sequence[Geometry]):
        embree = library.load()
        self.geometries = geometries
        self.handle = embree.rtcNewScene(device.handle)
        weakref.finalize(self, embree.rtcReleaseScene, self.handle)
        embree.rtcSetSceneFlags(self.handle, library.SCENE_FLAG_ROBUST)  # no ray slips between two triangles with one edge
        for geometry in geometries:
            embree.rtcCommitGeometry(geometry.handle)
            embree.rtcAttachGeometry(self.handle, geometry.handle)
        embree.rtcCommitScene(self.handle)
        library.check(device.handle, f"building a scene of {' and '.join(geometry.about for geometry in geometries)}")


class Group(NamedTuple):
    """The tree of a group, and what it was built of, in the group's frame."""

    tree: Tree
    vertices: Tensor  # (V, 3)
    faces: Tensor  # (F, 3) int32, rows of these


def groups_of(device: Device, vertices: Tensor, faces: Tensor, instances: Instances, known: Sequence[Group]) -> list[Group]:
    """The groups that instances show; those of `known`, which are of the same device, whose triangles are the same.

    Args:
        device: for new ones.
        vertices: (V, 3) of the scene and of all groups.
        faces: (F, 3) likewise.
        instances: tell which are of which group.
        known: groups of before.
    """
    firsts, groups = zip(instances.first_vertex.tolist(), instances.first_triangle.tolist()), []
    start = next(firsts)
    for end in firsts:
        own, corners = vertices[start[0]:end[0]], faces[start[1]:end[1]] - start[0]
        same = next((group for group in known
                     if torch.equal(group.vertices, own) and torch.equal(group.faces, corners)), None)
        groups.append(same or Group(Tree(device, [Geometry.of_triangles(device, own, corners)]), own, corners))
        start = end
    return groups
