"""The distortion of photographic lenses: from undistorted directions to the image plane at distance 1, and back.

Forward, both are formulas. Back, an equation is solved by a fixed number of Newton steps without derivatives, and one more
with them: where f(x, theta) = y is solved, the step x - J^-1 (f(x, theta) - y) with x and J held has the derivatives that
the implicit function theorem says, and squares what error is left.

Axes are OpenCV's: x to the right, y down, z ahead.

References: Brown 1966, "Decentering Distortion of Lenses"; Kannala and Brandt 2006, "A Generic Camera Model and Calibration
Method for Conventional, Wide-Angle, and Fish-Eye Lenses", equation 6; OpenCV's documentation of `calib3d` (the rational form
and the order of coefficients); Devernay and Faugeras 2001, "Straight lines have to be straight", equation 15 (the field of
view); Weng, Cohen and Herniou 1992, "Camera Calibration with Distortion Models and Accuracy Evaluation" (thin prisms);
COLMAP's `src/colmap/sensor/models.h` (FOV, THIN_PRISM_FISHEYE).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeVar

import torch
from torch import Tensor

from torch_radbp.tensors.vec import Vec2, Vec3

STEPS = 10  # of Newton's method; from the distorted point a lens within its field needs 3 to 6 in float32
SOLVED = 1e-5  # greatest error of an equation that counts as solved, relative to 1 + |y|
HALF_CIRCLE = 3.1415  # radians off the axis, at which a fisheye ends
TINY = 1e-24

Coefficient = Tensor | None  # () or absent, which is 0
Lens = TypeVar("Lens", bound=tuple)  # the coefficients of a map of the plane


class BrownConrady(NamedTuple):
    """Brown-Conrady distortion: radial, a quotient of polynomials, and tangential."""

    is_fisheye = False  # True: reaches further than a right angle off the axis
    k1: Coefficient = None
    k2: Coefficient = None
    k3: Coefficient = None
    k4: Coefficient = None
    k5: Coefficient = None
    k6: Coefficient = None
    p1: Coefficient = None
    p2: Coefficient = None

    def distorted(self, d: Vec3) -> Vec2:
        """Projects directions in front of the camera, (N,), to the image plane."""
        return brown_conrady(self, Vec2(d.x / d.z, d.y / d.z)).value

    def direction(self, point: Vec2) -> tuple[Vec3, Tensor | None]:
        """Unprojects (N,) points of the image plane to directions with z = 1; attached to both.

        Returns:
            The directions, and True where there is one; the axis where there is none, or only one beyond the fold of the
            polynomial. None: there is one everywhere.
        """
        if all(coefficient is None for coefficient in self):
            return Vec3(point.x, point.y, torch.ones_like(point.x)), None
        solved, seen = _inverted(brown_conrady, self, point, point)
        mask = seen.to(solved.x.dtype)
        return Vec3(solved.x * mask, solved.y * mask, torch.ones_like(solved.x)), seen


class Linearized(NamedTuple):
    """A map of the plane at (N,) points: attached value, detached Jacobian."""

    value: Vec2
    xx: Tensor  # derivative of the value's x by x
    xy: Tensor  # of its x by y
    yx: Tensor
    yy: Tensor

    @property
    def determinant(self) -> Tensor:
        return self.xx * self.yy - self.xy * self.yx


def brown_conrady(lens: BrownConrady, at: Vec2) -> Linearized:
    """Distorts points, with the Jacobian."""
    square = at.x * at.x + at.y * at.y
    above, slope_above = _polynomial(square, (lens.k1, lens.k2, lens.k3))
    below, slope_below = _polynomial(square, (lens.k4, lens.k5, lens.k6))
    radial = above / below
    return decentred(at, radial, ((slope_above - radial * slope_below) / below).detach(), lens.p1, lens.p2)


def decentred(at: Vec2, radial: Tensor, slope: Tensor, p1: Coefficient, p2: Coefficient) -> Linearized:
    """Scales points by a function of their squared radius, whose derivative is `slope`, and adds tangential distortion."""
    x, y = at
    square = x * x + y * y
    value_x, value_y, fixed = x * radial, y * radial, radial.detach()
    xx, xy, yy = fixed + 2.0 * x * x * slope, 2.0 * x * y * slope, fixed + 2.0 * y * y * slope
    if p1 is not None:
        p = p1.detach()
        value_x, value_y = value_x + 2.0 * p1 * x * y, value_y + p1 * (square + 2.0 * y * y)
        xx, xy, yy = xx + 2.0 * p * y, xy + 2.0 * p * x, yy + 6.0 * p * y
    if p2 is not None:
        p = p2.detach()
        value_x, value_y = value_x + p2 * (square + 2.0 * x * x), value_y + 2.0 * p2 * x * y
        xx, xy, yy = xx + 6.0 * p * x, xy + 2.0 * p * y, yy + 2.0 * p * x
    return Linearized(Vec2(value_x, value_y), xx, xy, xy, yy)


def _polynomial(s: Tensor, coefficients: tuple[Coefficient, ...]) -> tuple[Tensor, Tensor]:
    """1 + c1 s + c2 s^2 + ... and its derivative by s."""
    value, slope, power = torch.ones_like(s), torch.zeros_like(s), torch.ones_like(s)
    for number, coefficient in enumerate(coefficients):
        if coefficient is not None:
            slope = slope + (number + 1.0) * coefficient * power
            value = value + coefficient * power * s
        power = power * s
    return value, slope


def newton(x: Vec2, there: Linearized, target: Vec2) -> Vec2:
    """One Newton step towards the solution of f(x) = target; attached to the value of f and to the target."""
    a, b = there.value.x - target.x, there.value.y - target.y
    determinant = there.determinant.detach()
    scale = 1.0 / torch.where(determinant.abs() > TINY, determinant, 1.0)
    return Vec2(x.x - (there.yy * a - there.xy * b) * scale, x.y - (there.xx * b - there.yx * a) * scale)


def _inverted(plane_map: Callable[[Lens, Vec2], Linearized], lens: Lens, point: Vec2, start: Vec2) -> tuple[Vec2, Tensor]:
    """Inverts a map of the plane at (N,) points by Newton's method, attached to the lens and to the points.

    Returns:
        The points, and True where there is one; any finite point where there is none, or only one beyond a fold.
    """
    held, target = type(lens)(*(None if k is None else k.detach() for k in lens)), point.map(torch.Tensor.detach)
    x = start.map(torch.Tensor.detach)
    for _ in range(STEPS):
        x = newton(x, plane_map(held, x), target)
    there = plane_map(held, x)
    off = torch.maximum((there.value.x - target.x).abs(), (there.value.y - target.y).abs())
    size = 1.0 + torch.maximum(target.x.abs(), target.y.abs())
    seen = (off < SOLVED * size) & (there.determinant > 0) & (there.xx > 0)
    x = x.map(lambda part: torch.where(seen, part, 0.0))
    return newton(x, plane_map(lens, x), point), seen


class KannalaBrandt(NamedTuple):
    """Kannala-Brandt fisheye: the distance from the image's centre is a polynomial of the angle to the axis."""

    is_fisheye = True
    k1: Coefficient = None
    k2: Coefficient = None
    k3: Coefficient = None
    k4: Coefficient = None

    def distorted(self, d: Vec3) -> Vec2:
        """Projects (N,) directions to the image plane."""
        across = torch.sqrt((d.x * d.x + d.y * d.y).clamp_min(TINY))
        theta = torch.atan2(across, d.z)
        scale = theta * _polynomial(theta * theta, tuple(self))[0] / across
        return Vec2(d.x * scale, d.y * scale)

    def direction(self, point: Vec2) -> tuple[Vec3, Tensor]:
        """Unprojects (N,) points of the image plane to unit directions; attached to both.

        Returns:
            The directions, and True where there is one less than half a circle off the axis; elsewhere the axis.
        """
        radius = torch.sqrt((point.x * point.x + point.y * point.y).clamp_min(TINY))
        held, target = KannalaBrandt(*(None if k is None else k.detach() for k in self)), radius.detach()
        theta = target.clamp_max(0.5 * HALF_CIRCLE)
        for _ in range(STEPS):
            value, slope = held.radius_of(theta)
            step = (value - target) / torch.where(slope.abs() > TINY, slope, 1.0)
            theta = (theta - step).clamp(0.0, 2.0 * HALF_CIRCLE)
        value, slope = held.radius_of(theta)
        seen = ((value - target).abs() < SOLVED * (1.0 + target)) & (slope > 0) & (theta < HALF_CIRCLE)
        mask = seen.to(theta.dtype)
        theta = theta * mask
        value, _ = self.radius_of(theta)
        theta = theta - (value - radius) * (mask / torch.where(seen, slope, 1.0))
        across = torch.sin(theta) / radius
        return Vec3(point.x * across, point.y * across, torch.cos(theta)), seen

    def radius_of(self, theta: Tensor) -> tuple[Tensor, Tensor]:
        """The distance from the image's centre of rays at an angle to the axis, and its derivative."""
        square = theta * theta
        value, slope = _polynomial(square, tuple(self))
        return theta * value, value + 2.0 * square * slope


class ThinPrismFisheye(NamedTuple):
    """A fisheye with tangential and thin-prism distortion of the image plane."""

    is_fisheye = True
    k1: Coefficient = None
    k2: Coefficient = None
    k3: Coefficient = None
    k4: Coefficient = None
    p1: Coefficient = None
    p2: Coefficient = None
    sx1: Coefficient = None
    sy1: Coefficient = None

    def distorted(self, d: Vec3) -> Vec2:
        """Projects (N,) directions to the image plane."""
        return thin_prism(self, KannalaBrandt().distorted(d)).value

    def direction(self, point: Vec2) -> tuple[Vec3, Tensor]:
        """Unprojects (N,) points of the image plane to unit directions; attached to both.

        Returns:
            The directions, and True where there is one less than half a circle off the axis; elsewhere the axis.
        """
        radius = torch.sqrt((point.x * point.x + point.y * point.y).clamp_min(TINY))
        scale = (0.5 * HALF_CIRCLE / radius).clamp_max(1.0)  # as KannalaBrandt begins
        solved, seen = _inverted(thin_prism, self, point, point.map(lambda part: part * scale))
        theta = torch.sqrt((solved.x * solved.x + solved.y * solved.y).clamp_min(TINY))
        seen = seen & (theta < HALF_CIRCLE)
        mask = seen.to(theta.dtype)
        across = torch.sin(theta) / theta * mask
        return Vec3(solved.x * across, solved.y * across, torch.cos(theta * mask)), seen


def thin_prism(lens: ThinPrismFisheye, at: Vec2) -> Linearized:
    """Distorts points of the equidistant fisheye, with the Jacobian."""
    square = at.x * at.x + at.y * at.y
    radial, slope = _polynomial(square, (lens.k1, lens.k2, lens.k3, lens.k4))
    there = decentred(at, radial, slope.detach(), lens.p1, lens.p2)
    if lens.sx1 is not None:
        s = 2.0 * lens.sx1.detach()
        there = there._replace(value=there.value._replace(x=there.value.x + lens.sx1 * square), xx=there.xx + s * at.x,
                               xy=there.xy + s * at.y)
    if lens.sy1 is not None:
        s = 2.0 * lens.sy1.detach()
        there = there._replace(value=there.value._replace(y=there.value.y + lens.sy1 * square), yx=there.yx + s * at.x,
                               yy=there.yy + s * at.y)
    return there


class FieldOfView(NamedTuple):
    """The FOV model: distances from the image's centre grow nearly as the angles to the axis, up to a right angle."""

    is_fisheye = False
    omega: Tensor  # () radians, greater than 0 and less than pi: the field of view of an ideal fisheye

    def distorted(self, d: Vec3) -> Vec2:
        """Projects directions in front of the camera, (N,), to the image plane."""
        x, y = d.x / d.z, d.y / d.z
        radius = torch.sqrt((x * x + y * y).clamp_min(TINY))
        scale = torch.atan(radius * (2.0 * torch.tan(0.5 * self.omega))) / (radius * self.omega)
        return Vec2(x * scale, y * scale)

    def direction(self, point: Vec2) -> tuple[Vec3, Tensor]:
        """Unprojects (N,) points of the image plane to directions with z = 1; attached to both.

        Returns:
            The directions, and True where there is one; elsewhere the axis.
        """
        radius = torch.sqrt((point.x * point.x + point.y * point.y).clamp_min(TINY))
        angle = radius * self.omega
        seen = angle < 0.5 * HALF_CIRCLE
        scale = torch.tan(angle * seen.to(angle.dtype)) / (radius * (2.0 * torch.tan(0.5 * self.omega)))
        return Vec3(point.x * scale, point.y * scale, torch.ones_like(scale)), seen


Distortion = BrownConrady | KannalaBrandt | ThinPrismFisheye | FieldOfView
