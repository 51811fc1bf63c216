"""A user's rays in place of a camera: a column of pixels, one for each ray."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import torch
from torch import Tensor

from torch_radbp.film.box import Box
from torch_radbp.film.hdrfilm import HDRFilm
from torch_radbp.film.position import FilmTensors
from torch_radbp.plugin import Sensor
from torch_radbp.plugin.domain import NUMBER, Domain
from torch_radbp.sensor.frustum import Plane
from torch_radbp.sensor.kind import Camera, CameraKind
from torch_radbp.sensor.sampler import LowDiscrepancy
from torch_radbp.tensors.differentiated import primal
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.vec import Ray, Vec2, Vec3, dot, normalize

LOOKOUTS = 8  # origins from which edges are looked for, at most
NARROW = 1e-4  # rad, half of the angle of the cone around rays, at least
GRAZING = 0.05  # cosine to the middle of all directions from which on they are taken to go everywhere


class RayLens(NamedTuple):
    """A user's N rays, in the place of a camera's lens."""

    o: Vec3  # (N,) world
    d: Vec3  # (N,) unit length
    eye: Vec3  # () one of the origins, detached

    def ray(self, number: Tensor) -> Ray:
        """The rays with indices `number`, (M,) int32."""
        return Ray(*lookup((self.o, self.d), number))


@dataclass(frozen=True)
class RayKind(CameraKind):
    """A user's rays: each pixel has one ray, whatever the position in the pixel."""

    has_area: ClassVar[bool] = False

    def sample_pixel(self, lens: RayLens, film: FilmTensors, column: Tensor, row: Tensor, place: Vec2,
                     aperture: None) -> tuple[Ray, None]:
        return lens.ray(row), None

    def sample_ray(self, lens: RayLens, position: Vec2, aperture: None) -> tuple[Ray, None]:
        count = len(lens.d.x)
        return lens.ray((position.y * count).to(torch.int32).clamp(0, count - 1)), None

    def beyond_far_plane(self, lens: RayLens, p: Vec3) -> Tensor:
        return torch.zeros_like(p.x, dtype=torch.bool)

    def lookouts(self, lens: RayLens) -> list[RayLens]:
        """Copies of the lens, each with another ray's origin as its eye, to look for silhouettes from."""
        origins = torch.stack(tuple(lens.o), 1)
        some = origins[::-(-len(origins) // LOOKOUTS)].unique(dim=0)
        return [lens._replace(eye=Vec3(*origin.unbind())) for origin in some]

    def eye(self, lens: RayLens) -> Tensor:
        place = torch.stack(tuple(lens.eye)).double()
        return torch.cat([place, place.new_ones(1)])

    def crosses_view(self, lens: RayLens, x: Tensor, y: Tensor, a: Vec3, b: Vec3) -> Tensor:
        """True if a segment meets the cone around all rays, ahead of their origins."""
        o, d = (part.map(torch.Tensor.double) for part in (lens.o, lens.d))
        axis, middle = normalize(d.map(torch.mean)), o.map(torch.mean)
        cosine = dot(d, axis).min().clamp_max(math.cos(NARROW))
        if cosine < GRAZING:
            return torch.ones_like(a.x, dtype=torch.bool)
        offset = o - middle
        depth = dot(offset, axis)
        radius = torch.sqrt((dot(offset, offset) - depth * depth).clamp_min(0.0)).max()
        tip = middle - axis * (radius * cosine / torch.sqrt(1.0 - cosine * cosine))
        behind = Plane.through(middle, axis, -depth.min())
        before, after = behind.distance(a), behind.distance(b)
        crossing = before / torch.where(before == after, 1.0, before - after)
        first, last = torch.where(before < 0, crossing, 0.0), torch.where(after < 0, crossing, 1.0)
        # Where on its line the angle to the axis is least.
        start, along = a - tip, b - a
        ahead, slope, inwards = dot(start, axis), dot(along, axis), dot(start, along)
        turn = slope * inwards - ahead * dot(along, along)
        nearest = (ahead * inwards - slope * dot(start, start)) / torch.where(turn == 0, 1.0, turn)
        shares = torch.minimum(torch.maximum(nearest, first), last), first, last
        greatest = torch.stack([dot(normalize(start + along * share), axis) for share in shares]).amax(0)
        return (greatest >= cosine) & ((before >= 0) | (after >= 0))


class Rays(Sensor):
    """Rays given by the user, as a sensor with one pixel for each.

    Args:
        origins: (N, 3) world.
        directions: (N, 3) unit length; attached, as the origins.
    """

    def __init__(self, origins: Tensor, directions: Tensor):
        super().__init__()
        self.origins, self.directions = origins, directions
        self.film, self.sampler = HDRFilm(width=1, height=len(origins), rfilter=Box()), LowDiscrepancy()

    def domains(self) -> dict[str, Domain]:
        return {"origins": NUMBER, "directions": NUMBER}

    def tensors(self) -> Camera:
        """The rays as a record of tensors, attached."""
        o, d = Vec3.of(self.origins), Vec3.of(self.directions)
        return Camera(RayKind(), RayLens(o, d, o.map(lambda part: primal(part)[0])), self.film.tensors(self.origins))


def given_rays(origins: Tensor, directions: Tensor, dtype: torch.dtype, device: torch.device) -> Rays:
    """Checks a user's rays, from origins (N, 3) world, in directions (N, 3) of any length; attached to both.

    Raises:
        TypeError: if they are no floating-point tensors.
        ValueError: if a shape is another, there is no ray, a number is not finite, a direction is zero, or they are
            not on the device.
    """
    for name, value in (("origins", origins), ("directions", directions)):
        if not isinstance(value, Tensor) or not value.is_floating_point():
            got = value.dtype if isinstance(value, Tensor) else type(value).__name__
            raise TypeError(f"{name} of rays must be a floating-point tensor (N, 3), got {got}")
        if value.ndim != 2 or value.shape[1] != 3 or not len(value):
            raise ValueError(f"{name} of rays must have shape (N, 3) with N of at least 1, got {tuple(value.shape)}")
        if value.device != device:
            raise ValueError(f"{name} of rays are on {value.device}, and the scene on {device}: move them there")
        bad = ~torch.isfinite(value.detach()).all(1)
        if bad.any():
            raise ValueError(f"{name} of rays must be finite, got NaN or infinity in {int(bad.sum())} of {len(value)}, "
                             f"first in row {int(bad.nonzero()[0])}")
    if origins.shape != directions.shape:
        raise ValueError(f"each ray needs an origin and a direction, got {len(origins)} origins and {len(directions)} "
                         f"directions; a single origin is repeated by origin.expand(len(directions), 3)")
    largest = primal(directions).abs().amax(1, keepdim=True)
    if not largest.all():
        raise ValueError(f"directions of rays must not be zero, got {int((largest == 0).sum())} of {len(largest)}, first in "
                         f"row {int((largest[:, 0] == 0).nonzero()[0])}")
    scaled = directions / largest  # so that squares of tiny directions do not underflow
    unit = scaled / scaled.norm(dim=1, keepdim=True)
    return Rays(origins.to(dtype), unit.to(dtype))
