"""Ray casting on the CPU by Embree 4, called in packets from compiled loops on as many threads as torch has.

Of the `embreex` wheel only the shared library is used (`library.py`). Lanes go to it through the loops of `queries.py`, in
the packets of `packets.py`, on the threads of `threads/team.py`.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Hashable, Iterable, Sequence
from threading import Lock

import torch
from torch import Tensor

from torch_radbp.interface.balls import Balls
from torch_radbp.interface.instances import Instances
from torch_radbp.jit.cpu.machine import MachineCode, cached_code
from torch_radbp.jit.recording.recording import recording
from torch_radbp.raycast import every_ball, library, packets, queries
from torch_radbp.raycast.ball import ball_tables, other_triangles
from torch_radbp.raycast.mesh import check_lanes, checked_faces, checked_vertices, columns_of
from torch_radbp.raycast.protocol import Hit, Ray
from torch_radbp.raycast.refined import refined
from torch_radbp.raycast.tree import Device, GroupTree, Tree, TreeGeometry, groups_of
from torch_radbp.raycast.vectors import Vectors
from torch_radbp.threads.made_once import made_once
from torch_radbp.threads.team import run_lanes

CPU = torch.device("cpu")
ANSWERS = (torch.int32, torch.float32, torch.float32, torch.float32)  # what Embree writes into a `Hit`
PART = 1024  # lanes that a thread takes at a time: few enough to keep all threads busy to the end


class Embree:
    """A ray caster for tensors on the CPU, by Embree, which itself works in float32.

    For float64 rays u, v and t are computed again in float64 from the ray and the triangle found, so that the point lies
    on the ray to that accuracy; which triangle is found remains a decision in float32. Components that are not
    contiguous are copied. A copied or unpickled caster builds its own scene and counts its rays from zero.

    Geometry that moves gets a new scene each time, about one microsecond a triangle: as fast as committing the old scene
    again, and queries stay fast however far vertices move. The trees of groups are taken from the last caster as long as
    their triangles stay as they are, wherever instances show them.

    Args:
        vertices: (V, 3) float32 or float64, finite; copied.
        faces: (F, 3) integers in [0, V); copied. Triangles without area are never hit.
        balls: those among the triangles, which Embree does not see; None: none.
        instances: of groups of the triangles; None: none.
        last: a caster that this one follows.

    Raises:
        ValueError: the mesh is not as said above, or not on the CPU.
        RuntimeError: Embree is not installed, or reports an error.
    """

    def __init__(self, vertices: Tensor, faces: Tensor, balls: Balls | None = None, instances: Instances | None = None,
                 last: Embree | None = None) -> None:
        self.vertices = checked_vertices(vertices, device=CPU)
        self.faces = checked_faces(faces, len(self.vertices), device=CPU)
        self.balls, self.instances = balls, instances
        triangles = self.faces if instances is None else self.faces[:instances.first_triangle[0]]
        self._tables, numbers = [], None
        if balls is not None:
            triangles, numbers = other_triangles(triangles, balls)
        self.rays_cast = 0
        self._counting = Lock()
        embree = library.load_embree()
        self._intersect, self._occluded = library.address(embree.rtcIntersect8), library.address(embree.rtcOccluded8)
        extent = self.vertices.amax(0) - self.vertices.amin(0) if instances is None else instances.extent(self.vertices)
        self._near = (packets.NEAR * extent.max()).float()
        device = Device() if instances is None or last is None else last.device
        geometries = [TreeGeometry.of_triangles(device, self.vertices, triangles)] if len(triangles) else []
        self.groups: list[GroupTree] = []
        if instances is not None:
            self.groups = groups_of(device, self.vertices, self.faces, instances, [] if last is None else last.groups)
            places = instances.to_world.float().split(instances.counts())
            shown = [TreeGeometry.of_instances(device, group.tree, poses) for group, poses in zip(self.groups, places)]
            geometries = [*shown, *geometries]  # Embree numbers them in this order
            before = len(triangles) - instances.first_triangle[0]
            self._tables = [torch.tensor(firsts, dtype=torch.int32) for firsts in (
                [0, *(first + before for first in instances.first_triangle[:-1])],
                [1, *(first + 1 for first in instances.first_instance[:-1])])]
        if balls is not None:
            shown = torch.arange(0 if instances is None else instances.first_triangle[0], len(self.faces))
            numbers = numbers if instances is None else torch.cat([numbers, shown.to(torch.int32)])
            self._tables += [*ball_tables(balls, torch.float32), numbers]
        self.device, self._scene = device, Tree(device, geometries, len(triangles))

    def intersect(self, ray: Ray) -> Hit:
        check_lanes(ray, None, CPU)
        shape, dtype = ray.o.x.shape, ray.o.x.dtype
        answers = ANSWERS if self.instances is None else (*ANSWERS, torch.int32)
        hit = Hit(*(torch.empty(shape, dtype=answer, device=CPU) for answer in answers))
        self._run(queries.closest_hit_of_packets, self._intersect, [*ray.o, *ray.d], hit[:len(answers)])
        return hit if dtype == torch.float32 else refined(self.vertices, self.faces, ray, hit, self.instances)

    def occluded(self, ray: Ray, tmax: Tensor) -> Tensor:
        check_lanes(ray, tmax, CPU)
        hidden = torch.empty(ray.o.x.shape, dtype=torch.bool, device=CPU)
        self._run(queries.any_hit_of_packets, self._occluded, [*ray.o, *ray.d, tmax], [hidden])
        return hidden

    @property
    def recorded_as(self) -> Hashable:
        return Embree, self.balls is not None, self.instances is not None

    def reads(self, dtype: torch.dtype) -> Sequence[Tensor | int]:
        return [self._intersect, self._occluded, self._scene.handle, self._near.data_ptr(),
                *(table.data_ptr() for table in self._tables)]

    def _run(self, loop: Callable, query: int, columns: list[Tensor], answers: Iterable[Tensor]) -> None:
        """Runs one of the compiled loops, of closest hits or of occlusion, over all lanes."""
        lanes = columns[0].numel()
        columns = columns_of(columns, torch.float32)
        read = [query, self._scene.handle, self._near.data_ptr(), *(table.data_ptr() for table in self._tables)]
        code = code_of_packets(loop, self.balls is not None, self.instances is not None)
        if (listener := recording()) is not None:
            listener.cast(code.address, lanes, PART, [*columns, *read], list(answers))
            return
        inputs = array("q", [*(column.data_ptr() for column in columns), *read])
        outputs = array("q", [answer.data_ptr() for answer in answers])
        run_lanes(code.address, lanes, inputs, outputs, PART)
        self.count(lanes)

    def count(self, rays: int) -> None:
        """Adds to the number of rays cast."""
        with self._counting:
            self.rays_cast += rays

    def __reduce__(self):
        return Embree, (self.vertices, self.faces, self.balls, self.instances)


@made_once
def code_of_packets(loop: Callable, balls: bool, instances: bool = False) -> MachineCode:
    """Compiles the closest-hit or the occlusion loop over lanes, with calls of Embree for packets of rays."""
    kernel = packets.OF_INSTANCES if instances else packets.KERNEL
    return cached_code(loop(Vectors(packets.WIDTH, "float"), every_ball.beside(kernel) if balls else kernel))
