"""Ray casting by NVIDIA Warp's tree of triangles, on CUDA devices; Warp's CPU device, one thread of it, serves the tests.

Where faces are few each ray tries all of them instead (`warp_few.py`); groups of shapes that instances show may have trees
of their own under a tree over the instances (`warp_instances.py`). Kernels run on torch's current stream and read and write
torch's tensors where they lie. Warp's rule for a ray and a triangle is watertight (Woop, Benthin and Wald 2013,
"Watertight ray/triangle intersection"), its rule for a ray and a box is not: by the rounding of divisions, a ray towards an
edge may pass by the boxes of both triangles there (of 200,000 rays towards edges of a cube from inside, 853 got out). So the
tree is built of triangles that are a little larger, see `widened`, and what rays meet are the true ones.
"""

import weakref
from collections.abc import Hashable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from itertools import repeat
from struct import pack
from threading import Lock
from types import ModuleType

import torch
from torch import Tensor

from torch_radbp.interface.balls import Balls
from torch_radbp.interface.instances import Instances
from torch_radbp.jit.nvidia.launches import RayQuery
from torch_radbp.jit.recording.recording import recording
from torch_radbp.raycast.mesh import MeshExtremes, check_lanes, checked_faces, checked_vertices
from torch_radbp.raycast.protocol import Hit, Ray
from torch_radbp.raycast.refined import refined
from torch_radbp.tensors.asked_later import answered
from torch_radbp.threads.made_once import made_once

try:
    import warp as wp

    from torch_radbp.raycast.warp_rays import FARTHEST, is_beyond, query_of
    from torch_radbp.raycast.warp_tree import in_units, lanes_of, power_of_2_units, triangle_tree
except ModuleNotFoundError as error:
    raise ModuleNotFoundError("the ray caster 'warp' needs NVIDIA Warp: pip install 'warp-lang>=1.19'",
                              name="warp") from error

DEVICES = ("cuda", "cpu")
ANSWERS = (torch.int32, torch.float32, torch.float32, torch.float32)  # what the kernel writes into a `Hit`


class Warp:
    """A ray caster for tensors on CUDA, or on the CPU, by Warp, which itself works in float32.

    For float64 rays u, v and t are computed again in float64 from the ray and the triangle found. Geometry that moves gets a
    new tree, as with the other casters, so that graphs keep the old one; the trees of groups are taken from the last caster
    as long as their triangles stay as they are, wherever instances show them. As with Embree, a ray that starts exactly in a
    triangle may meet it at t = 0.

    Args:
        vertices: (V, 3) float32 or float64, finite; copied.
        faces: (F, 3) integers in [0, V); copied. Triangles without area are never hit.
        balls: those among the triangles, which are nothing special here.
        known: the extremes of the mesh; None: the device is asked for them.
        instances: of groups of the triangles; None: none.
        last: a caster that this one follows.

    Raises:
        ValueError: the mesh is not as said above, or on a device that Warp does not know.
    """

    def __init__(self, vertices: Tensor, faces: Tensor, balls: Balls | None = None,
                 known: MeshExtremes | None = None, instances: Instances | None = None, last: "Warp | None" = None) -> None:
        if vertices.device.type not in DEVICES:
            raise ValueError(f"the ray caster 'warp' works on CUDA and on the CPU, got vertices on {vertices.device}; "
                             "move the scene, or use 'brute'")
        if known is None:
            asked = MeshExtremes.asked_of(vertices, faces, instances)
            known = MeshExtremes.of(answered(asked)) if asked else None
        self.vertices = checked_vertices(vertices, None, known and known.finite)
        self.faces = checked_faces(faces, len(self.vertices), self.vertices.device, known and known.indices)
        self.balls, self.instances = balls, instances
        self._rays, self._counting = 0, Lock()
        self._rays_counted = torch.zeros(1, dtype=torch.int64, device=self.vertices.device)  # of which only the device knows
        self._device = _started(self.vertices.device)
        self._streams: set[torch.cuda.Stream] = set()
        self._unit = 1.0 if known is None else power_of_2_units(known.extent)
        self.groups: list = []
        few = None
        if instances is None and known is not None and known.corners:
            fetched = torch.tensor(known.corners, dtype=torch.float32, device=torch.device("cpu")).view(-1, 3, 3)
            few = loaded("warp_few", self.vertices.device).few_faces(in_units(fetched, self._unit), self.vertices.device)
        self._geometry: object
        if few is not None:
            kernels = loaded("warp_few", self.vertices.device)
            self._closest, self._any = kernels.closest_of_few, kernels.any_of_few
            self._geometry = few
            tables = (few.planes, wp.vec4), (few.prims, wp.int32), (few.places, wp.vec4)
            self._head = [*(wp.from_torch(table, dtype=kind, return_ctype=True) for table, kind in tables),
                          len(few.prims) // 2, wp.vec3(*few.middle)]
        elif instances is None:
            tree = triangle_tree(in_units(self.vertices.float()[self.faces.long()], self._unit), self._stream())
            self._geometry, self._head = tree, [tree.id]
            self._closest, self._any = tree_kernels(self.vertices.device)
        else:
            kernels = loaded("warp_instances", self.vertices.device)
            self._closest, self._any = kernels.closest_of_groups, kernels.any_of_groups
            groups = kernels.group_meshes(self.vertices, self.faces, instances, [] if last is None else last.groups,
                                          known is not None and known.unmoved, self._stream())
            self._geometry = shown = kernels.shown_groups(groups, instances, self._unit)
            self.groups, self._head = shown.groups, shown.head()
        self._given = b"".join(map(argument_bytes, [*self._head, self._unit, lanes_of(self._rays_counted)]))
        weakref.finalize(self, release, self._geometry, self._streams).atexit = False

    def intersect(self, ray: Ray) -> Hit:
        check_lanes(ray, None, self.vertices.device)
        shape, dtype = ray.o.x.shape, ray.o.x.dtype
        answers = ANSWERS if self.instances is None else (*ANSWERS, torch.int32)
        hit = Hit(*(self.vertices.new_empty(shape, dtype=answer) for answer in answers))
        self._launch(self._closest, [*ray.o, *ray.d], hit[:len(answers)])
        return hit if dtype == torch.float32 else refined(self.vertices, self.faces, ray, hit, self.instances)

    def occluded(self, ray: Ray, tmax: Tensor) -> Tensor:
        check_lanes(ray, tmax, self.vertices.device)
        hidden = self.vertices.new_empty(ray.o.x.shape, dtype=torch.bool)
        self._launch(self._any, [*ray.o, *ray.d, tmax], [hidden])
        return hidden

    def _launch(self, kernel: wp.Kernel, columns: list[Tensor], answers: Iterable[Tensor]) -> None:
        """Launches a kernel over all lanes, on torch's current stream, without waiting for it."""
        lanes = columns[0].numel()
        columns = [column.detach().to(torch.float32).reshape(-1) for column in columns]
        if (listener := recording()) is not None:
            listener.cast(RayQuery(kernel), lanes, lanes, columns, list(answers))
            return
        if lanes:
            self._start(kernel, lanes, None, [*map(lanes_of, columns), *(lanes_of(answer.view(-1)) for answer in answers)])
        self.count(lanes)

    def count(self, rays: int) -> None:
        """Counts rays that are cast."""
        with self._counting:
            self._rays += rays

    def launch(self, kernel: wp.Kernel, lanes: int, last: int, *addresses: int) -> None:
        """Casts a ray for each lane on the device, without waiting; args as of `jit.nvidia.launches.Caster.launch`."""
        kinds = [argument.type.dtype for argument in kernel.adj.args[-len(addresses):]]
        self._start(kernel, lanes, self._memory(last, wp.int64, 1), list(map(self._memory, addresses, kinds, repeat(lanes))))

    def given(self) -> bytes:
        """The bytes that `launch` hands to kernels beside its own arguments; the current stream counts as a reader now."""
        if not self._device.is_cpu:
            self._used()
        return self._given

    def _memory(self, address: int, kind: type, entries: int):
        """Warp's array over memory at an address, with so many entries of a type."""
        found = lanes_of(self._rays_counted)
        found.data, found.shape[0], found.strides[0] = address, entries, wp.types.type_size_in_bytes(kind)
        return found

    def _start(self, kernel: wp.Kernel, lanes: int, last, columns: list) -> None:
        """Launches a kernel, and does not wait for it; `last`: None if all lanes are meant."""
        wp.launch(kernel, lanes, [*self._head, self._unit, last, lanes_of(self._rays_counted), *columns],
                  device=self._device, stream=self._stream(), record_tape=False)

    @property
    def recorded_as(self) -> Hashable:
        return Warp, self.balls is not None, self._closest.key

    def reads(self, dtype: torch.dtype) -> Sequence[Tensor | int]:
        """Empty: recorded launches get the addresses of the tree when they are played."""
        return ()

    @property
    def rays_cast(self) -> int:
        """The number of rays cast so far; waits for the device, which alone knows some."""
        return self._rays + int(self._rays_counted)

    def _stream(self):
        """torch's current CUDA stream as Warp's object; None on the CPU."""
        return None if self._device.is_cpu else wp.stream_from_torch(self._used())

    def _used(self) -> torch.cuda.Stream:
        """torch's current CUDA stream, noted as one that reads the triangles, unless a CUDA graph is being captured."""
        current = torch.cuda.current_stream(self.vertices.device)
        if current != torch.cuda.default_stream(self.vertices.device) and not torch.cuda.is_current_stream_capturing():
            self._streams.add(current)
        return current

    def __reduce__(self):
        return Warp, (self.vertices, self.faces, self.balls, None, self.instances)


# -- Warp's devices and streams -----------------------------------------------------------------------------------------


@made_once
def _started(device: torch.device):
    """Warp's device for a torch device."""
    with silent():
        wp.init()
        return wp.device_from_torch(device)


@contextmanager
def silent() -> Iterator[None]:
    """A context in which Warp prints no messages about devices and compilation."""
    level, wp.config.log_level = wp.config.log_level, max(wp.config.log_level, wp.LOG_ERROR)
    try:
        yield
    finally:
        wp.config.log_level = level


@made_once
def tree_kernels(device: torch.device) -> tuple[wp.Kernel, wp.Kernel]:
    """Warp's kernels for closest hits and for any hit by a tree; compiled the first time, and kept on disk by Warp."""
    with silent():
        wp.load_module(__name__, device=wp.device_from_torch(device))
    return closest_hit, any_hit


@made_once
def loaded(name: str, device: torch.device) -> ModuleType:
    """The module of this folder that is called `name`, with its kernels loaded."""
    module = import_module(f"{__package__}.{name}")  # not before: Warp compiles it
    with silent():
        wp.load_module(module.__name__, device=wp.device_from_torch(device))
    return module


def argument_bytes(argument) -> bytes:
    """What kernels are given of an argument: a number, or a vector or a description of memory by Warp."""
    if isinstance(argument, (int, float)):
        return pack("Q" if isinstance(argument, int) else "d", argument)
    return memoryview(argument).tobytes()


def release(geometry: object, streams: set[torch.cuda.Stream]) -> None:
    """Waits until queries on other streams no longer read the triangles, so that their memory may be freed."""
    for stream in streams:
        stream.synchronize()


# -- Kernels ------------------------------------------------------------------------------------------------------------


@wp.kernel(enable_backward=False)
def closest_hit(mesh: wp.uint64, unit: float, last: wp.array(dtype=wp.int64), rays: wp.array(dtype=wp.int64),
                ox: wp.array(dtype=float), oy: wp.array(dtype=float), oz: wp.array(dtype=float),
                dx: wp.array(dtype=float), dy: wp.array(dtype=float), dz: wp.array(dtype=float),
                prim: wp.array(dtype=int), u: wp.array(dtype=float), v: wp.array(dtype=float), t: wp.array(dtype=float)):
    """The GPU kernel that finds the closest hits of rays by a tree of triangles, one thread per ray."""
    lane = wp.tid()
    if is_beyond(lane, last, rays):
        return
    prim[lane] = -1
    u[lane] = 0.0
    v[lane] = 0.0
    t[lane] = 0.0
    query = query_of(unit, ox[lane], oy[lane], oz[lane], dx[lane], dy[lane], dz[lane])
    if not query.valid:
        return
    hit = wp.mesh_query_ray(mesh, query.o, query.d, FARTHEST)
    if hit.result:
        prim[lane] = hit.face
        u[lane] = hit.v  # Warp's u and v are the weights of the first and the second vertex
        v[lane] = wp.max(1.0 - hit.u - hit.v, 0.0)
        t[lane] = hit.t / query.per_t


@wp.kernel(enable_backward=False)
def any_hit(mesh: wp.uint64, unit: float, last: wp.array(dtype=wp.int64), rays: wp.array(dtype=wp.int64),
            ox: wp.array(dtype=float), oy: wp.array(dtype=float), oz: wp.array(dtype=float),
            dx: wp.array(dtype=float), dy: wp.array(dtype=float), dz: wp.array(dtype=float), tmax: wp.array(dtype=float),
            hidden: wp.array(dtype=wp.bool)):
    """The GPU kernel that tells by a tree of triangles whether segments are occluded, one thread per ray."""
    lane = wp.tid()
    if is_beyond(lane, last, rays):
        return
    hidden[lane] = False
    query = query_of(unit, ox[lane], oy[lane], oz[lane], dx[lane], dy[lane], dz[lane])
    if query.valid and tmax[lane] > 0.0:
        hidden[lane] = wp.mesh_query_ray_anyhit(mesh, query.o, query.d, wp.min(tmax[lane] * query.per_t, FARTHEST))
