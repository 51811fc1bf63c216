"""A wall under the sun that fills the view: its radiance is reflectance irradiance / pi, without noise."""

from __future__ import annotations

import torch_radbp as rb
from tests.scenes import diffuse, load, overhead, rectangle, rgb

COLOUR, SUN = "wall.bsdf.reflectance.value", "sun.irradiance.value"


def wall_under_sun(size: int = 4) -> rb.Scene:
    """Every sample of a colour c has radiance reflectance_c irradiance_c / pi, of 0.3, 0.5, 0.7 and 2, 3, 4."""
    return load(sensor=overhead(size), wall=rectangle((0, 0, 0), 3, bsdf=diffuse(0.3, 0.5, 0.7)),
                sun={"type": "directional", "direction": [0, 0, -1], "irradiance": rgb(2.0, 3.0, 4.0)})
