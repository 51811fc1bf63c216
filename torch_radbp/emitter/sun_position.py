"""The direction of the sun at a place and time on earth.

Reference: Blanco-Muriel, Alarcon-Padilla, Lopez-Moratalla and Lara-Coira 2001, "Computing the Solar Vector", table 1.
"""

from __future__ import annotations

import math
from calendar import monthrange
from typing import NamedTuple

import torch
from torch import Tensor

from torch_radbp.plugin import integer

PARALLAX = 6371.01 / 149597890.0  # radius of the earth over its distance from the sun


class PlaceAndTime(NamedTuple):
    """A place on earth and a time there; by default Mitsuba's, an afternoon in Tokyo."""

    latitude: float = 35.6894  # degrees north
    longitude: float = 139.6917  # degrees east
    timezone: float = 9.0  # hours ahead of Greenwich
    year: int = 2010  # local time, as all that follows
    month: int = 7
    day: int = 10
    hour: float = 15.0
    minute: float = 0.0
    second: float = 0.0


RANGES = {"latitude": (-90, 90), "longitude": (-360, 360), "timezone": (-14, 14), "year": (1, 9999), "month": (1, 12),
          "hour": (0, 24), "minute": (0, 60), "second": (0, 60)}  # inclusive


def check_place_and_time(given: PlaceAndTime) -> None:
    """Raises ValueError for an invalid place or time."""
    for name in ("year", "month", "day"):
        integer(name, getattr(given, name))
    for name, (low, high) in RANGES.items():
        if not low <= getattr(given, name) <= high:
            raise ValueError(f"{name} must be from {low} to {high}, got {getattr(given, name)}")
    days = monthrange(given.year, given.month)[1]
    if not 1 <= given.day <= days:
        raise ValueError(f"day must be from 1 to {days} in month {given.month}, got {given.day}")


def sun_position(moment: PlaceAndTime) -> Tensor:
    """(3,) unit direction towards the sun: +z is the zenith, +x south and +y west; float64."""
    latitude, longitude, timezone, year, month, day, hour, minute, second = moment
    hours = hour - timezone + (minute + second / 60.0) / 60.0  # universal time
    days = julian_day(year, month, day) + hours / 24.0 - 2451545.0
    node = 2.1429 - 0.0010394594 * days
    mean_longitude, anomaly = 4.8950630 + 0.017202791698 * days, 6.2400600 + 0.0172019699 * days
    ecliptic = (mean_longitude + 0.03341607 * math.sin(anomaly) + 0.00034894 * math.sin(2 * anomaly) - 0.0001134
                - 0.0000203 * math.sin(node))
    obliquity = 0.4090928 - 6.2140e-9 * days + 0.0000396 * math.cos(node)
    ascension = math.atan2(math.cos(obliquity) * math.sin(ecliptic), math.cos(ecliptic))
    declination = math.asin(math.sin(obliquity) * math.sin(ecliptic))
    sidereal = math.radians((6.6974243242 + 0.0657098283 * days + hours) * 15.0 + longitude)
    angle, north = sidereal - ascension, math.radians(latitude)
    zenith = math.acos(math.cos(north) * math.cos(angle) * math.cos(declination) + math.sin(declination) * math.sin(north))
    azimuth = math.atan2(-math.sin(angle), math.tan(declination) * math.cos(north) - math.sin(north) * math.cos(angle))
    zenith += PARALLAX * math.sin(zenith)
    azimuth -= math.pi
    return torch.tensor([math.sin(zenith) * math.cos(azimuth), math.sin(zenith) * math.sin(azimuth), math.cos(zenith)],
                        dtype=torch.float64)


def julian_day(year: int, month: int, day: int) -> float:
    """The Julian day number, at its beginning in universal time, by the Gregorian calendar.

    Reference: Fliegel and Van Flandern 1968.
    """
    shift = int((month - 14) / 12)  # -1 in January and February
    return (int(1461 * (year + 4800 + shift) / 4) + int(367 * (month - 2 - 12 * shift) / 12)
            - int(3 * int((year + 4900 + shift) / 100) / 4) + day - 32075 - 0.5)
