"""The pinhole camera."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import torch
from torch import Tensor

from torch_radbp.plugin import Film, Matrix4, Medium, Sampler, nearest, positive, register, warn_of_radians
from torch_radbp.plugin.domain import NUMBER, Domain
from torch_radbp.sensor.frustum import Frustum, Plane, doubled
from torch_radbp.sensor.kind import PointsSeen, ProjectiveCamera, ProjectiveKind, number
from torch_radbp.tensors.vec import TINY, Frame, Ray, Vec2, Vec3, dot, normalize

FIELD_OF_VIEW = NUMBER._replace(low=0.0, high=180.0, low_is_in=False, high_is_in=False, unit=" degrees")
FOV_AXES = ("x", "y", "diagonal", "smaller", "larger")


class PinholeLens(NamedTuple):
    """The pose and view of a pinhole camera as its functions read them; scalars are () tensors."""

    axes: Frame  # world directions of the camera's x, y, z; unit length
    origin: Vec3
    tan_x: Tensor  # tangent of half the horizontal field of view
    aspect: Tensor  # width / height of the whole image
    shift_x: Tensor  # principal point, fraction of the width
    shift_y: Tensor  # fraction of the height
    near: Tensor
    far: Tensor

    def slopes(self, position: Vec2) -> Vec2:
        """Positions on the image as slopes x / z and y / z of local directions."""
        return Vec2((1.0 - 2.0 * (position.x + self.shift_x)) * self.tan_x,
                    (1.0 - 2.0 * (position.y + self.shift_y)) * self.tan_x / self.aspect)

    def position(self, slopes: Vec2) -> Vec2:
        """Slopes x / z and y / z of local directions as positions on the image."""
        scale = 0.5 / self.tan_x
        return Vec2(0.5 - slopes.x * scale - self.shift_x, 0.5 - slopes.y * (scale * self.aspect) - self.shift_y)

    @property
    def area(self) -> Tensor:
        """The area of the image, which is 1, for each of slopes x / z and y / z."""
        return 0.25 * self.aspect / (self.tan_x * self.tan_x)


@dataclass(frozen=True)
class PinholeKind(ProjectiveKind):
    """Pinhole cameras: all rays meet in a point."""

    sees_points: ClassVar[bool] = True

    def sample_ray(self, lens: PinholeLens, position: Vec2, aperture: None) -> tuple[Ray, None]:
        slopes = lens.slopes(position)
        d = lens.axes.to_world(Vec3(slopes.x, slopes.y, torch.ones_like(slopes.x)))
        near = d * lens.near
        o = Vec3(lens.origin.x + near.x, lens.origin.y + near.y, lens.origin.z + near.z)
        return Ray(o, normalize(d)), None

    def project(self, lens: PinholeLens, p: Vec3, aperture: None) -> Vec2:
        local = lens.axes.coordinates(p - lens.origin)
        return lens.position(Vec2(local.x, local.y) * (1.0 / local.z))

    def beyond_far_plane(self, lens: PinholeLens, p: Vec3) -> Tensor:
        return dot(p - lens.origin, lens.axes.n) > lens.far

    def beyond_planes(self, lens: PinholeLens, p: Vec3) -> tuple[Tensor, Tensor]:
        ahead = dot(p - lens.origin, lens.axes.n)
        return ahead - lens.near, ahead - lens.far

    def towards(self, lens: PinholeLens, p: Vec3, aperture: None) -> Vec3:
        return lens.origin - p

    def sight(self, lens: PinholeLens, p: Vec3, aperture: None) -> PointsSeen:
        position = self.project(lens, p, aperture)
        return seen_from(lens, lens.origin, p, position, lens.area)

    def eye(self, lens: PinholeLens) -> Tensor:
        origin = torch.stack(tuple(lens.origin)).double()
        return torch.cat([origin, origin.new_ones(1)])

    def frustum(self, lens: PinholeLens, x: Tensor, y: Tensor) -> Frustum:
        lens = doubled(lens)
        (left, right), (top, bottom) = lens.slopes(Vec2(x, y))
        across, up, ahead = lens.axes
        inwards = ahead * left - across, across - ahead * right, ahead * top - up, up - ahead * bottom
        return Frustum.of([*(Plane.through(lens.origin, n) for n in inwards),
                           Plane.through(lens.origin, ahead, -lens.near), Plane.through(lens.origin, -ahead, lens.far)])


def seen_from(lens: Any, eye: Vec3, p: Vec3, position: Vec2, area: Tensor) -> PointsSeen:
    """World points as they are seen from a place in the plane of the lens.

    Args:
        lens: with an entry for each point, (N,).
        eye: (N,) the place.
        p: (N,) the points.
        position: (N,) on the image.
        area: (N,) that of the image, which is 1, for each of slopes x / z and y / z.
    """
    way = p - eye
    z, distance = dot(way, lens.axes.n), torch.sqrt(dot(way, way).clamp_min(TINY))
    ahead = (z > lens.near) & (z <= lens.far)
    z = torch.where(ahead, z, lens.near)
    share = torch.where(ahead, lens.near / z, 0.0)  # the other points, too, have a direction
    return PointsSeen(position, area * distance / (z * z * z), eye + way * share, ahead)


class FieldOfViewCamera(ProjectiveCamera):
    """Base class of cameras with a field of view: `x_fov` (), degrees along x, beside `to_world`.

    Attributes:
        x_fov: degrees, along x, which follows from `fov` or `focal_length`.

    Args:
        fov: degrees, along `fov_axis`. Either this or `focal_length`.
        focal_length: such as "50mm", for a 35 mm film (36 x 24 mm, measured along the diagonal).
        fov_axis: x, y, diagonal, smaller or larger.
    """

    fov_axis, focal_length = "x", None

    def place_view(self, fov: float | None, focal_length: str | None, fov_axis: str, shutter_open: float,
                   shutter_close: float, **placing: Any) -> None:
        """Stores the attributes of all cameras with a field of view; `placing` as for `place`."""
        fov, fov_axis = field_of_view(fov, focal_length, fov_axis)
        self.place(**placing)
        self.shutter_open, self.shutter_close = shutter_open, shutter_close
        self.freeze("x_fov", number(horizontal_fov(fov, fov_axis, self.aspect)))

    def domains(self) -> dict[str, Domain]:
        return super().domains() | {"x_fov": FIELD_OF_VIEW}

    @property
    def fov(self) -> float:
        """The current field of view along x, degrees; `fov_axis` and `focal_length` are resolved into it."""
        return float(self.x_fov)

    def pinhole(self, shift_x: Tensor, shift_y: Tensor) -> PinholeLens:
        """The pinhole in the middle of the lens, attached; shifts of the image as fractions of its size."""
        matrix = self.to_world
        columns = [normalize(Vec3.of(matrix[:3, k])) for k in range(3)]
        return PinholeLens(
            axes=Frame(*columns), origin=Vec3.of(matrix[:3, 3]), tan_x=torch.tan(0.5 * torch.deg2rad(self.x_fov)),
            aspect=matrix.new_tensor(self.aspect), shift_x=shift_x, shift_y=shift_y,
            near=matrix.new_tensor(self.near_clip), far=matrix.new_tensor(self.far_clip))

    def view(self) -> str:
        return f"{self.fov:.2f} deg"


@register("sensor", "perspective")
class Perspective(FieldOfViewCamera):
    """A pinhole camera. It looks along its local +z, with y up and x to the left, as in Mitsuba.

    Parameters: `to_world` (4, 4), `x_fov` (), `principal_point_offset_x`, `principal_point_offset_y` ().

    Args:
        principal_point_offset_x, principal_point_offset_y: shift of the image, as a fraction of its size.
    """

    def __init__(self, *, to_world: Matrix4 | None = None, fov: float | None = None, focal_length: str | None = None,
                 fov_axis: str = "x", near_clip: float = 1e-2, far_clip: float = 1e4,
                 principal_point_offset_x: float = 0.0, principal_point_offset_y: float = 0.0,
                 focus_distance: float | None = None, shutter_open: float = 0.0, shutter_close: float = 0.0,
                 film: Film | None = None, sampler: Sampler | None = None, medium: Medium | None = None):
        super().__init__()
        self.place_view(fov, focal_length, fov_axis, shutter_open, shutter_close, to_world=to_world, near_clip=near_clip,
                        far_clip=far_clip, film=film, sampler=sampler, medium=medium)
        self.focus_distance = focus_distance
        self.freeze("principal_point_offset_x", number(principal_point_offset_x))
        self.freeze("principal_point_offset_y", number(principal_point_offset_y))

    def domains(self) -> dict[str, Domain]:
        return super().domains() | {"principal_point_offset_x": NUMBER, "principal_point_offset_y": NUMBER}

    def kind(self) -> PinholeKind:
        return PinholeKind()

    def lens(self) -> PinholeLens:
        return self.pinhole(self.principal_point_offset_x, self.principal_point_offset_y)


def field_of_view(fov: float | None, focal_length: str | None, fov_axis: str) -> tuple[float, str]:
    """The field of view in degrees, and the axis along which it is measured; a 50 mm lens if none is given.

    Warns of an angle that may have been meant in radians.

    Raises:
        ValueError: if both are given, the axis is unknown, or the angle is out of range.
    """
    if fov_axis not in FOV_AXES:
        raise ValueError(f"fov_axis {fov_axis!r} is not known; {nearest(fov_axis, FOV_AXES)}")
    if fov is not None and focal_length is not None:
        raise ValueError("give either fov or focal_length, not both")
    computed = fov is None
    if computed:
        fov, fov_axis = diagonal_fov("50mm" if focal_length is None else focal_length), "diagonal"
    if not 0 < fov < 180:
        raise ValueError(f"fov must be between 0 and 180 degrees, got {fov}")
    if not computed:
        warn_of_radians("fov", fov)
    return fov, fov_axis


def diagonal_fov(focal_length: str) -> float:
    """The field of view in degrees along the diagonal of 35 mm film for a focal length such as "50mm"."""
    text = str(focal_length).strip()
    try:
        millimetres = float(text[:-2] if text.endswith("mm") else text)
    except ValueError:
        raise ValueError(f"focal_length must read like '50mm', got {focal_length!r}") from None
    return math.degrees(2 * math.atan(math.hypot(36, 24) / (2 * positive("focal_length", millimetres))))


def horizontal_fov(fov: float, axis: str, aspect: float) -> float:
    """The field of view in degrees along x, from one along `axis`; aspect = width / height."""
    if axis == "smaller":
        axis = "y" if aspect > 1 else "x"
    elif axis == "larger":
        axis = "x" if aspect > 1 else "y"
    half = math.tan(math.radians(fov) / 2)
    if axis == "y":
        half *= aspect
    elif axis == "diagonal":
        half *= aspect / math.hypot(aspect, 1)
    return math.degrees(2 * math.atan(half))
