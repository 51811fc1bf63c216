"""Ray casting on the CPU by Embree 4, called in packets from compiled loops on torch's own threads.

Of the `embreex` wheel only the shared library is used (`library.py`). Lanes go to it through the loops of `packets.py`,
which run on the threads of `team.py`.
"""

from __future__ import annotations

import weakref
from threading import Lock

import numpy as np
import torch
from torch import Tensor

from torch_radbp.raycast import library, packets, team
from torch_radbp.raycast.mesh import check_lanes, checked_faces, checked_vertices
from torch_radbp.raycast.protocol import Hit, Ray
from torch_radbp.vec import Vec3, cross, dot

CPU = torch.device("cpu")


class Embree:
    """A `RayCaster` for tensors on the CPU; Embree itself works in float32.

    For float64 rays u and v are computed again in float64 from the ray and the triangle found, so that the point lies
    on the ray to that accuracy; which triangle is found remains a decision in float32. Components that are not
    contiguous are copied. A copied or unpickled caster builds its own scene and counts its rays from zero.

    Args:
        vertices: (V, 3) float32 or float64, finite; copied.
        faces: (F, 3) integers in [0, V); copied. Triangles without area are never hit.

    Raises:
        ValueError: the mesh is not as said above, or not on the CPU.
        RuntimeError: Embree is not installed, or reports an error.
    """

    def __init__(self, vertices: Tensor, faces: Tensor) -> None:
        self.vertices = checked_vertices(vertices, device=CPU)
        self.faces = checked_faces(faces, len(self.vertices), device=CPU)
        self.rays_cast = 0
        self._counting = Lock()
        # Embree reads this buffer in place, and 16 bytes at a time: past the last vertex by 4.
        self._buffer = torch.zeros(len(self.vertices) + 1, 3)
        self._embree = embree = library.load()
        self._device = library.new_device()
        self._scene = embree.rtcNewScene(self._device)
        self._geometry = embree.rtcNewGeometry(self._device, library.GEOMETRY_TYPE_TRIANGLE)
        weakref.finalize(self, _release, embree, self._geometry, self._scene, self._device)

        # Robust: no ray slips between two triangles that share an edge.
        embree.rtcSetSceneFlags(self._scene, library.SCENE_FLAG_ROBUST)
        for kind, item, data, count in (
            (library.BUFFER_TYPE_VERTEX, library.FORMAT_FLOAT3, self._buffer, len(self.vertices)),
            (library.BUFFER_TYPE_INDEX, library.FORMAT_UINT3, self.faces, len(self.faces)),
        ):
            embree.rtcSetSharedGeometryBuffer(self._geometry, kind, 0, item, data.data_ptr(), 0, 12, count)
        embree.rtcAttachGeometry(self._scene, self._geometry)
        self._commit()

    def _commit(self) -> None:
        """Builds the hierarchy over the vertices as they are now."""
        self._buffer[:-1] = self.vertices
        self._embree.rtcUpdateGeometryBuffer(self._geometry, library.BUFFER_TYPE_VERTEX, 0)
        self._embree.rtcCommitGeometry(self._geometry)
        self._embree.rtcCommitScene(self._scene)
        library.check(self._device, f"building a scene of {len(self.faces)} triangles")

    def update(self, vertices: Tensor) -> None:
        # Built anew, not refitted: about one microsecond a triangle, and queries stay fast however far vertices move.
        self.vertices = checked_vertices(vertices, device=CPU, count=len(self.vertices))
        self._commit()

    def intersect(self, ray: Ray) -> Hit:
        check_lanes(ray, None, CPU)
        shape, dtype = ray.o.x.shape, ray.o.x.dtype
        hit = Hit(torch.empty(shape, dtype=torch.int32), torch.empty(shape), torch.empty(shape))
        self._query(packets.closest_hit, self._embree.rtcIntersect8, ray, **hit._asdict())
        return hit if dtype == torch.float32 else self._refined(ray, hit)

    def occluded(self, ray: Ray, tmax: Tensor) -> Tensor:
        check_lanes(ray, tmax, CPU)
        hidden = torch.empty(ray.o.x.shape, dtype=torch.bool)
        self._query(packets.any_hit, self._embree.rtcOccluded8, ray, tmax=_single(tmax), hidden=hidden)
        return hidden

    def _query(self, loop, query, ray: Ray, **columns: Tensor) -> None:
        """Runs a loop of `packets` over all lanes; `columns` are the contiguous tensors that its job names."""
        columns |= zip(("ox", "oy", "oz", "dx", "dy", "dz"), map(_single, (*ray.o, *ray.d)), strict=True)
        lanes, next_lane = ray.o.x.numel(), np.zeros((), np.int64)
        job = np.zeros((), packets.JOB)
        job["query"], job["scene"] = library.address(query), self._scene
        job["lanes"], job["next_lane"] = lanes, next_lane.ctypes.data
        for name, tensor in columns.items():
            job[name] = tensor.data_ptr()
        blocks = -(-lanes // packets.BLOCK)
        team.run(loop.address, job.ctypes.data, threads=max(1, min(torch.get_num_threads(), blocks)))
        with self._counting:
            self.rays_cast += lanes

    def _refined(self, ray: Ray, hit: Hit) -> Hit:
        """The hit with u and v of the ray's line and the triangle's plane, in the ray's dtype.

        Reference: Moeller and Trumbore 1997, "Fast, Minimum Storage Ray/Triangle Intersection".
        """
        corners = self.vertices.to(ray.o.x.dtype)[self.faces[hit.prim.clamp(min=0)].long()]
        p0, p1, p2 = (Vec3.of(corners[..., corner, :]) for corner in range(3))
        e1, e2, s = p1 - p0, p2 - p0, ray.o.detach() - p0
        d = ray.d.detach()
        determinant = dot(e1, cross(d, e2))
        u, v = dot(s, cross(d, e2)) / determinant, dot(d, cross(s, e1)) / determinant
        found = (hit.prim >= 0) & (determinant != 0)
        return Hit(hit.prim, torch.where(found, u, hit.u.to(u.dtype)), torch.where(found, v, hit.v.to(v.dtype)))

    def __reduce__(self):
        return Embree, (self.vertices, self.faces)


def _single(lanes: Tensor) -> Tensor:
    """The lanes as Embree reads them, contiguous float32; a copy only if they are not."""
    return lanes.detach().to(torch.float32).contiguous()


def _release(embree, geometry: int, scene: int, device: int) -> None:
    embree.rtcReleaseGeometry(geometry)
    embree.rtcReleaseScene(scene)
    embree.rtcReleaseDevice(device)
