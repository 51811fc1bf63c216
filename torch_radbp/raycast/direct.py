"""Ray casting for small meshes: without a tree, batches of rays against runs of triangles, see `batches.py`."""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Hashable, Iterable, Sequence
from threading import Lock

import torch
from torch import Tensor

from torch_radbp.interface.balls import Balls
from torch_radbp.jit.cpu.machine import MachineCode, cached_code, host_width
from torch_radbp.jit.recording.recording import recording
from torch_radbp.raycast import ball, batches, runs
from torch_radbp.raycast.ball import other_triangles
from torch_radbp.raycast.faces import faces_of
from torch_radbp.raycast.mesh import check_lanes, checked_faces, checked_vertices, columns_of
from torch_radbp.raycast.protocol import Hit, Ray
from torch_radbp.raycast.refined import refined
from torch_radbp.raycast.runs import MOST_TRIANGLES
from torch_radbp.raycast.vectors import Vectors
from torch_radbp.threads.made_once import made_once
from torch_radbp.threads.team import PART, run_lanes

CPU = torch.device("cpu")


class DirectCaster:
    """A ray caster without a tree, for small meshes on the CPU, in the dtype of the rays.

    `cost` is that of one ray, in tests of a triangle.

    No ray slips between two triangles that share an edge, or whose corners are in the same places. A copied or unpickled
    caster counts its rays from zero.

    Args:
        vertices: (V, 3) float32 or float64, finite; copied.
        faces: (F, 3) integers in [0, V); copied; at most `MOST_TRIANGLES`, balls aside. Triangles without area are never
            hit.
        balls: those among the triangles; None: none.

    Raises:
        ValueError: the mesh is not as said above, or not on the CPU.
    """

    def __init__(self, vertices: Tensor, faces: Tensor, balls: Balls | None = None) -> None:
        self.vertices = checked_vertices(vertices, device=CPU)
        self.faces = checked_faces(faces, len(self.vertices), device=CPU)
        self.balls = balls
        self._others, self._numbers = (self.faces, None) if balls is None else other_triangles(self.faces, balls)
        if len(self._others) > MOST_TRIANGLES:
            raise ValueError(f"the ray caster 'direct' takes at most {MOST_TRIANGLES} triangles, got {len(self._others)}; "
                             "use 'embree'")
        self._faces = faces_of(self.vertices[self._others.long()])
        divisions = runs.divisions(self._faces, (runs.OF_RAYS, runs.OF_SEGMENTS))
        self.cost = divisions[0][1]
        self._runs = {loop: torch.tensor(firsts[:-1], device=CPU)
                      for loop, (firsts, _) in zip((batches.closest_hit_of_batches, batches.any_hit_of_batches), divisions)}
        self.rays_cast = 0
        self._counting = Lock()
        # By the dtype of rays and the loop, made when they are first needed.
        self._meshes: dict[tuple[torch.dtype, Callable], tuple[Tensor, ...]] = {}

    def intersect(self, ray: Ray) -> Hit:
        check_lanes(ray, None, CPU)
        shape, dtype = ray.o.x.shape, ray.o.x.dtype
        hit = Hit(torch.empty(shape, dtype=torch.int32, device=CPU),
                  *(torch.empty(shape, dtype=dtype, device=CPU) for _ in range(3)))
        self._run(batches.closest_hit_of_batches, [*ray.o, *ray.d], hit[:4])
        # The vertices of a ball are on the sphere only up to the rounding of float32, in which a scene may have been loaded.
        exact = self.balls is None or dtype == torch.float32
        return hit if exact else refined(self.vertices, self.faces, ray, hit)

    def occluded(self, ray: Ray, tmax: Tensor) -> Tensor:
        check_lanes(ray, tmax, CPU)
        hidden = torch.empty(ray.o.x.shape, dtype=torch.bool, device=CPU)
        self._run(batches.any_hit_of_batches, [*ray.o, *ray.d, tmax], [hidden])
        return hidden

    def _run(self, loop: Callable, columns: list[Tensor], answers: Iterable[Tensor]) -> None:
        """Runs the compiled closest-hit or occlusion loop over all lanes."""
        dtype, lanes = columns[0].dtype, columns[0].numel()
        inputs = [*columns_of(columns, dtype), *self.tables(dtype, loop)]
        body = code_of_batches(loop, dtype, self.balls is not None).address
        if (listener := recording()) is not None:
            listener.cast(body, lanes, PART, inputs, list(answers))
            return
        run_lanes(body, lanes, tensor_addresses(inputs), tensor_addresses(answers))
        self.count(lanes)

    def count(self, rays: int) -> None:
        """Adds to the number of rays cast."""
        with self._counting:
            self.rays_cast += rays

    @property
    def recorded_as(self) -> Hashable:
        return DirectCaster, self.balls is not None

    def reads(self, dtype: torch.dtype) -> Sequence[Tensor | int]:
        return [*self.tables(dtype, batches.closest_hit_of_batches), *self.tables(dtype, batches.any_hit_of_batches)]

    def tables(self, dtype: torch.dtype, loop: Callable) -> tuple[Tensor, ...]:
        """The tables of the mesh that the closest-hit or the occlusion loop reads, for rays of a dtype."""
        if (dtype, loop) not in self._meshes:
            p = self.vertices.to(dtype)[self._others.long()]
            faces = self._faces._replace(points=self._faces.points.to(dtype))
            placements, of_balls = (None, ()) if self.balls is None else (self.balls.placement, (
                *ball.ball_tables(self.balls, dtype), self._numbers))
            made = *runs.triangle_runs(p, faces, self._runs[loop], unit_of(p.flatten(0, 1)), placements), *of_balls
            self._meshes.setdefault((dtype, loop), made)  # those of the first thread serve all
        return self._meshes[dtype, loop]

    def __reduce__(self):
        return DirectCaster, (self.vertices, self.faces, self.balls)


@made_once
def code_of_batches(loop: Callable, dtype: torch.dtype, balls: bool = False, width: int | None = None) -> MachineCode:
    """Compiles the closest-hit or the occlusion loop over batches of rays, for a dtype and a vector width.

    None: the processor's own width.
    """
    width = width or host_width() * torch.float32.itemsize // dtype.itemsize
    code = Vectors(width, "float" if dtype == torch.float32 else "double")
    return cached_code(loop(code, balls))


def unit_of(vertices: Tensor) -> Tensor:
    """() the power of two that scales coordinates to about the extent of the mesh.

    Products of three coordinates then neither overflow nor underflow, and nothing is rounded.
    """
    extent = float((vertices.amax(0) - vertices.amin(0)).max())
    exponent = math.frexp(extent)[1] if extent > 0 else 0
    return vertices.new_tensor(2.0 ** max(-120, min(120, -exponent)))


def tensor_addresses(tensors: Iterable[Tensor]) -> array:
    return array("q", [tensor.data_ptr() for tensor in tensors])
