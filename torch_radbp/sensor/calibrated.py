"""A calibrated camera, as in computer vision: intrinsics in pixels, and lens distortion."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, NamedTuple, TypedDict

import torch
from torch import Tensor

from torch_radbp.plugin import Film, Matrix4, Medium, Plugin, Sampler, nearest, positive, register
from torch_radbp.plugin.domain import NUMBER, Domain
from torch_radbp.sensor.distortion import BrownConrady, Distortion, FieldOfView, KannalaBrandt, ThinPrismFisheye
from torch_radbp.sensor.frustum import Frustum, Plane, doubled
from torch_radbp.sensor.kind import PointsSeen, ProjectiveCamera, ProjectiveKind, number
from torch_radbp.sensor.perspective import Perspective, seen_from
from torch_radbp.tensors.vec import Frame, Ray, Vec2, Vec3, dot, normalize

FOCAL_LENGTH = NUMBER._replace(low=0.0, low_is_in=False, unit=" pixels")
OMEGA = NUMBER._replace(low=0.0, high=math.pi, low_is_in=False, high_is_in=False, unit=" radians")
BROWN_CONRADY, FISHEYE, THIN_PRISM_FISHEYE, FIELD_OF_VIEW = "brown_conrady", "fisheye", "thin_prism_fisheye", "field_of_view"
LENSES: dict[str, type[Distortion]] = {BROWN_CONRADY: BrownConrady, FISHEYE: KannalaBrandt,
                                       THIN_PRISM_FISHEYE: ThinPrismFisheye, FIELD_OF_VIEW: FieldOfView}
GRID = 17  # directions across the image, of which the bounds of a view are found
POINTS = 33  # on a segment that are tested for being in view
SQUARE = 1e-6  # relative difference of fx and fy of square pixels
GRAZING = 0.05  # cosine to the axis below which a view has no pyramid around it


class CameraAttributes(TypedDict, total=False):
    """Keyword arguments of `Calibrated` that calibration files do not contain, for readers of such files."""

    near_clip: float
    far_clip: float
    sampler: Sampler | None


class CalibratedLens(NamedTuple):
    """The intrinsics, pose and distortion that a calibrated camera computes with; scalars are () tensors."""

    axes: Frame  # world directions of x to the right, y down and z ahead; unit length
    origin: Vec3
    fx: Tensor  # pixels
    fy: Tensor
    cx: Tensor  # pixels, from the centre of the upper left pixel
    cy: Tensor
    skew: Tensor  # pixels
    width: Tensor  # of the whole image, pixels
    height: Tensor
    near: Tensor
    far: Tensor
    distortion: Distortion

    def point(self, position: Vec2) -> Vec2:
        """Pixel positions on the image as points of the image plane at distance 1."""
        y = (position.y * self.height - 0.5 - self.cy) / self.fy
        return Vec2((position.x * self.width - 0.5 - self.cx - self.skew * y) / self.fx, y)

    def position(self, point: Vec2) -> Vec2:
        """Points of the image plane at distance 1 as positions on the image."""
        return Vec2((self.fx * point.x + self.skew * point.y + self.cx + 0.5) / self.width,
                    (self.fy * point.y + self.cy + 0.5) / self.height)


@dataclass(frozen=True)
class CalibratedKind(ProjectiveKind):
    """Calibrated cameras: rays start at one point, in directions that the distortion decides."""

    fisheye: bool

    def sample_ray(self, lens: CalibratedLens, position: Vec2, aperture: None) -> tuple[Ray, Tensor | None]:
        local, seen = lens.distortion.direction(lens.point(position))
        d = lens.axes.to_world(local)
        near = d * lens.near
        o = Vec3(lens.origin.x + near.x, lens.origin.y + near.y, lens.origin.z + near.z)
        return Ray(o, normalize(d)), None if seen is None else seen.to(position.x.dtype)

    def project(self, lens: CalibratedLens, p: Vec3, aperture: None) -> Vec2:
        return lens.position(lens.distortion.distorted(lens.axes.coordinates(p - lens.origin)))

    def reach(self, lens: CalibratedLens, p: Vec3) -> Tensor:
        """The distance of world points for clipping: along the axis, or, for a fisheye, from the eye."""
        offset = p - lens.origin
        return torch.sqrt(dot(offset, offset)) if self.fisheye else dot(offset, lens.axes.n)

    def beyond_far_plane(self, lens: CalibratedLens, p: Vec3) -> Tensor:
        return self.reach(lens, p) > lens.far

    def beyond_planes(self, lens: CalibratedLens, p: Vec3) -> tuple[Tensor, Tensor]:
        offset = p - lens.origin
        if self.fisheye:
            squared = dot(offset, offset)
            return squared - lens.near**2, squared - lens.far**2
        ahead = dot(offset, lens.axes.n)
        return ahead - lens.near, ahead - lens.far

    def towards(self, lens: CalibratedLens, p: Vec3, aperture: None) -> Vec3:
        return lens.origin - p

    def eye(self, lens: CalibratedLens) -> Tensor:
        origin = torch.stack(tuple(lens.origin)).double()
        return torch.cat([origin, origin.new_ones(1)])

    def frustum(self, lens: CalibratedLens, x: Tensor, y: Tensor) -> Frustum:
        """A frustum around the curved view; all of space if the lens sees far to the side."""
        rows, columns = torch.meshgrid(*(torch.linspace(0, 1, GRID, dtype=torch.float64, device=x.device) * (b - a) + a
                                         for a, b in (y, x)), indexing="ij")
        d, seen = lens.distortion.direction(lens.point(Vec2(columns.flatten(), rows.flatten())))
        d = d if seen is None else Vec3(*(component[seen] for component in d))
        if len(d.x) == 0 or normalize(d).z.min() < GRAZING:
            nothing = torch.zeros_like(x[0])
            return Frustum.of([Plane(Vec3(nothing, nothing, nothing), torch.ones_like(nothing))] * 6)
        (left, right), (top, bottom) = (_around(slope / d.z) for slope in (d.x, d.y))
        axes, origin, near, far = (doubled(part) for part in (lens.axes, lens.origin, lens.near, lens.far))
        near = near * d.z.min() if self.fisheye else near
        across, down, ahead = axes
        return Frustum.of([Plane.through(origin, across - ahead * left), Plane.through(origin, ahead * right - across),
                           Plane.through(origin, down - ahead * top), Plane.through(origin, ahead * bottom - down),
                           Plane.through(origin, ahead, -near), Plane.through(origin, -ahead, far)])

    def crosses_view(self, lens: CalibratedLens, x: Tensor, y: Tensor, a: Vec3, b: Vec3) -> Tensor:
        """True if one of some points on a segment, clipped to the frustum, is projected into the view."""
        enters, leaves = self.frustum(lens, x, y).clipped(a, b)
        crosses = enters < leaves
        points = POINTS if any(bool((start != end).any()) for start, end in zip(a, b)) else 1
        share = torch.linspace(0, 1, points, dtype=torch.float64, device=x.device)
        share = enters[crosses, None] + (leaves - enters)[crosses, None] * share
        p = Vec3(*(start[crosses, None] + (end - start)[crosses, None] * share for start, end in zip(a, b)))
        local, reach = lens.axes.to_local(p - lens.origin), self.reach(lens, p)
        ahead = (reach >= lens.near) & (reach <= lens.far)
        local = local if self.fisheye else local._replace(z=torch.where(ahead, local.z, 1.0))
        point = lens.distortion.distorted(local)
        position = lens.position(point)
        inside = ahead & (position.x >= x[0]) & (position.x <= x[1]) & (position.y >= y[0]) & (position.y <= y[1])
        # What is projected there from beyond a fold is not seen there.
        back, seen = lens.distortion.direction(point.map(lambda part: part[inside]))
        if seen is not None:
            along = normalize(local.map(lambda part: part[inside]))
            inside[inside.clone()] = seen & (dot(normalize(back), along) > 1.0 - 1e-6)
        return crosses.index_put((crosses.nonzero().squeeze(1),), inside.any(1))


@dataclass(frozen=True)
class UndistortedKind(CalibratedKind):
    """Calibrated cameras without distortion."""

    sees_points: ClassVar[bool] = True

    def sight(self, lens: CalibratedLens, p: Vec3, aperture: None) -> PointsSeen:
        area = lens.fx * lens.fy / (lens.width * lens.height)
        return seen_from(lens, lens.origin, p, self.project(lens, p, aperture), area)


def _around(slopes: Tensor) -> tuple[Tensor, Tensor]:
    """The bounds of sampled slopes, with a margin for values between the samples."""
    low, high = slopes.aminmax()
    margin = 0.05 * (high - low)
    return low - margin, high + margin


@register("sensor", "calibrated")
class Calibrated(ProjectiveCamera):
    """A camera with intrinsics and distortion as OpenCV has them; Mitsuba has no counterpart of the latter.

    It looks along its local +z, with y up and x to the left, as the other cameras here. With x and y to the right and down,
    a direction (x, y, 1) is seen at the pixel coordinates

        u = fx x' + skew y' + cx,     v = fy y' + cy

    where (x', y') = (x, y) but for the distortion. (0, 0) is the *centre* of the upper left pixel and (-0.5, -0.5) the
    corner of the image. (COLMAP's and NeRF's files count from the corner: their cx and cy are greater by 0.5, and the
    constructors convert them.)

    `distortion="brown_conrady"`, with r^2 = x^2 + y^2:

        x' = x (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2)
        y' = y (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6) + p1 (r^2 + 2 y^2) + 2 p2 x y

    `distortion="fisheye"` (Kannala and Brandt), with theta the angle to the axis, up to half a circle:

        (x', y') = theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8) (x, y) / r

    `distortion="thin_prism_fisheye"`, COLMAP's THIN_PRISM_FISHEYE, with (a, b) = theta (x, y) / r, theta^2 = a^2 + b^2:

        x' = a (1 + k1 theta^2 + ... + k4 theta^8) + 2 p1 a b + p2 (theta^2 + 2 a^2) + sx1 theta^2
        y' = b (1 + k1 theta^2 + ... + k4 theta^8) + p1 (theta^2 + 2 b^2) + 2 p2 a b + sy1 theta^2

    `distortion="field_of_view"`, COLMAP's FOV (Devernay and Faugeras), for what is less than a right angle off the axis:

        (x', y') = atan(2 r tan(omega / 2)) / (omega r) (x, y)

    A pixel into which no direction is projected is black.

    Parameters: `to_world` (4, 4); `fx`, `fy`, `cx`, `cy`, `skew` (), pixels of the whole image; and those coefficients of
    `k1`, `k2`, `k3`, `k4`, `k5`, `k6`, `p1`, `p2`, `sx1`, `sy1`, `omega` that are given, (). To recover a coefficient, give
    it as 0.

    Args:
        fx, fy: focal lengths, pixels; `fy` is `fx` if it is not given.
        cx, cy: the principal point; by default the middle of the image, (width - 1) / 2 and (height - 1) / 2.
        skew: of the pixels' columns.
        distortion: brown_conrady, fisheye, thin_prism_fisheye or field_of_view.
        k1, k2, k3, k4, k5, k6, p1, p2, sx1, sy1: coefficients of the distortion; a fisheye has k1 to k4, and one with a thin
            prism p1, p2, sx1 and sy1 as well.
        omega: radians, between 0 and pi; of field_of_view, which needs it.
        near_clip, far_clip: distances between which surfaces are seen, along the viewing axis; of a fisheye, from the eye.
    """

    optional_parameters: ClassVar = (*BrownConrady._fields, "sx1", "sy1", "omega")  # that there are if they are given
    in_pixels: ClassVar = ("fx", "fy", "cx", "cy", "skew")

    def __init__(self, *, fx: float, fy: float | None = None, cx: float | None = None, cy: float | None = None,
                 skew: float = 0.0, distortion: str = BROWN_CONRADY, k1: float | None = None, k2: float | None = None,
                 k3: float | None = None, k4: float | None = None, k5: float | None = None, k6: float | None = None,
                 p1: float | None = None, p2: float | None = None, sx1: float | None = None, sy1: float | None = None,
                 omega: float | None = None, to_world: Matrix4 | None = None, near_clip: float = 1e-2,
                 far_clip: float = 1e4, shutter_open: float = 0.0, shutter_close: float = 0.0, film: Film | None = None,
                 sampler: Sampler | None = None, medium: Medium | None = None):
        super().__init__()
        self.place(to_world, near_clip, far_clip, film, sampler, medium)
        self.shutter_open, self.shutter_close = shutter_open, shutter_close
        self.freeze("fx", number(positive("fx", fx)))
        self.freeze("fy", number(positive("fy", fx if fy is None else fy)))
        self.freeze("cx", number((self.film.width - 1) / 2 if cx is None else cx))
        self.freeze("cy", number((self.film.height - 1) / 2 if cy is None else cy))
        self.freeze("skew", number(skew))
        if distortion not in LENSES:
            raise ValueError(f"distortion {distortion!r} is not known; {nearest(distortion, LENSES)}")
        self.distortion = distortion
        given = {"k1": k1, "k2": k2, "k3": k3, "k4": k4, "k5": k5, "k6": k6, "p1": p1, "p2": p2, "sx1": sx1, "sy1": sy1,
                 "omega": omega}
        if distortion == FIELD_OF_VIEW and omega is None:
            raise ValueError(f"a {FIELD_OF_VIEW} lens needs omega, radians between 0 and pi; 0.01 is hardly any distortion")
        for name, value in given.items():
            if value is None:
                setattr(self, name, None)
                continue
            if name not in LENSES[distortion]._fields:
                raise ValueError(f"a {distortion} lens has no coefficient {name}; it has "
                                 f"{', '.join(LENSES[distortion]._fields)}")
            self.freeze(name, number(value))

    def domains(self) -> dict[str, Domain]:
        return super().domains() | {"fx": FOCAL_LENGTH, "fy": FOCAL_LENGTH} | dict.fromkeys(
            ("cx", "cy", "skew", *self.optional_parameters), NUMBER) | {"omega": OMEGA}

    @torch.no_grad()
    def rescale(self, x: float, y: float) -> None:
        for parameter, factor in ((self.fx, x), (self.skew, x), (self.fy, y)):
            parameter.mul_(factor)
        for parameter, factor in ((self.cx, x), (self.cy, y)):  # from the centre of the first pixel, not its corner
            parameter.add_(0.5).mul_(factor).sub_(0.5)

    @property
    def is_fisheye(self) -> bool:
        """True if the lens may see further than a right angle off its axis."""
        return LENSES[self.distortion].is_fisheye

    def kind(self) -> CalibratedKind:
        undistorted = all(getattr(self, name) is None for name in self.optional_parameters)
        if undistorted and self.distortion == BROWN_CONRADY:
            return UndistortedKind(fisheye=False)
        return CalibratedKind(self.is_fisheye)

    def lens(self) -> CalibratedLens:
        matrix = self.to_world
        left, up, ahead = (normalize(Vec3.of(matrix[:3, k])) for k in range(3))
        model = LENSES[self.distortion]
        return CalibratedLens(
            axes=Frame(-left, -up, ahead), origin=Vec3.of(matrix[:3, 3]), fx=self.fx, fy=self.fy, cx=self.cx, cy=self.cy,
            skew=self.skew, width=matrix.new_tensor(float(self.film.width)),
            height=matrix.new_tensor(float(self.film.height)), near=matrix.new_tensor(self.near_clip),
            far=matrix.new_tensor(self.far_clip), distortion=model(*(getattr(self, name) for name in model._fields)))

    def for_mitsuba(self) -> Plugin:
        """A `perspective` that is exactly this camera; raises ValueError if there is none."""
        beyond = self.beyond_perspective()
        if beyond:
            raise ValueError(f"its sensors have no {', '.join(beyond)}")
        return self.as_perspective()

    def beyond_perspective(self) -> list[str]:
        """Names what a `perspective` cannot represent of this sensor: distortion, skew, fisheye, non-square pixels."""
        beyond = [name for name in self.optional_parameters if getattr(self, name) is not None and getattr(self, name) != 0]
        beyond += ["skew"] * bool(self.skew != 0) + ["fisheye"] * self.is_fisheye
        return beyond + ["fx other than fy"] * (abs(float(self.fx / self.fy) - 1.0) > SQUARE)

    def as_perspective(self) -> Perspective:
        """A `perspective` with the pose, fx and principal point of this sensor, the rest ignored."""
        width, height = self.film.width, self.film.height
        fx, cx, cy = (float(value) for value in (self.fx, self.cx, self.cy))
        sensor = Perspective(fov=45.0, near_clip=self.near_clip, far_clip=self.far_clip, shutter_open=self.shutter_open,
                             shutter_close=self.shutter_close, film=self.film, sampler=self.sampler,
                             medium=self.medium).to(self.fx.dtype)
        values = {"to_world": self.to_world, "x_fov": math.degrees(2.0 * math.atan(width / (2.0 * fx))),
                  "principal_point_offset_x": 0.5 - (cx + 0.5) / width,
                  "principal_point_offset_y": 0.5 - (cy + 0.5) / height}
        with torch.no_grad():
            for name, value in values.items():
                getattr(sensor, name).copy_(torch.as_tensor(value))
        return sensor

    def view(self) -> str:
        if self.distortion != BROWN_CONRADY:
            return f"{self.distortion.replace('_', ' ')}, {float(self.fx):.4g} px"
        return f"{math.degrees(2 * math.atan(self.film.width / (2 * float(self.fx)))):.2f} deg"
