"""Daylight: the sky of a clear day, and the sun in it, after Hosek and Wilkie.

The sky is Hosek and Wilkie's formula. Its coefficients, for each channel, are interpolated between turbidities, albedos of
the ground and elevations of the sun. It is evaluated for every direction; directions are picked by an image of it, as those
of an environment map, or inside of the sun's disc.

References: Hosek and Wilkie 2012, "An Analytic Model for Full Spectral Sky-Dome Radiance", equations 8 and 9; the same 2013,
"Adding a Solar-Radiance Function to the Hosek-Wilkie Skylight Model".
"""

from __future__ import annotations

import functools
import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from torch_radbp.emitter.attributes import FACTOR, colour, factor, weight
from torch_radbp.emitter.envmap import Envmap, EnvmapKind, EnvmapTable, density, envmap_table, sample_direction
from torch_radbp.emitter.sun_position import PlaceAndTime, check_place_and_time, sun_position
from torch_radbp.interface.emitter import Aim, Light, Pick, SurroundKind
from torch_radbp.interface.texture import LUMINANCE
from torch_radbp.plugin import Matrix4, Point3, SceneWarning, Texture, finite, register
from torch_radbp.plugin.domain import FRACTION, NUMBER, Domain
from torch_radbp.sampling.sampler import fine_unit
from torch_radbp.tensors.lookup import lookup
from torch_radbp.tensors.vec import Frame, Vec3, dot, where
from torch_radbp.transforms import affine

DATA = Path(__file__).with_name("sunsky_data.npz")  # its origin: sunsky_data.md
ELEVATIONS = 2.0 + 3.0 * np.arange(30)  # degrees, of the table of the sun's radiance
USUAL_APERTURE = 0.5358  # degrees across, of the sun
LARGEST_TURBIDITY = 10.0
SCALE = 1.0 / 106.75025939941406  # of radiance: of a unit spectrum the luminance is 1, as Mitsuba has it
ROWS, COLUMNS = 129, 256  # of the image by which directions are picked; its middle row is the horizon
LEAST_SHARE = 0.1  # of samples for the sky, and for the sun, if they shine
UNIT = 1e-6  # how far the length of a vector that counts as a unit vector is from 1
NEAR_HORIZON, NEAR_SUN = 1e-6, 1e-12  # cosine, and squared distance, below which derivatives are cut off
UPRIGHT = torch.tensor([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]], dtype=torch.float64)  # y becomes z


class SunskyTable(NamedTuple):
    """The coefficients of a sky, (1,) each, attached; sun and pose, () each, detached."""

    coefficients: tuple[Vec3, ...]  # nine, for each channel
    sky: Vec3  # radiance that multiplies the formula
    sun: Vec3  # radiance of the disc
    to_local: Frame  # rows of the rotation from the world, whose +z points at the zenith
    to_world: Frame
    towards: Vec3  # local unit direction of the sun
    squared_radius: Tensor  # squared distance of the disc's border from its middle, on the unit sphere
    share: Tensor  # share of samples that go to the sky
    image: EnvmapTable  # the sky as an image, by which directions are sampled


@functools.cache
def data() -> dict[str, Tensor]:
    """The published coefficients of the sky's formula, float64."""
    with np.load(DATA) as file:
        return {name: torch.from_numpy(file[name].astype(np.float64)) for name in file}


@dataclass(frozen=True)
class SunskyKind(SurroundKind):
    """Sky and sun: directions are sampled by an image of the sky, or within the sun's disc."""

    def table(self, emitters: Sequence[Sunsky], like: Tensor) -> SunskyTable:
        emitter, = emitters
        return sunsky_table(emitter, like)

    def aim(self, table: SunskyTable, proposal: SunskyTable, p: Vec3, pick: Pick) -> Aim:
        u, v, share = fine_unit(pick.u), fine_unit(pick.v), proposal.share.to(torch.float64)
        at_sky = u < share
        to_sky, _ = sample_direction(proposal.image, torch.where(at_sky, u / share.clamp_min(1e-9), 0.5), v)
        rest = torch.where(at_sky, 0.5, (u - share) / (1.0 - share).clamp_min(1e-9))
        d = where(at_sky, to_sky, direction_in_disc(proposal, rest.to(p.x.dtype), v.to(p.x.dtype)))
        met = ~at_sky | in_disc(proposal, d)
        return Aim(d, pick.pmf * _mixed(proposal, density(proposal.image, d), met), radiance=_light(table, d, met),
                   weighing=pick.pmf * _mixed(proposal, EnvmapKind().weighing(proposal.image, d), met))

    def radiance(self, table: SunskyTable, d: Vec3) -> Vec3:
        return _light(table, d, in_disc(table, d))

    def weighing(self, proposal: SunskyTable, d: Vec3) -> Tensor:
        return _mixed(proposal, EnvmapKind().weighing(proposal.image, d), in_disc(proposal, d))


def _mixed(table: SunskyTable, of_sky: Tensor, met: Tensor) -> Tensor:
    """The density of directions by both techniques together; `met`: they lie in the sun's disc."""
    of_sun = 1.0 / (math.pi * table.squared_radius)
    return table.share * of_sky + (1.0 - table.share) * of_sun * met.to(of_sky.dtype)


def in_disc(table: SunskyTable, d: Vec3) -> Tensor:
    """(N,) bool: world directions that lie in the sun's disc."""
    apart = table.to_local.to_local(d.detach()) - table.towards
    return dot(apart, apart) <= table.squared_radius


def direction_in_disc(table: SunskyTable, u: Tensor, v: Tensor) -> Vec3:
    """Samples world directions uniformly over the solid angle of the sun's disc."""
    q, phi = 0.25 * table.squared_radius * u, 2.0 * math.pi * v  # sin^2 of half the angle with the middle
    across = 2.0 * torch.sqrt(q * (1.0 - q))
    local = Frame.of(table.towards).to_world(Vec3(across * torch.cos(phi), across * torch.sin(phi), 1.0 - 2.0 * q))
    return table.to_world.to_local(local)


def _light(table: SunskyTable, d: Vec3, met: Tensor) -> Vec3:
    """Radiance that arrives from world directions; attached to them and to the table.

    Args:
        met: (N,) bool: they meet the sun's disc.
    """
    local = table.to_local.to_local(d)
    first = torch.zeros_like(d.x, dtype=torch.int32)
    above = ((local.z >= 0) & (table.towards.z >= 0)).to(d.x.dtype)
    coefficients = tuple(lookup(each, first) for each in table.coefficients)
    sky = _formula(coefficients, local, table.towards) * lookup(table.sky, first)
    return (sky + lookup(table.sun, first) * met.to(d.x.dtype)) * above


def _formula(coefficients: tuple[Vec3, ...], local: Vec3, towards: Vec3) -> Vec3:
    """Hosek and Wilkie's equation 8, for each channel; above the horizon."""
    cosine = local.z.clamp_min(NEAR_HORIZON)
    apart = local - towards
    squared = dot(apart, apart).clamp_min(NEAR_SUN)
    gamma_cosine = 1.0 - 0.5 * squared
    gamma = torch.atan2(torch.sqrt((squared * (1.0 - 0.25 * squared)).clamp_min(NEAR_SUN)), gamma_cosine)

    def of_channel(channel: tuple[Tensor, ...]) -> Tensor:
        a, b, c, d, e, f, g, h, sharpness = channel
        spread = (1.0 + sharpness * sharpness - 2.0 * sharpness * gamma_cosine).clamp_min(NEAR_HORIZON)
        around = (1.0 + gamma_cosine * gamma_cosine) / (spread * torch.sqrt(spread))
        return (1.0 + a * torch.exp(b / (cosine + 0.01))) * (
            c + d * torch.exp(e * gamma) + f * (gamma_cosine * gamma_cosine) + g * around + h * torch.sqrt(cosine))

    return Vec3(*map(of_channel, zip(*coefficients)))


def _between(table: Tensor, place: Tensor) -> Tensor:
    """Linear interpolation along the first axis of a table, attached to the position, ()."""
    lower = int(place.detach().clamp(0, len(table) - 2))
    return table[lower] + (table[lower + 1] - table[lower]) * (place - lower)


def coefficients_of(emitter: Sunsky) -> tuple[Tensor, Tensor, Tensor]:
    """Coefficients (3, 9) and radiance (3,) of the sky, and radiance (3,) of the sun, float64, attached."""
    tables = {name: table.to(emitter.turbidity.device) for name, table in data().items()}
    turbidity = emitter.turbidity.double().clamp(1.0, LARGEST_TURBIDITY) - 1.0
    albedo = emitter.albedo.colour().double().expand(3)
    elevation = math.asin(max(-1.0, min(1.0, float(emitter.local_sun()[2]))))
    x = max(elevation / (0.5 * math.pi), 0.0) ** (1 / 3)
    powers = [math.comb(5, k) * (1 - x) ** (5 - k) * x**k for k in range(6)]

    def interpolated(table: Tensor) -> Tensor:
        dark, bright = (sum(share * point for share, point in zip(powers, each)) for each in _between(table, turbidity))
        mix = albedo.reshape(3, *[1] * (dark.dim() - 1))
        return dark + (bright - dark) * mix

    place = torch.tensor((math.degrees(elevation) - ELEVATIONS[0]) / (ELEVATIONS[1] - ELEVATIONS[0]), dtype=torch.float64)
    sun = _between(_between(tables["sun_radiance"], turbidity), place.clamp(0.0, len(ELEVATIONS) - 1.0))
    usual, chosen = (math.sin(math.radians(0.25 * angle)) ** 2 for angle in (USUAL_APERTURE, emitter.sun_aperture))
    return (interpolated(tables["sky_params"]), interpolated(tables["sky_radiance"]) * SCALE * emitter.sky_scale,
            sun * (usual / chosen) * emitter.sun_scale)


def sunsky_table(emitter: Sunsky, like: Tensor) -> SunskyTable:
    """Builds the table of a sky, with the image by which its directions are sampled."""
    coefficients, sky, sun = (part.to(like) for part in coefficients_of(emitter))
    rotation = emitter.rotation().to(like)
    rows, columns = (Frame(*(Vec3.of(row) for row in matrix.unbind())) for matrix in (rotation.T, rotation))
    radius = like.new_tensor(4.0 * math.sin(math.radians(0.25 * emitter.sun_aperture)) ** 2)
    table = SunskyTable(
        tuple(Vec3.of(each[None]) for each in coefficients.unbind(1)), Vec3.of(sky[None]), Vec3.of(sun[None]), rows, columns,
        Vec3.of(emitter.local_sun().to(like)), radius, like.new_ones(()), None)
    with torch.no_grad():
        pose = torch.eye(4, dtype=torch.float64)
        pose[:3, :3] = emitter.rotation().double().cpu()
        image = _image_of(table, like)
        picked = envmap_table(Envmap(data=image.to("cpu"), to_world=pose @ UPRIGHT).to(like), like)
        polar = torch.linspace(0, math.pi, ROWS, dtype=torch.float64)
        solid = (torch.sin(polar) * (2 * math.pi**2 / (ROWS * COLUMNS))).to(like)[:, None]
        of_sky = float((image @ like.new_tensor(LUMINANCE) * solid).sum())
        of_sun = float(sun.detach() @ like.new_tensor(LUMINANCE)) * math.pi * float(radius) * bool(table.towards.z >= 0)
        share = of_sky / (of_sky + of_sun) if of_sky + of_sun > 0 else 1.0
        if of_sun > 0 and of_sky > 0:
            share = min(max(share, LEAST_SHARE), 1.0 - LEAST_SHARE)
    return table._replace(image=picked, share=like.new_tensor(share))


def _image_of(table: SunskyTable, like: Tensor) -> Tensor:
    """(ROWS, COLUMNS, 3) image of the sky without the sun, by latitude and longitude; detached."""
    theta = torch.linspace(0, math.pi, ROWS, dtype=torch.float64, device=like.device)[:, None]
    phi = (torch.arange(COLUMNS, dtype=torch.float64, device=like.device)[None] + 0.5) * (2 * math.pi / COLUMNS)
    x, y, z = torch.sin(theta) * torch.sin(phi), torch.cos(theta).expand(-1, COLUMNS), -torch.sin(theta) * torch.cos(phi)
    y = torch.where(y.abs() < 1e-9, 0.0, y)
    # `UPRIGHT` turns y to the zenith.
    local = Vec3(*(part.reshape(-1).to(like) for part in (x, -z, y)))
    sky = _light(table, table.to_world.to_local(local), torch.zeros_like(local.x, dtype=torch.bool))
    return torch.stack([part.detach() for part in sky], -1).clamp_min(0.0).reshape(ROWS, COLUMNS, 3)


@register("emitter", "sunsky")
class Sunsky(Light):
    """The sky of a clear day, and the sun in it, as an infinitely distant environment whose zenith is the local +z.

    Below the horizon it is black. Of Mitsuba's plugin the sun with a dark limb, `complex_sun`, is missing.

    Parameters: `turbidity`, `sky_scale`, `sun_scale` (), `albedo`. Derivatives: with respect to these. Tables are linear
    between whole turbidities: there the slope jumps, and the derivative is that of the side above, as Mitsuba's. The sun's
    place and the pose are fixed: the disc's border would move, which derivatives at fixed directions miss.

    Args:
        turbidity: of the air, from 1 (clearest) to 10.
        albedo: of the ground, from 0 to 1.
        sun_direction: towards the sun, world space, any length; or it follows from place and time.
        latitude, longitude: degrees, north and east.
        timezone: hours ahead of Greenwich.
        year, month, day, hour, minute, second: local time.
        complex_sun: not supported, must be false.
        sun_aperture: degrees across the sun's disc; its irradiance stays the same.
        sun_scale, sky_scale: multiply the light of the sun and of the sky.
        to_world: a rotation, perhaps with a scale, which has no effect.

    Raises:
        ValueError: for values out of range, for a direction beside a place or time, or a pose that is not rigid.
    """

    def __init__(self, *, turbidity: float = 3.0, albedo: Texture | float = 0.3, sun_direction: Point3 | None = None,
                 latitude: float | None = None, longitude: float | None = None, timezone: float | None = None,
                 year: int | None = None, month: int | None = None, day: int | None = None, hour: float | None = None,
                 minute: float | None = None, second: float | None = None, sun_aperture: float = USUAL_APERTURE,
                 sun_scale: float = 1.0, sky_scale: float = 1.0, complex_sun: bool = False,
                 to_world: Matrix4 | None = None, sampling_weight: float = 1.0):
        super().__init__()
        if complex_sun:
            raise ValueError("complex_sun is not supported: the sun's disc has the same radiance everywhere")
        if not 0 < sun_aperture < 180:
            raise ValueError(f"sun_aperture must be between 0 and 180 degrees, got {sun_aperture}")
        self.sun_aperture = float(sun_aperture)
        dtype = torch.get_default_dtype()
        self.freeze("turbidity", torch.tensor(float(turbidity), dtype=dtype))
        self.albedo = colour(self, "albedo", albedo)
        self.freeze("sun_scale", factor(sun_scale))
        self.freeze("sky_scale", factor(sky_scale))
        pose = affine("to_world", to_world)
        self.register_buffer("to_world", pose)
        self.rotation()
        given = {"latitude": latitude, "longitude": longitude, "timezone": timezone, "year": year, "month": month,
                 "day": day, "hour": hour, "minute": minute, "second": second}
        named = [name for name, value in given.items() if value is not None]
        if sun_direction is None:
            moment = PlaceAndTime(**{name: given[name] for name in named})
            check_place_and_time(moment)
            sun = self.rotation().double() @ sun_position(moment)
        elif named:
            raise ValueError(f"give either sun_direction or a place and time, got {', '.join(named)} as well")
        else:
            sun = finite("sun_direction", sun_direction, (3,)).double()
        if not sun.any():
            raise ValueError("sun_direction must not be zero")
        length = torch.linalg.vector_norm(sun)
        # A unit vector stays as it is, to the last bit.
        self.register_buffer("sun_direction", (sun if abs(length - 1) < UNIT else sun / length).to(dtype))
        self.sampling_weight = weight(sampling_weight)
        if self.local_sun()[2] < 0:
            warnings.warn("the sun of a sunsky is below the horizon, its local xy plane, and does not shine; local +z is "
                          "the zenith: turn it by to_world where the scene has another", SceneWarning, stacklevel=2)

    complex_sun = False
    latitude = longitude = timezone = year = month = day = hour = minute = second = None  # resolved into `sun_direction`

    def domains(self) -> dict[str, Domain]:
        return {"turbidity": NUMBER._replace(low=1.0, high=LARGEST_TURBIDITY), "albedo": FRACTION, "sun_scale": FACTOR,
                "sky_scale": FACTOR}

    def rotation(self) -> Tensor:
        """(3, 3) rotation from local to world directions.

        Raises:
            ValueError: if the pose is not rigid but for a scale.
        """
        linear = self.to_world.detach()[:3, :3].double()
        linear = linear / torch.linalg.vector_norm(linear, dim=0).mean()
        if (linear.T @ linear - torch.eye(3).to(linear)).abs().max() > 1e-4:
            raise ValueError("to_world of a sunsky must be a rotation, perhaps with a scale that is the same along all axes")
        return linear

    def local_sun(self) -> Tensor:
        """(3,) unit direction towards the sun, local, float64."""
        return torch.nn.functional.normalize(self.rotation().T @ self.sun_direction.double(), dim=0)

    def kind(self) -> SunskyKind:
        return SunskyKind()
