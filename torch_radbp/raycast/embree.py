"""Ray casting on the CPU by Embree 4, called in packets from compiled loops on torch's own threads.

Of the `embreex` wheel only the shared library is used (`library.py`). Lanes go to it through the loops of `queries.py`, in
the packets of `packets.py`, on the threads of `jit/team.py`.
"""

from __future__ import annotations

import weakref
from array import array
from collections.abc import Callable, Iterable
from threading import Lock

import torch
from torch import Tensor

from torch_radbp.jit.machine import MachineCode, made_once
from torch_radbp.jit.team import run_lanes
from torch_radbp.raycast import every_ball, library, packets, queries
from torch_radbp.raycast.ball import other_triangles, tables
from torch_radbp.raycast.mesh import check_lanes, checked_faces, checked_vertices, columns_of
from torch_radbp.raycast.protocol import Hit, Ray
from torch_radbp.raycast.refined import refined
from torch_radbp.raycast.vectors import Vectors
from torch_radbp.shape.ball import Balls

CPU = torch.device("cpu")
ANSWERS = (torch.int32, torch.float32, torch.float32, torch.float32)  # what Embree writes into a `Hit`
PART = 1024  # lanes that a thread takes at a time: few enough to keep all threads busy to the end


class Embree:
    """A `RayCaster` for tensors on the CPU; Embree itself works in float32.

    For float64 rays u, v and t are computed again in float64 from the ray and the triangle found, so that the point lies
    on the ray to that accuracy; which triangle is found remains a decision in float32. Components that are not
    contiguous are copied. A copied or unpickled caster builds its own scene and counts its rays from zero.

    Geometry that moves gets a new scene each time, about one microsecond a triangle: as fast as committing the old scene
    again, and queries stay fast however far vertices move.

    Args:
        vertices: (V, 3) float32 or float64, finite; copied.
        faces: (F, 3) integers in [0, V); copied. Triangles without area are never hit.
        balls: those among the triangles, which Embree does not see; None: none.

    Raises:
        ValueError: the mesh is not as said above, or not on the CPU.
        RuntimeError: Embree is not installed, or reports an error.
    """

    def __init__(self, vertices: Tensor, faces: Tensor, balls: Balls | None = None) -> None:
        self.vertices = checked_vertices(vertices, device=CPU)
        self.faces = checked_faces(faces, len(self.vertices), device=CPU)
        self.balls = balls
        self._others, self._tables = self.faces, []
        if balls is not None:
            self._others, numbers = other_triangles(self.faces, balls)
            self._tables = [*tables(balls, torch.float32), numbers]
        self.rays_cast = 0
        self._counting = Lock()
        # Embree reads this buffer in place, and 16 bytes at a time: past the last vertex by 4.
        self._buffer = torch.zeros(len(self.vertices) + 1, 3, dtype=torch.float32, device=CPU)
        self._buffer[:-1] = self.vertices
        extent = self._buffer[:-1].amax(dim=0) - self._buffer[:-1].amin(dim=0)
        self._near = packets.NEAR * extent.max()
        embree = library.load()
        self._intersect, self._occluded = library.address(embree.rtcIntersect8), library.address(embree.rtcOccluded8)
        self._device = library.new_device()
        self._scene = embree.rtcNewScene(self._device)
        self._geometry = embree.rtcNewGeometry(self._device, library.GEOMETRY_TYPE_TRIANGLE)
        weakref.finalize(self, _release, embree, self._geometry, self._scene, self._device)

        # Robust: no ray slips between two triangles that share an edge.
        embree.rtcSetSceneFlags(self._scene, library.SCENE_FLAG_ROBUST)
        for kind, item, data, count in (
            (library.BUFFER_TYPE_VERTEX, library.FORMAT_FLOAT3, self._buffer, len(self.vertices)),
            (library.BUFFER_TYPE_INDEX, library.FORMAT_UINT3, self._others, len(self._others)),
        ):
            embree.rtcSetSharedGeometryBuffer(self._geometry, kind, 0, item, data.data_ptr(), 0, 12, count)
        embree.rtcAttachGeometry(self._scene, self._geometry)
        embree.rtcCommitGeometry(self._geometry)
        embree.rtcCommitScene(self._scene)
        library.check(self._device, f"building a scene of {len(self._others)} triangles")

    def intersect(self, ray: Ray) -> Hit:
        check_lanes(ray, None, CPU)
        shape, dtype = ray.o.x.shape, ray.o.x.dtype
        hit = Hit(*(torch.empty(shape, dtype=answer, device=CPU) for answer in ANSWERS))
        self._run(queries.closest_hit, self._intersect, [*ray.o, *ray.d], hit)
        return hit if dtype == torch.float32 else refined(self.vertices, self.faces, ray, hit)

    def occluded(self, ray: Ray, tmax: Tensor) -> Tensor:
        check_lanes(ray, tmax, CPU)
        hidden = torch.empty(ray.o.x.shape, dtype=torch.bool, device=CPU)
        self._run(queries.any_hit, self._occluded, [*ray.o, *ray.d, tmax], [hidden])
        return hidden

    def _run(self, loop: Callable, query: int, columns: list[Tensor], answers: Iterable[Tensor]) -> None:
        """Runs a loop of `queries` over all lanes."""
        lanes = columns[0].numel()
        columns = columns_of(columns, torch.float32)
        inputs = array("q", [*(column.data_ptr() for column in columns), query, self._scene, self._near.data_ptr(),
                             *(table.data_ptr() for table in self._tables)])
        outputs = array("q", [answer.data_ptr() for answer in answers])
        run_lanes(machine_code(loop, self.balls is not None).address, lanes, inputs, outputs, PART)
        with self._counting:
            self.rays_cast += lanes

    def __reduce__(self):
        return Embree, (self.vertices, self.faces, self.balls)


@made_once
def machine_code(loop: Callable, balls: bool) -> MachineCode:
    """A loop of `queries` over packets."""
    return MachineCode(loop(Vectors(packets.WIDTH, "float"),
                            every_ball.beside(packets.KERNEL) if balls else packets.KERNEL))


def _release(embree, geometry: int, scene: int, device: int) -> None:
    embree.rtcReleaseGeometry(geometry)
    embree.rtcReleaseScene(scene)
    embree.rtcReleaseDevice(device)
