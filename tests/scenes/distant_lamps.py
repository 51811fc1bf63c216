"""A lamp far away, whose light is all but parallel, of every kind."""

from __future__ import annotations

from typing import Any

from tests.scenes import look_at, rgb
from torch_radbp.io.values.transform import scale

LAMPS: dict[str, dict[str, Any]] = {
    "directional": {"type": "directional", "to_world": look_at((3, 2, 1), (0, 0, 0), (0, 1, 0)), "irradiance": rgb(2, 2, 2)},
    "point": {"type": "point", "position": [30.0, 20.0, 10.0], "intensity": rgb(2000, 2000, 2000)},
    "surface": {"type": "rectangle", "to_world": look_at((30, 20, 10), (0, 0, 0), (0, 1, 0)) @ scale((0.3, 0.3, 1)),
                "emitter": {"type": "area", "radiance": rgb(7000, 7000, 7000)}},
}
