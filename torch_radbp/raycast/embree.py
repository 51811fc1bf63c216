"""Ray casting on the CPU by Embree 4, called in packets from compiled loops on torch's own threads.

Embree's Python wheel is used for its shared library only (`library.py`); lanes go to it through the loops of `packets.py`,
on the threads of `team.py`.
"""

from __future__ import annotations

import weakref

import numpy as np
import torch
from torch import Tensor

from torch_radbp.raycast import library, packets, team
from torch_radbp.raycast.mesh import check_lanes, checked_faces, checked_vertices
from torch_radbp.raycast.protocol import Hit, Ray
from torch_radbp.vec import Vec3, cross, dot

CPU = torch.device("cpu")


class Embree:
    """A `RayCaster` for tensors on the CPU; the query itself is in float32.

    For float64 rays u and v are computed again in float64 from the ray and the triangle found, so that the point lies on the
    ray to that accuracy; which triangle is found remains a decision in float32. Components that are not contiguous are
    copied. A copy or an unpickled caster builds its own scene and counts its rays from zero.

    Args:
        vertices: (V, 3) float32 or float64, finite; copied.
        faces: (F, 3) integers in [0, V). Triangles without area are never hit.

    Raises:
        ValueError: the mesh is not as said above.
        RuntimeError: Embree is not installed, or reports an error.
    """

    def __init__(self, vertices: Tensor, faces: Tensor) -> None:
        for name, tensor in (("vertices", vertices), ("faces", faces)):
            if tensor.device != CPU:
                raise ValueError(f"Embree casts rays on the CPU, got {name} on {tensor.device}; use another ray caster")
        self.vertices = checked_vertices(vertices)
        self.faces = checked_faces(faces, len(vertices))
        self.rays_cast = 0
        self._build()

    def _build(self) -> None:
        """Makes device, geometry and scene, and leaves their release to the garbage collector."""
        self._embree = embree = library.load()
        # Embree reads the buffer that we write in `update`, and may read 16 bytes from the start of the last vertex.
        self._buffer = torch.zeros(len(self.vertices) + 1, 3)
        self._buffer[:-1] = self.vertices

        device = self._device = library.new_device()
        scene = self._scene = embree.rtcNewScene(device)
        geometry = self._geometry = embree.rtcNewGeometry(device, library.GEOMETRY_TYPE_TRIANGLE)
        self._release = weakref.finalize(self, _release, embree, device, scene, geometry)

        # Robust: no ray slips between two triangles that share an edge.
        embree.rtcSetSceneFlags(scene, library.SCENE_FLAG_ROBUST)
        for kind, form, data, count in (
            (library.BUFFER_TYPE_VERTEX, library.FORMAT_FLOAT3, self._buffer, len(self.vertices)),
            (library.BUFFER_TYPE_INDEX, library.FORMAT_UINT3, self.faces, len(self.faces)),
        ):
            embree.rtcSetSharedGeometryBuffer(geometry, kind, 0, form, data.data_ptr(), 0, 12, count)
        embree.rtcCommitGeometry(geometry)
        embree.rtcAttachGeometry(scene, geometry)
        embree.rtcCommitScene(scene)
        library.check(device, f"building a scene of {len(self.faces)} triangles")

    def update(self, vertices: Tensor) -> None:
        """Moves the vertices and builds the scene's hierarchy again."""
        self.vertices = checked_vertices(vertices, count=len(self.vertices))
        self._buffer[:-1] = self.vertices
        self._embree.rtcUpdateGeometryBuffer(self._geometry, library.BUFFER_TYPE_VERTEX, 0)
        self._embree.rtcCommitGeometry(self._geometry)
        self._embree.rtcCommitScene(self._scene)
        library.check(self._device, "moving the vertices")

    def intersect(self, ray: Ray) -> Hit:
        check_lanes(ray, None, CPU)
        prim = torch.empty(ray.o.x.shape, dtype=torch.int32)
        hit = Hit(prim, torch.empty(prim.shape), torch.empty(prim.shape))
        self._query(packets.closest_hit, self._embree.rtcIntersect8, ray, **hit._asdict())
        return hit if ray.o.x.dtype == torch.float32 else self._in_dtype_of(ray, hit)

    def occluded(self, ray: Ray, tmax: Tensor) -> Tensor:
        check_lanes(ray, tmax, CPU)
        hidden = torch.empty(ray.o.x.shape, dtype=torch.bool)
        self._query(packets.any_hit, self._embree.rtcOccluded8, ray, tmax=single(tmax), hidden=hidden)
        return hidden

    def _query(self, loop, query, ray: Ray, **columns: Tensor) -> None:
        """Runs a loop of `packets` over all lanes; `columns` are contiguous tensors named as in its job record."""
        columns |= zip(("ox", "oy", "oz", "dx", "dy", "dz"), map(single, (*ray.o, *ray.d)), strict=True)
        lanes = ray.o.x.numel()
        job = np.zeros((), packets.JOB)
        job["query"], job["scene"], job["lanes"] = library.address(query), self._scene, lanes
        for name, tensor in columns.items():
            job[name] = tensor.data_ptr()
        counter = np.zeros((), np.int64)
        job["next_lane"] = counter.ctypes.data
        blocks = -(-lanes // packets.BLOCK)
        team.run(loop.address, job.ctypes.data, max(1, min(torch.get_num_threads(), blocks)))
        self.rays_cast += lanes

    def _in_dtype_of(self, ray: Ray, hit: Hit) -> Hit:
        """u and v of the line's intersection with the triangle's plane, in the ray's dtype (Moeller and Trumbore 1997)."""
        found = hit.prim >= 0
        corners = self.vertices.to(ray.o.x.dtype)[self.faces[hit.prim.clamp(min=0)].long()]
        p0, p1, p2 = (Vec3.of(corners[..., corner, :]) for corner in range(3))
        e1, e2, s = p1 - p0, p2 - p0, ray.o - p0
        normal_to_d = cross(ray.d, e2)
        determinant = dot(e1, normal_to_d)
        u, v = dot(s, normal_to_d) / determinant, dot(ray.d, cross(s, e1)) / determinant
        found &= determinant != 0
        return Hit(hit.prim, torch.where(found, u, hit.u.to(u.dtype)), torch.where(found, v, hit.v.to(v.dtype)))

    def __reduce__(self):
        return Embree, (self.vertices, self.faces)


def single(lanes: Tensor) -> Tensor:
    """The lanes as Embree reads them: detached float32, contiguous; a copy only if they are not."""
    return lanes.detach().to(torch.float32).contiguous()


def _release(embree, device: int, scene: int, geometry: int) -> None:
    embree.rtcReleaseGeometry(geometry)
    embree.rtcReleaseScene(scene)
    embree.rtcReleaseDevice(device)
