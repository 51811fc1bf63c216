"""Ray casting by testing every triangle, in plain torch: the reference of the tests, and enough for tiny scenes."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_radbp.interface.balls import Balls
from torch_radbp.raycast.mesh import check_lanes, checked_faces, checked_vertices
from torch_radbp.raycast.protocol import Hit, Ray
from torch_radbp.tensors.vec import Vec3, cross, dot

# Bytes of one (lanes, triangles) tensor; about twenty of them are alive at a time.
TABLE_BYTES = 4 << 20


class Brute:
    """A ray caster for any device, which tests every triangle in float64. Time grows with lanes times triangles; memory does
    not.

    An edge that two triangles share gives both the same edge function with opposite sign, to the last bit, so no ray
    slips between them (Davidovic et al. 2012, "3D rasterization: a bridge between rasterization and ray casting").

    Args:
        vertices: (V, 3) float32 or float64, finite; copied.
        faces: (F, 3) integers in [0, V); copied. Triangles without area are never hit.
        balls: those among the triangles, which are nothing special here.

    Raises:
        ValueError: the mesh is not as said above.
    """

    def __init__(self, vertices: Tensor, faces: Tensor, balls: Balls | None = None) -> None:
        self.vertices = checked_vertices(vertices)
        self.faces = checked_faces(faces, len(self.vertices), device=self.vertices.device)
        self.balls = balls
        self.rays_cast = 0

    @property
    def recorded_as(self) -> None:
        """None: queries are plain torch, and are not recorded."""

    def intersect(self, ray: Ray) -> Hit:
        check_lanes(ray, None, self.vertices.device)
        chunks = [self._closest(chunk) for chunk, _ in self._chunks(ray)]
        self.rays_cast += ray.o.x.numel()
        return Hit(*(torch.cat(column).view(ray.o.x.shape) for column in list(zip(*chunks, strict=True))[:4]))

    def occluded(self, ray: Ray, tmax: Tensor) -> Tensor:
        check_lanes(ray, tmax, self.vertices.device)
        tmax = tmax.detach().reshape(-1, 1)
        chunks = []
        for chunk, lanes in self._chunks(ray):
            t, _, _ = self._crossings(chunk)
            chunks.append(((t <= tmax[lanes]) & (t < torch.inf)).any(dim=1))
        self.rays_cast += ray.o.x.numel()
        return torch.cat(chunks).view(ray.o.x.shape)

    def _chunks(self, ray: Ray):
        """Yields chunks of the rays as (lanes, 1) columns, with the slice of lanes; one empty chunk if there are no
        lanes.
        """
        o, d = (vector.detach().map(lambda component: component.reshape(-1, 1)) for vector in ray)
        size = max(1, TABLE_BYTES // (len(self.faces) * torch.float64.itemsize))
        for start in range(0, max(1, len(o.x)), size):
            lanes = slice(start, start + size)
            yield Ray(Vec3(*(c[lanes] for c in o)), Vec3(*(c[lanes] for c in d))), lanes

    def _closest(self, ray: Ray) -> Hit:
        """The closest hit of the (lanes, 1) rays, as flat tensors."""
        t, u, v = self._crossings(ray)
        distance, prim = t.min(dim=1, keepdim=True)
        is_hit = (distance < torch.inf).squeeze(1)
        zero = torch.zeros_like(distance).squeeze(1)
        u, v, t = (torch.where(is_hit, column.gather(1, prim).squeeze(1), zero) for column in (u, v, t))
        return Hit(torch.where(is_hit, prim.squeeze(1), -1).to(torch.int32), u, v, t)

    def _crossings(self, ray: Ray) -> tuple[Tensor, Tensor, Tensor]:
        """The crossings of all rays with all triangles' planes, (lanes, F): t, infinite for a miss, and the barycentric u
        and v.
        """
        dtype, (o, d) = ray.o.x.dtype, (vector.map(torch.Tensor.double) for vector in ray)
        corners = self.vertices.double()[self.faces.long()]
        a, b, c = (Vec3.of(corners[:, corner]) - o for corner in range(3))
        # Six times the signed volumes of d with the edges: proportional to the weights of the opposite corners.
        of_a, of_b, of_c = dot(d, cross(c, b)), dot(d, cross(a, c)), dot(d, cross(b, a))
        total = of_a + of_b + of_c
        inside = (torch.minimum(torch.minimum(of_a, of_b), of_c) >= 0) | (
            torch.maximum(torch.maximum(of_a, of_b), of_c) <= 0
        )
        u, v = of_b / total, of_c / total
        t = dot(a * (of_a / total) + b * u + c * v, d) / dot(d, d)
        finite = torch.isfinite(sum((*o, *d), start=torch.zeros_like(o.x)))
        # NaN fails every comparison: triangles without area, edge on, and lanes without a direction.
        return torch.where(inside & (total != 0) & (t > 0) & finite, t, torch.inf).to(dtype), u.to(dtype), v.to(dtype)
