"""The orthographic camera."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import torch
from torch import Tensor

from torch_radbp.plugin import Film, Matrix4, Medium, Sampler, register
from torch_radbp.sensor.frustum import Frustum, Plane, doubled
from torch_radbp.sensor.kind import PointsSeen, ProjectiveCamera, ProjectiveKind
from torch_radbp.tensors.vec import Frame, Ray, Vec2, Vec3, cross, dot, normalize


class OrthographicLens(NamedTuple):
    """The pose of an orthographic camera as its functions read it."""

    x: Vec3  # () each: the columns of `to_world`
    y: Vec3
    z: Vec3
    origin: Vec3
    aspect: Tensor  # width / height of the whole image
    near: Tensor  # local z of the near plane
    depth: Tensor  # world distance from the near to the far plane


@dataclass(frozen=True)
class OrthographicKind(ProjectiveKind):
    """Orthographic cameras: parallel rays that start on a rectangle."""

    sees_points: ClassVar[bool] = True

    def sample_ray(self, lens: OrthographicLens, position: Vec2, aperture: None) -> tuple[Ray, None]:
        x, y = 1.0 - 2.0 * position.x, (1.0 - 2.0 * position.y) / lens.aspect
        corner, d = near_corner(lens), normalize(lens.z)
        o = Vec3(*(c + a * x + b * y for c, a, b in zip(corner, lens.x, lens.y)))
        return Ray(o, Vec3(*(component.expand_as(x) for component in d))), None

    def project(self, lens: OrthographicLens, p: Vec3, aperture: None) -> Vec2:
        local = Frame(lens.x, lens.y, lens.z).coordinates(p - near_corner(lens))
        return Vec2(0.5 - 0.5 * local.x, 0.5 - 0.5 * local.y * lens.aspect)

    def beyond_far_plane(self, lens: OrthographicLens, p: Vec3) -> Tensor:
        return dot(p - near_corner(lens), normalize(lens.z)) > lens.depth

    def beyond_planes(self, lens: OrthographicLens, p: Vec3) -> tuple[Tensor, Tensor]:
        ahead = dot(p - near_corner(lens), normalize(lens.z))
        return ahead, ahead - lens.depth

    def towards(self, lens: OrthographicLens, p: Vec3, aperture: None) -> Vec3:
        return Vec3(*(component.expand_as(p.x) for component in -normalize(lens.z)))

    def sight(self, lens: OrthographicLens, p: Vec3, aperture: None) -> PointsSeen:
        d, across = normalize(lens.z), cross(lens.x, lens.y)
        z = dot(p - near_corner(lens), d)
        return PointsSeen(self.project(lens, p, aperture), 0.25 * lens.aspect / dot(across, d).abs(), p - d * z,
                     (z > 0) & (z <= lens.depth))

    def eye(self, lens: OrthographicLens) -> Tensor:
        towards = -torch.stack(tuple(normalize(lens.z)))
        return torch.cat([towards, towards.new_zeros(1)]).double()

    def frustum(self, lens: OrthographicLens, x: Tensor, y: Tensor) -> Frustum:
        lens = doubled(lens)
        corner, axes = near_corner(lens), (lens.x, lens.y, lens.z)
        inverse = torch.linalg.inv(torch.stack([axis.stack() for axis in axes], 1))
        along_x, along_y, _ = map(Vec3.of, inverse)
        ahead = normalize(lens.z)
        (left, right), (top, bottom) = 1.0 - 2.0 * x, (1.0 - 2.0 * y) / lens.aspect
        return Frustum.of([Plane.through(corner, -along_x, left), Plane.through(corner, along_x, -right),
                           Plane.through(corner, -along_y, top), Plane.through(corner, along_y, -bottom),
                           Plane.through(corner, ahead), Plane.through(corner, -ahead, lens.depth)])


def near_corner(lens: OrthographicLens) -> Vec3:
    """The centre of the image on the near plane, world space."""
    return lens.origin + lens.z * lens.near


@register("sensor", "orthographic")
class Orthographic(ProjectiveCamera):
    """A camera without perspective. It looks along its local +z, with y up and x to the left, as in Mitsuba.

    Its image shows x from 1 at the left to -1 at the right, and as much of y as its aspect ratio gives: the scale of
    `to_world` decides how much of the world that is.

    Parameters: `to_world` (4, 4). Derivatives: with respect to it.

    Args:
        near_clip, far_clip: distances along the viewing axis between which surfaces are seen. As in Mitsuba, the near plane
            is scaled with `to_world`, and the far one lies far_clip - near_clip behind it whatever the scale.
        to_world: the pose, such as `rb.look_at` gives, times a scale: how much of the world is seen.
    """

    takes_scale = True

    def __init__(self, *, to_world: Matrix4 | None = None, near_clip: float = 1e-2, far_clip: float = 1e4,
                 focus_distance: float | None = None, shutter_open: float = 0.0, shutter_close: float = 0.0,
                 film: Film | None = None, sampler: Sampler | None = None, medium: Medium | None = None):
        super().__init__()
        self.place(to_world, near_clip, far_clip, film, sampler, medium)
        self.focus_distance, self.shutter_open, self.shutter_close = focus_distance, shutter_open, shutter_close

    def kind(self) -> OrthographicKind:
        return OrthographicKind()

    def lens(self) -> OrthographicLens:
        matrix = self.to_world
        return OrthographicLens(
            *(Vec3.of(matrix[:3, k]) for k in range(4)), aspect=matrix.new_tensor(self.aspect),
            near=matrix.new_tensor(self.near_clip), depth=matrix.new_tensor(self.far_clip - self.near_clip))

    def view(self) -> str:
        width, height = (2.0 * float(self.to_world.detach()[:3, k].norm()) for k in (0, 1))
        return f"{width:.4g} x {height / self.aspect:.4g}"
