"""The pinhole camera."""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.domain import NUMBER, POSE, Domain
from torch_radbp.film.filter import TABLE_SIZE
from torch_radbp.film.hdrfilm import HDRFilm
from torch_radbp.plugin import Film, Matrix4, Sampler, Sensor, nearest, positive, register
from torch_radbp.sensor.sampler import LowDiscrepancy
from torch_radbp.shape.surface import affine
from torch_radbp.vec import Frame, Ray, Vec3, dot, gather, normalize

FIELD_OF_VIEW = NUMBER._replace(low=0.0, high=180.0, low_is_in=False, high_is_in=False, unit=" degrees")
FOV_AXES = ("x", "y", "diagonal", "smaller", "larger")


class PinholeTensors(NamedTuple):
    """What `camera_ray` reads of one sensor; scalars are () tensors."""

    axes: Frame  # world directions of the camera's x, y, z; unit length
    origin: Vec3
    tan_x: Tensor  # tangent of half the horizontal field of view
    aspect: Tensor  # width / height of the whole image
    shift_x: Tensor  # principal point, fraction of the width
    shift_y: Tensor  # fraction of the height
    near: Tensor
    far: Tensor
    size_x: Tensor  # of the whole image, pixels
    size_y: Tensor
    crop_x: Tensor  # left edge of the crop window, pixels
    crop_y: Tensor
    quantiles: Tensor  # (TABLE_SIZE,) of the reconstruction filter
    inside_x: tuple[Tensor, Tensor]  # (W,) each: start and length of the part of the filter that a column samples
    inside_y: tuple[Tensor, Tensor]  # (H,) each


@register("sensor", "perspective")
class Perspective(Sensor):
    """A pinhole camera. It looks along its local +z, with y up and x to the left, as in Mitsuba.

    Parameters: `to_world` (4, 4), `x_fov` (), `principal_point_offset_x`, `principal_point_offset_y` ().

    Args:
        fov: degrees, along `fov_axis`. Either this or `focal_length`.
        focal_length: such as "50mm", for a 35 mm film (36 x 24 mm, measured along the diagonal).
        fov_axis: x, y, diagonal, smaller or larger.
        near_clip, far_clip: distances along the viewing axis between which surfaces are seen.
        principal_point_offset_x, principal_point_offset_y: shift of the image, as a fraction of its size.
        focus_distance, shutter_open, shutter_close: accepted, but without effect on a pinhole without motion.
    """

    def __init__(self, *, to_world: Matrix4 | None = None, fov: float | None = None, focal_length: str | None = None,
                 fov_axis: str = "x", near_clip: float = 1e-2, far_clip: float = 1e4,
                 principal_point_offset_x: float = 0.0, principal_point_offset_y: float = 0.0,
                 focus_distance: float | None = None, shutter_open: float = 0.0, shutter_close: float = 0.0,
                 film: Film | None = None, sampler: Sampler | None = None):
        super().__init__()
        self.film = HDRFilm() if film is None else film
        self.sampler = LowDiscrepancy() if sampler is None else sampler
        fov, fov_axis = field_of_view(fov, focal_length, fov_axis)
        if not 0 < near_clip < far_clip:
            raise ValueError(f"near_clip must be positive and less than far_clip, got {near_clip} and {far_clip}")
        self.near_clip, self.far_clip = positive("near_clip", near_clip), float(far_clip)
        self.focus_distance, self.shutter_open, self.shutter_close = focus_distance, shutter_open, shutter_close
        dtype = torch.get_default_dtype()
        self.freeze("to_world", affine("to_world", to_world))
        aspect = self.film.width / self.film.height
        self.freeze("x_fov", torch.tensor(horizontal_fov(fov, fov_axis, aspect), dtype=dtype))
        self.freeze("principal_point_offset_x", torch.tensor(float(principal_point_offset_x), dtype=dtype))
        self.freeze("principal_point_offset_y", torch.tensor(float(principal_point_offset_y), dtype=dtype))

    def domains(self) -> dict[str, Domain]:
        return {"to_world": POSE, "x_fov": FIELD_OF_VIEW, "principal_point_offset_x": NUMBER,
                "principal_point_offset_y": NUMBER}

    @property
    def fov(self) -> float:
        """The current field of view along x, degrees; `fov_axis` and `focal_length` are resolved into it."""
        return float(self.x_fov)

    fov_axis, focal_length = "x", None

    def tensors(self) -> PinholeTensors:
        """The camera as a record of tensors, attached."""
        matrix = self.to_world
        columns = [normalize(Vec3.of(matrix[:3, k])) for k in range(3)]

        def scalar(value: float) -> Tensor:
            return matrix.new_tensor(value)

        film = self.film
        return PinholeTensors(
            axes=Frame(*columns), origin=Vec3.of(matrix[:3, 3]), tan_x=torch.tan(0.5 * torch.deg2rad(self.x_fov)),
            aspect=scalar(film.width / film.height), shift_x=self.principal_point_offset_x,
            shift_y=self.principal_point_offset_y, near=scalar(self.near_clip), far=scalar(self.far_clip),
            size_x=scalar(film.width), size_y=scalar(film.height),
            crop_x=scalar(film.crop_offset_x), crop_y=scalar(film.crop_offset_y),
            quantiles=film.rfilter.quantiles().to(matrix),
            inside_x=tuple(part.to(matrix) for part in film.sampled_part(film.crop_width)),
            inside_y=tuple(part.to(matrix) for part in film.sampled_part(film.crop_height)))


def field_of_view(fov: float | None, focal_length: str | None, fov_axis: str) -> tuple[float, str]:
    """The angle in degrees, and the axis along which it is measured; a 50 mm lens if neither is given.

    Raises:
        ValueError: if both are given, the axis is unknown, or the angle is out of range.
    """
    if fov_axis not in FOV_AXES:
        raise ValueError(f"fov_axis {fov_axis!r} is not known; {nearest(fov_axis, FOV_AXES)}")
    if fov is not None and focal_length is not None:
        raise ValueError("give either fov or focal_length, not both")
    if fov is None:
        fov, fov_axis = diagonal_fov("50mm" if focal_length is None else focal_length), "diagonal"
    if not 0 < fov < 180:
        raise ValueError(f"fov must be between 0 and 180 degrees, got {fov}")
    return fov, fov_axis


def diagonal_fov(focal_length: str) -> float:
    """Degrees along the diagonal of 35 mm film for a focal length such as "50mm"."""
    text = str(focal_length).strip()
    try:
        millimetres = float(text[:-2] if text.endswith("mm") else text)
    except ValueError:
        raise ValueError(f"focal_length must read like '50mm', got {focal_length!r}") from None
    return math.degrees(2 * math.atan(math.hypot(36, 24) / (2 * positive("focal_length", millimetres))))


def horizontal_fov(fov: float, axis: str, aspect: float) -> float:
    """Degrees along x for a field of view given along `axis`; aspect = width / height."""
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


def camera_ray(camera: PinholeTensors, column: Tensor, row: Tensor, u: Tensor, v: Tensor) -> Ray:
    """Rays through pixels (column, row) of the crop window, offset by the reconstruction filter.

    Args:
        camera: from `Perspective.tensors`, attached.
        column, row: (N,) pixel coordinates inside the crop window.
        u, v: (N,) uniform numbers.

    Returns:
        Rays in world space that start on the near plane; attached to the camera's parameters.
    """
    u = gather(camera.inside_x[0], column) + u * gather(camera.inside_x[1], column)
    v = gather(camera.inside_y[0], row) + v * gather(camera.inside_y[1], row)
    x = (column + camera.crop_x + 0.5 + quantile(camera.quantiles, u)) / camera.size_x
    y = (row + camera.crop_y + 0.5 + quantile(camera.quantiles, v)) / camera.size_y
    along_x = (1.0 - 2.0 * (x + camera.shift_x)) * camera.tan_x
    along_y = (1.0 - 2.0 * (y + camera.shift_y)) * camera.tan_x / camera.aspect
    across = Vec3(along_x, along_y, torch.ones_like(along_x))
    d = camera.axes.to_world(across)
    near = d * camera.near
    o = Vec3(camera.origin.x + near.x, camera.origin.y + near.y, camera.origin.z + near.z)
    return Ray(o, normalize(d))


def beyond_far_plane(camera: PinholeTensors, p: Vec3) -> Tensor:
    """True where points lie beyond the far plane and cannot be seen."""
    return dot(p - camera.origin, camera.axes.n) > camera.far


def quantile(table: Tensor, u: Tensor) -> Tensor:
    """Linear interpolation of a filter's (TABLE_SIZE,) table at `u` in [0, 1]."""
    position = u * (TABLE_SIZE - 1)
    left = position.to(torch.int32).clamp_max(TABLE_SIZE - 2)
    fraction = position - left
    return gather(table, left) * (1.0 - fraction) + gather(table, left + 1) * fraction
