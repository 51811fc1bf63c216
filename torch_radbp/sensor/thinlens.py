"""The thin-lens camera, with depth of field."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import torch
from torch import Tensor

from torch_radbp.plugin import Film, Matrix4, Medium, Sampler, positive, register
from torch_radbp.plugin.domain import NUMBER, Domain
from torch_radbp.sampling.warp import square_to_uniform_disk_concentric
from torch_radbp.sensor.frustum import Frustum, Plane, doubled
from torch_radbp.sensor.kind import PointsSeen, ProjectiveKind, number
from torch_radbp.sensor.perspective import FieldOfViewCamera, PinholeKind, PinholeLens, seen_from
from torch_radbp.tensors.vec import Ray, Vec2, Vec3, dot, normalize

LENGTH = NUMBER._replace(low=0.0, low_is_in=False)


class ThinLensLens(NamedTuple):
    """A thin lens as the camera's functions read it; scalars are () tensors."""

    pinhole: PinholeLens  # in the middle of the lens
    radius: Tensor  # of the aperture
    focus: Tensor  # distance of the plane in focus, along the viewing axis

    def start(self, aperture: Vec2) -> Vec2:
        """The points on the lens, in its plane, at which rays start."""
        return square_to_uniform_disk_concentric(aperture.x, aperture.y) * self.radius


@dataclass(frozen=True)
class ThinLensKind(ProjectiveKind):
    """Thin-lens cameras: rays of one position on the image start all over the lens and meet in the plane of focus."""

    has_aperture: ClassVar[bool] = True
    sees_points: ClassVar[bool] = True

    def sample_ray(self, lens: ThinLensLens, position: Vec2, aperture: Vec2) -> tuple[Ray, None]:
        pinhole, slopes = lens.pinhole, lens.pinhole.slopes(position)
        start = lens.start(aperture)
        ahead = torch.ones_like(slopes.x)
        d = pinhole.axes.to_world(Vec3(slopes.x - start.x / lens.focus, slopes.y - start.y / lens.focus, ahead))
        place = pinhole.axes.to_world(Vec3(start.x, start.y, torch.zeros_like(ahead)))
        o = Vec3(*(c + p + n * pinhole.near for c, p, n in zip(pinhole.origin, place, d)))
        return Ray(o, normalize(d)), None

    def project(self, lens: ThinLensLens, p: Vec3, aperture: Vec2) -> Vec2:
        start, local = lens.start(aperture), lens.pinhole.axes.coordinates(p - lens.pinhole.origin)
        return lens.pinhole.position(Vec2((local.x - start.x) / local.z + start.x / lens.focus,
                                          (local.y - start.y) / local.z + start.y / lens.focus))

    def beyond_far_plane(self, lens: ThinLensLens, p: Vec3) -> Tensor:
        return PinholeKind().beyond_far_plane(lens.pinhole, p)

    def beyond_planes(self, lens: ThinLensLens, p: Vec3) -> tuple[Tensor, Tensor]:
        return PinholeKind().beyond_planes(lens.pinhole, p)

    def towards(self, lens: ThinLensLens, p: Vec3, aperture: Vec2) -> Vec3:
        start = lens.start(aperture)
        return lens.pinhole.axes.to_world(Vec3(start.x, start.y, torch.zeros_like(start.x))) + lens.pinhole.origin - p

    def sight(self, lens: ThinLensLens, p: Vec3, aperture: Vec2) -> PointsSeen:
        pinhole, position = lens.pinhole, self.project(lens, p, aperture)
        return seen_from(pinhole, p + self.towards(lens, p, aperture), p, position, pinhole.area)

    def eye(self, lens: ThinLensLens) -> Tensor:
        """The middle of the lens, from which silhouettes are searched for; (4,) homogeneous."""
        return PinholeKind().eye(lens.pinhole)

    def aperture_radius(self, lens: ThinLensLens) -> Tensor:
        return lens.radius.detach()

    def frustum(self, lens: ThinLensLens, x: Tensor, y: Tensor) -> Frustum:
        """A frustum around what is seen from anywhere on the lens: the blur has at most radius (1 + z / focus)."""
        *sides, near, far = PinholeKind().frustum(lens.pinhole, x, y)
        pinhole, radius, focus = doubled(lens)
        n = pinhole.axes.n * (radius / focus)
        blurred = [Plane(side.n + n, side.d + radius - dot(pinhole.origin, n)) for side in sides]
        return Frustum(*blurred, near, far)


@register("sensor", "thinlens")
class ThinLens(FieldOfViewCamera):
    """A camera whose lens lets light in through a disk. It looks along its local +z, with y up and x to the left.

    Things in the plane at `focus_distance` are sharp. Names and defaults are Mitsuba's, whose plugin has no principal point.

    Parameters: `to_world` (4, 4), `x_fov`, `aperture_radius`, `focus_distance` (), the lengths in units of the world.

    Args:
        aperture_radius: of the lens, from whose middle the field of view is measured.
        focus_distance: of the sharp plane along the viewing axis; by default `far_clip`.
    """

    def __init__(self, *, aperture_radius: float, to_world: Matrix4 | None = None, fov: float | None = None,
                 focal_length: str | None = None, fov_axis: str = "x", near_clip: float = 1e-2, far_clip: float = 1e4,
                 focus_distance: float | None = None, shutter_open: float = 0.0, shutter_close: float = 0.0,
                 film: Film | None = None, sampler: Sampler | None = None, medium: Medium | None = None):
        super().__init__()
        self.place_view(fov, focal_length, fov_axis, shutter_open, shutter_close, to_world=to_world, near_clip=near_clip,
                        far_clip=far_clip, film=film, sampler=sampler, medium=medium)
        focus_distance = self.far_clip if focus_distance is None else focus_distance
        self.freeze("aperture_radius", number(positive("aperture_radius", aperture_radius)))
        self.freeze("focus_distance", number(positive("focus_distance", focus_distance)))

    def domains(self) -> dict[str, Domain]:
        return super().domains() | {"aperture_radius": LENGTH, "focus_distance": LENGTH}

    def kind(self) -> ThinLensKind:
        return ThinLensKind()

    def lens(self) -> ThinLensLens:
        zero = torch.zeros_like(self.x_fov)
        return ThinLensLens(self.pinhole(zero, zero), self.aperture_radius, self.focus_distance)
