"""Embree's objects, released with the Python objects that hold them: a device, geometries, and scenes (trees over these)."""

from __future__ import annotations

import threading
import weakref
from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.interface.instances import Instances
from torch_radbp.raycast import library
from torch_radbp.threads.team import threads

LARGE = 100_000  # triangles, which take some ten milliseconds


class Device:
    """An Embree device."""

    def __init__(self) -> None:
        self.handle = library.new_device()
        weakref.finalize(self, library.load_embree().rtcReleaseDevice, self.handle)


class TreeGeometry:
    """An Embree geometry: the triangles or instances that a tree is built over.

    Args:
        device: that makes it.
        kind: one of Embree's types.
        about: what it holds, in words, for errors.
    """

    def __init__(self, device: Device, kind: int, about: str):
        self.device, self.about = device, about
        self.handle = library.load_embree().rtcNewGeometry(device.handle, kind)
        library.check_for_error(device.handle, f"making a geometry of {about}")
        self.held: list = []  # tensors that Embree reads in place, and what else must live as long
        weakref.finalize(self, library.load_embree().rtcReleaseGeometry, self.handle)

    def share(self, kind: int, item: int, table: Tensor, count: int) -> None:
        """Lets Embree read the first `count` rows of a table in place."""
        self.held.append(table)
        library.load_embree().rtcSetSharedGeometryBuffer(self.handle, kind, 0, item, table.data_ptr(), 0,
                                                         table.stride(0) * table.element_size(), count)

    @staticmethod
    def of_triangles(device: Device, vertices: Tensor, faces: Tensor) -> TreeGeometry:
        """An Embree geometry of triangles: (V, 3) positions, of which (F, 3) int32 `faces` are the corners."""
        made = TreeGeometry(device, library.GEOMETRY_TYPE_TRIANGLE, f"{len(faces)} triangles")
        # Embree reads 16 bytes at a time: past the last vertex by 4.
        padded = torch.zeros(len(vertices) + 1, 3, dtype=torch.float32, device=vertices.device)
        padded[:-1] = vertices
        made.share(library.BUFFER_TYPE_VERTEX, library.FORMAT_FLOAT3, padded, len(vertices))
        made.share(library.BUFFER_TYPE_INDEX, library.FORMAT_UINT3, faces.contiguous(), len(faces))
        return made

    @staticmethod
    def of_instances(device: Device, tree: Tree, to_world: Tensor) -> TreeGeometry:
        """An Embree geometry that shows one tree at several places: (I, 3, 4) float32 transforms."""
        made = TreeGeometry(device, library.GEOMETRY_TYPE_INSTANCE_ARRAY, f"{len(to_world)} instances")
        made.held.append(tree)
        library.load_embree().rtcSetGeometryInstancedScene(made.handle, tree.handle)
        made.share(library.BUFFER_TYPE_TRANSFORM, library.FORMAT_FLOAT3X4_ROW_MAJOR, to_world.flatten(1).contiguous(),
                   len(to_world))
        return made


class Tree:
    """A bounding volume hierarchy over geometries: a scene of Embree's.

    A large one is built on a thread of its own: whoever makes it has other work until rays are cast, of which little is
    shared by threads.

    Args:
        device: that makes it.
        geometries: what it holds.
        triangles: about how many these are.

    Raises:
        RuntimeError: Embree reports an error; of a large one when `handle` is asked for.
    """

    def __init__(self, device: Device, geometries: Sequence[TreeGeometry], triangles: int):
        self.device, self.geometries = device, geometries
        self.scene = library.load_embree().rtcNewScene(device.handle)
        weakref.finalize(self, library.load_embree().rtcReleaseScene, self.scene)
        self.error: BaseException | None = None
        self.building: threading.Thread | None = None
        if triangles < LARGE or threads() == 1:
            self.build()
            self.wait()
        else:
            self.building = threading.Thread(target=self.build, name="torch_radbp_tree")
            self.building.start()

    def build(self) -> None:
        """Builds the tree on this thread, the only one to which Embree reports its errors."""
        embree = library.load_embree()
        try:
            embree.rtcSetSceneFlags(self.scene, library.SCENE_FLAG_ROBUST)  # no ray slips between two triangles
            for geometry in self.geometries:
                embree.rtcCommitGeometry(geometry.handle)
                embree.rtcAttachGeometry(self.scene, geometry.handle)
            embree.rtcCommitScene(self.scene)
            about = " and ".join(geometry.about for geometry in self.geometries)
            library.check_for_error(self.device.handle, f"building a scene of {about}")
        except BaseException as error:
            self.error = error

    @property
    def handle(self) -> int:
        """The address of Embree's scene, once it is built."""
        self.wait()
        return self.scene

    def wait(self) -> None:
        """Waits until the tree is built; raises the error if that failed."""
        building = self.building
        if building is not None:
            building.join()
            self.building = None
        if self.error is not None:
            raise self.error


class GroupTree(NamedTuple):
    """The tree of a group of shapes, and the triangles that it was built over, in the group's frame."""

    tree: Tree
    vertices: Tensor  # (V, 3)
    faces: Tensor  # (F, 3) int32, rows of `vertices`


def groups_of(device: Device, vertices: Tensor, faces: Tensor, instances: Instances,
              last_groups: Sequence[GroupTree]) -> list[GroupTree]:
    """The trees of the groups that instances show; trees of `last_groups` with the same triangles are reused.

    Args:
        device: for new ones.
        vertices: (V, 3) of the scene and of all groups.
        faces: (F, 3) likewise.
        instances: tell which are of which group.
        last_groups: of the same device.
    """
    firsts, groups = zip(instances.first_vertex, instances.first_triangle), []
    start = next(firsts)
    for end in firsts:
        points, corners = vertices[start[0]:end[0]], faces[start[1]:end[1]] - start[0]
        equal = next((group for group in last_groups
                      if torch.equal(group.vertices, points) and torch.equal(group.faces, corners)), None)
        groups.append(equal or GroupTree(Tree(device, [TreeGeometry.of_triangles(device, points, corners)], len(corners)),
                                         points, corners))
        start = end
    return groups
