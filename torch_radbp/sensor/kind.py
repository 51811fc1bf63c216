"""The interface between sensors and the path tracer.

A sensor has two parts: its `CameraKind`, a hashable value that names the functions, and the tensors that they read: the
lens, a record of the kind's own, and the film. A `Camera` holds all three; it is what the tracer knows of a sensor.
"""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import torch
from torch import Tensor
from torch.nn.utils import parametrize

from torch_radbp.film.hdrfilm import HDRFilm
from torch_radbp.film.position import FilmTensors
from torch_radbp.plugin import Film, Matrix4, Medium, Sampler, Sensor, positive
from torch_radbp.plugin.domain import POSE, Domain
from torch_radbp.sensor.frustum import Frustum
from torch_radbp.sensor.sampler import LowDiscrepancy
from torch_radbp.tensors.vec import Ray, Vec2, Vec3
from torch_radbp.transforms import transform

Lens = Any  # a NamedTuple of tensors, attached
RIGID = 1e-3  # how far products of the rows of a pose may be from those of a rotation, as in Mitsuba


class PointsSeen(NamedTuple):
    """World points as a camera sees them, (N,); attached to both."""

    position: Vec2  # on the image, fractions of its size
    density: Tensor  # area of the image for each area of a surface there that is perpendicular to the way to the camera
    target: Vec3  # where that way ends: on the near plane
    ahead: Tensor  # bool: the point lies between the near plane and the far one


@dataclass(frozen=True)
class CameraKind(ABC):
    """The functions of one kind of camera: rays, and what is in view."""

    sees_points: ClassVar[bool] = False  # it has `sight`, so that paths from lamps can end at it

    has_aperture: ClassVar[bool] = False  # rays of one position on the image differ (depth of field)
    has_area: ClassVar[bool] = True  # a pixel covers an area of the image; False: each has one ray only

    def sample_pixel(self, lens: Lens, film: FilmTensors, column: Tensor, row: Tensor, place: Vec2,
                     aperture: Vec2 | None) -> tuple[Ray, Tensor | None]:
        """Samples rays through points of pixels; args and result as of `Camera.sample_ray`."""
        return self.sample_ray(lens, film.position(column, row, place), aperture)

    @abstractmethod
    def sample_ray(self, lens: Lens, position: Vec2, aperture: Vec2 | None) -> tuple[Ray, Tensor | None]:
        """Samples unit world rays that start on the near plane, with the weights of their radiance.

        Args:
            lens: of the camera.
            position: (N,) on the image, fractions of its size; (0, 0) is the upper left corner.
            aperture: (N,) points of the unit square that choose a place on the lens; None without an aperture.

        Returns:
            The rays, attached to the lens; and their weights, (N,) detached: 0 where nothing is seen. None: all are 1.
        """

    @abstractmethod
    def beyond_far_plane(self, lens: Lens, p: Vec3) -> Tensor:
        """(N,) bool: world points beyond the far plane, which cannot be seen."""

    def lookouts(self, lens: Lens) -> list[Lens]:
        """Lenses with one eye each which together see what this lens sees; detached, as `lens` is."""
        return [lens]

    @abstractmethod
    def eye(self, lens: Lens) -> Tensor:
        """(4,) homogeneous: the point where all rays meet, or, with 0 at the end, the direction towards it; detached."""

    @abstractmethod
    def crosses_view(self, lens: Lens, x: Tensor, y: Tensor, a: Vec3, b: Vec3) -> Tensor:
        """True if part of a segment from `a` to `b`, (E,) world points, is in view; (E,) bool.

        Args:
            lens: of the camera, detached.
            x, y: (2,) the left and the right, the upper and the lower border of the view, positions on the image; float64.
        """


class ProjectiveKind(CameraKind):
    """The functions of a camera that projects the world to an image with pixels of some area."""

    @abstractmethod
    def project(self, lens: Lens, p: Vec3, aperture: Vec2 | None) -> Vec2:
        """Projects world points to the image, the inverse of `sample_ray`: fractions of its size, attached to both.

        Args:
            p: (N,) in front of the camera; they may lie outside of the view.
            aperture: as of `sample_ray`.
        """

    @abstractmethod
    def beyond_planes(self, lens: Lens, p: Vec3) -> tuple[Tensor, Tensor]:
        """Signed distances of world points beyond the near and the far plane, attached to both; (N,) each, of any scale.

        Polynomials in p, of second degree at most.
        """

    @abstractmethod
    def towards(self, lens: Lens, p: Vec3, aperture: Vec2 | None) -> Vec3:
        """Vectors from world points to the point from which they are seen, of any length; linear in p, attached to both.

        Args:
            aperture: as of `sample_ray`.
        """

    def sight(self, lens: Lens, p: Vec3, aperture: Vec2 | None) -> PointsSeen:
        """World points as the camera sees them, of cameras that `sees_points`; attached to both.

        Args:
            lens: with an entry for each point, (N,).
            p: (N,).
            aperture: as of `sample_ray`.
        """
        raise TypeError(f"{type(self).__name__} cannot tell how large points are that it sees")

    def aperture_radius(self, lens: Lens) -> Tensor | None:
        """() the radius of the aperture, detached; None: a pinhole."""
        return None

    @abstractmethod
    def frustum(self, lens: Lens, x: Tensor, y: Tensor) -> Frustum:
        """A frustum that contains all that is in view.

        Args:
            lens, x, y: as for `crosses_view`.
        """

    def crosses_view(self, lens: Lens, x: Tensor, y: Tensor, a: Vec3, b: Vec3) -> Tensor:
        enters, leaves = self.frustum(lens, x, y).clipped(a, b)
        return enters < leaves


class Camera(NamedTuple):
    """A sensor as tensors, with the functions of its kind; attached."""

    kind: CameraKind
    lens: Lens
    film: FilmTensors

    @property
    def dtype(self) -> torch.dtype:
        return self.film.size_x.dtype

    def sample_ray(self, column: Tensor, row: Tensor, place: Vec2,
                   aperture: Vec2 | None = None) -> tuple[Ray, Tensor | None]:
        """Samples rays through points of pixels, with the weights of their radiance.

        Args:
            column, row: (N,) of the pixels; see `FilmTensors.position`.
            place: (N,) in them, in [0, 1).
            aperture: (N,) uniform numbers if the kind has an aperture, else None.

        Returns:
            The rays, attached to the lens; and their weights, (N,) detached, or None if all are 1.
        """
        return self.kind.sample_pixel(self.lens, self.film, column, row, place, aperture)

    def beyond_far_plane(self, p: Vec3) -> Tensor:
        """(N,) bool: world points beyond the far plane, which cannot be seen."""
        return self.kind.beyond_far_plane(self.lens, p)


class ProjectiveCamera(Sensor):
    """Base class of cameras at `to_world` with a near and a far plane.

    Parameters: `to_world` (4, 4), and those of the subclass.

    Args:
        to_world: the pose, such as `rb.look_at` gives; the camera looks along its +z, with +y up.
        near_clip, far_clip: distances along the viewing axis between which surfaces are seen.
        focus_distance, shutter_open, shutter_close: accepted, but without effect on a camera without lens and motion.
        film: the size of the image; an `hdrfilm` by default.
        sampler: the random numbers; an `ldsampler` by default.
        medium: what the sensor stands in, and with it the whole scene.
    """

    takes_scale: ClassVar[bool] = False  # the lengths of its axes set the size of its view
    in_pixels: ClassVar[tuple[str, ...]] = ()  # its parameters in units of pixels

    def place(self, to_world: Matrix4 | None, near_clip: float, far_clip: float, film: Film | None, sampler: Sampler | None,
              medium: Medium | None) -> None:
        """Stores the attributes that all cameras with a pose and two clipping planes have.

        Raises:
            ValueError: if the planes are out of order, or `to_world` scales and the camera does not take that.
        """
        self.film = HDRFilm() if film is None else film
        self.sampler = LowDiscrepancy() if sampler is None else sampler
        self.medium = medium
        if not 0 < near_clip < far_clip:
            raise ValueError(f"near_clip must be positive and less than far_clip, got {near_clip} and {far_clip}")
        self.near_clip, self.far_clip = positive("near_clip", near_clip), float(far_clip)
        self.freeze("to_world", transform("to_world", to_world))
        if not self.takes_scale and not is_rigid(self.to_world):
            lengths = ", ".join(f"{length:.6g}" for length in self.to_world.detach()[:3, :3].norm(dim=0).tolist())
            raise ValueError(f"to_world of a camera must not scale or shear, as in Mitsuba 3; its axes have the lengths "
                             f"{lengths}: leave the scale out, and choose what is seen by the field of view")

    def as_written(self, attribute: str) -> Any:
        """The value of an attribute in files: the axes of `to_world` have length one unless the camera takes scales."""
        if attribute != "to_world" or self.takes_scale or is_rigid(self.to_world):
            return super().as_written(attribute)
        pose = self.to_world.detach().clone()
        pose[:3, :3] /= pose[:3, :3].norm(dim=0)
        if not is_rigid(pose):
            raise ValueError("to_world shears, which no file can say of a camera: its axes must be perpendicular; `rb.se3` "
                             "makes poses that stay rotations while they are optimised")
        return pose

    def domains(self) -> dict[str, Domain]:
        return {"to_world": POSE}

    @property
    def aspect(self) -> float:
        """The aspect ratio of the whole image, width / height."""
        return self.film.width / self.film.height

    def resized(self, width: int, height: int) -> ProjectiveCamera:
        """A camera with the same view and another number of pixels.

        Parameters that do not depend on the size, such as the pose, are shared with this camera: who optimises one
        optimises both. The others start from their values now.

        Args:
            width, height: of the new image, pixels.

        Raises:
            ValueError: if the film has a crop window, a parameter in pixels is parametrized, or the sides of the image
                would have another ratio and the camera cannot express that.
        """
        film = self.film
        if (film.crop_width, film.crop_height) != (film.width, film.height):
            raise ValueError(f"a camera with a crop window, {film.crop_width} x {film.crop_height} of {film.width} x "
                             f"{film.height}, cannot be resized; crop the images instead, and calibrate them so")
        if not self.in_pixels and width * film.height != height * film.width:
            raise ValueError(f"a {self.type} camera of {film.width} x {film.height} pixels cannot be one of {width} x "
                             f"{height}: its pixels would not be square; choose a scale by which both sides are whole "
                             f"numbers, or take the sensor calibrated")
        bound = [name for name in self.in_pixels if parametrize.is_parametrized(self, name)]
        if bound:
            raise ValueError(f"{', '.join(bound)} has a parametrization, which would not fit another size; remove it first")
        shared = {id(value): value for name, value in self.named_parameters() if name not in self.in_pixels}
        camera = copy.deepcopy(self, shared)
        camera.film.width = camera.film.crop_width = width
        camera.film.height = camera.film.crop_height = height
        camera.rescale(width / film.width, height / film.height)
        return camera

    def rescale(self, x: float, y: float) -> None:
        """Multiplies the parameters in units of pixels, in place, by the ratios of new to old width and height."""

    def kind(self) -> ProjectiveKind:
        """The functions of this kind of camera."""
        raise TypeError(f"{type(self).__name__} does not define its kind")

    def lens(self) -> Lens:
        """The camera's tensors that the functions of its kind read, attached."""
        raise TypeError(f"{type(self).__name__} does not define its lens")

    def view(self) -> str:
        """The field of view in words, for messages."""
        raise TypeError(f"{type(self).__name__} does not describe its view")

    def tensors(self) -> Camera:
        """The camera as a record of tensors, attached."""
        return Camera(self.kind(), self.lens(), self.film.tensors(self.to_world))


def is_rigid(matrix: Tensor) -> bool:
    """True if a (4, 4) transform neither scales nor shears; it may mirror."""
    linear = matrix.detach()[:3, :3].double()
    return bool(((linear @ linear.T - torch.eye(3, dtype=linear.dtype, device=linear.device)).abs() <= RIGID).all())


def number(value: float) -> Tensor:
    """() a number in torch's default dtype, for a parameter."""
    return torch.tensor(float(value), dtype=torch.get_default_dtype())
