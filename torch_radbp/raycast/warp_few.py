"""Warp's kernels for few faces: each ray tries all of them, without a tree.

All threads read the same numbers at the same time, which takes a GPU one access for 32 of them; none keeps a stack, and
none waits for others that are deeper in a tree. Two triangles that make up a parallelogram are one face. A face is a plane
and two coordinates on it, s and r, which are 0 and 1 at its edges: 15 numbers, computed in float64 and rounded. Faces are
taken for a few roundings larger than they are, so that no ray passes between two that share an edge; on which triangle a hit
is, and where on it, is told once for each ray, of the closest.

Reference: Havel and Herout 2010, "Yet faster ray-triangle intersection (using SSE4)" (planes in the place of edges).
"""

from typing import NamedTuple

import torch
import warp as wp
from torch import Tensor

from torch_radbp.raycast.faces import faces_of
from torch_radbp.raycast.mesh import MOST_FETCHED
from torch_radbp.raycast.warp_rays import FARTHEST, is_beyond, query_of

wp.set_module_options({"enable_backward": False})
FEW = MOST_FETCHED // 2  # faces at most, of which each ray tries all; how many would be best was not measured on a card
ROUNDINGS = 16  # units in the last place of numbers as large as the mesh, by which faces are larger


class FewFaces(NamedTuple):
    """P faces of a mesh, relative to its middle, in the units of its rays."""

    middle: tuple[float, float, float]
    planes: Tensor  # (4 P, 4) float32: the plane, s, r; the least of s and r, the greatest, and the greatest sum
    prims: Tensor  # (2 P,) int32, the triangle where s is at least r, and the other
    places: Tensor  # (2 F, 4) float32: barycentric u and v of points in the plane of each triangle


def few_faces(corners: Tensor, device: torch.device) -> FewFaces | None:
    """The planes and coordinates of triangles' faces, on a device; None if a ray should not test so many one by one.

    Args:
        corners: (F, 3, 3) float32, of the host, which would wait for the device a dozen times otherwise.
        device: of the rays.
    """
    faces = faces_of(corners)
    if len(faces.prims) > FEW:
        return None
    middle = (corners.amax((0, 1)) + corners.amin((0, 1))) / 2
    around = faces.points.double()[faces.corners] - middle.double()  # (P, 4, 3)
    ends = torch.where(faces.parallelogram[:, None], around[:, 3], around[:, 2])
    plane, s, r = coordinates_on(around[:, 0], around[:, 1], ends)
    extent = around.abs().amax()
    below = ROUNDINGS * torch.finfo(torch.float32).eps * extent * torch.maximum(s[:, :3].norm(dim=1), r[:, :3].norm(dim=1))
    most = torch.where(faces.parallelogram, 3.0, 1.0 + below)
    limits = torch.stack([-below, 1.0 + below, most, torch.zeros_like(most)], 1)
    own = corners.double() - middle.double()
    _, u, v = coordinates_on(*own.unbind(1))
    tables = (torch.stack([plane, s, r, limits], 1).float().flatten(0, 1), faces.prims.flatten(),
              torch.stack([u, v], 1).float().flatten(0, 1))
    return FewFaces(tuple(middle.tolist()), *(table.contiguous().to(device) for table in tables))


def coordinates_on(origin: Tensor, first: Tensor, second: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The planes of triangles, and two coordinates on each, (N, 4) each: factors of x, y, z and 1.

    The coordinates are 0 at `origin`, and 1 at `first` and `second`. Of triangles without area all is 0, so that no ray
    crosses their plane.
    """
    a, b = first - origin, second - origin
    normal = torch.linalg.cross(a, b)
    squared = normal.square().sum(1, keepdim=True)
    scale = torch.where(squared > 0, 1.0 / squared, 0.0)
    found = []
    for along in (normal * scale.sqrt(), torch.linalg.cross(b, normal) * scale, torch.linalg.cross(normal, a) * scale):
        found.append(torch.cat([along, -(along * origin).sum(1, keepdim=True)], 1))
    return tuple(found)


# Four numbers by one access, of which Warp would make four.
FOUR = """
#if defined(__CUDA_ARCH__)
    const float4 four = __ldg(reinterpret_cast<const float4*>(rows.data) + place);
    return wp::vec_t<4, wp::float32>(four.x, four.y, four.z, four.w);
#else
    return rows.data[place];
#endif
"""


@wp.func_native(FOUR)
def four_of(rows: wp.array(dtype=wp.vec4), place: int) -> wp.vec4:  # type: ignore[empty-body]
    """A row of a table that begins at a multiple of 16 bytes."""
    ...


@wp.struct
class FaceCrossing:
    """The crossing of a ray with a face: its t, and the triangle of the face."""

    t: float  # 0: it does not
    second: wp.bool  # on its second triangle


@wp.func
def height(plane: wp.vec4, p: wp.vec3) -> float:
    """The height of a point above a plane, or its coordinate along an axis of a face, by the four numbers `plane`."""
    return plane[0] * p[0] + plane[1] * p[1] + plane[2] * p[2] + plane[3]


@wp.func
def rise(plane: wp.vec4, d: wp.vec3) -> float:
    """The change, along a direction, of the height above a plane, or of the coordinate, that `height` gives."""
    return plane[0] * d[0] + plane[1] * d[1] + plane[2] * d[2]


@wp.func
def crossing_of(planes: wp.array(dtype=wp.vec4), k: int, o: wp.vec3, d: wp.vec3) -> FaceCrossing:
    """The crossing of a ray with face `k` at t > 0, if any; none for rays within its plane, or of NaN."""
    plane, limits = four_of(planes, 4 * k), four_of(planes, 4 * k + 3)
    crossing = FaceCrossing()
    t = -height(plane, o) / rise(plane, d)
    p = o + t * d
    s, r = height(four_of(planes, 4 * k + 1), p), height(four_of(planes, 4 * k + 2), p)
    inside = wp.min(s, r) >= limits[0] and wp.max(s, r) <= limits[1] and s + r <= limits[2]
    crossing.t = wp.where(inside and t > 0.0 and t < FARTHEST, t, 0.0)
    crossing.second = r > s
    return crossing


@wp.kernel
def closest_of_few(planes: wp.array(dtype=wp.vec4), prims: wp.array(dtype=int), places: wp.array(dtype=wp.vec4), faces: int,
                   middle: wp.vec3, unit: float, last: wp.array(dtype=wp.int64), rays: wp.array(dtype=wp.int64),
                   ox: wp.array(dtype=float), oy: wp.array(dtype=float), oz: wp.array(dtype=float),
                   dx: wp.array(dtype=float), dy: wp.array(dtype=float), dz: wp.array(dtype=float),
                   prim: wp.array(dtype=int), u: wp.array(dtype=float), v: wp.array(dtype=float), t: wp.array(dtype=float)):
    """The GPU kernel that finds the closest hits of rays among few faces, one thread per ray; of equally far faces the
    first counts."""
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
    o = query.o - middle
    face, end, second = int(-1), float(FARTHEST), bool(False)  # noqa: UP018 (variables of Warp's, not constants)
    for k in range(faces):
        crossing = crossing_of(planes, k, o, query.d)
        if crossing.t > 0.0 and crossing.t < end:
            face = k
            end = crossing.t
            second = crossing.second
    if face >= 0:
        found = prims[2 * face + wp.where(second, 1, 0)]
        p = o + end * query.d
        across = wp.clamp(height(places[2 * found], p), 0.0, 1.0)
        prim[lane] = found
        u[lane] = across
        v[lane] = wp.clamp(height(places[2 * found + 1], p), 0.0, 1.0 - across)
        t[lane] = end / query.per_t


@wp.kernel
def any_of_few(planes: wp.array(dtype=wp.vec4), prims: wp.array(dtype=int), places: wp.array(dtype=wp.vec4), faces: int,
               middle: wp.vec3, unit: float, last: wp.array(dtype=wp.int64), rays: wp.array(dtype=wp.int64),
               ox: wp.array(dtype=float), oy: wp.array(dtype=float), oz: wp.array(dtype=float),
               dx: wp.array(dtype=float), dy: wp.array(dtype=float), dz: wp.array(dtype=float), tmax: wp.array(dtype=float),
               hidden: wp.array(dtype=wp.bool)):
    """The GPU kernel that tells whether one of few faces occludes a segment, one thread per ray."""
    lane = wp.tid()
    if is_beyond(lane, last, rays):
        return
    hidden[lane] = False
    query = query_of(unit, ox[lane], oy[lane], oz[lane], dx[lane], dy[lane], dz[lane])
    if not query.valid or not tmax[lane] > 0.0:
        return
    o, end = query.o - middle, tmax[lane] * query.per_t
    for k in range(faces):
        crossing = crossing_of(planes, k, o, query.d)
        if crossing.t > 0.0 and crossing.t < end:
            hidden[lane] = True
            return
