"""Scenes in which a lamp projects a picture onto a floor."""

from __future__ import annotations

from typing import Any

from tests.scenes import look_at, rgb
from tests.scenes.inner_jumps import noise
from tests.scenes.moving import MovingScene
from tests.scenes.shadows import ABOVE, FINE, LAMPS, PLATE, PUSH, lit, moved
from torch_radbp.io.values.transform import rotate, scale

PROJECTOR = {"type": "projector", "to_world": look_at(ABOVE, (0.1, 0.05, 0), (0.1, 1, 0)), "fov": 35, "scale": 6.0}
TEXELS, SMOOTH = ({"type": "bitmap", "bitmap": 0.3 + noise(3, 4), "raw": True, "wrap_mode": "clamp", "filter_type": kind}
                  for kind in ("nearest", "bilinear"))
SQUARES = {"type": "checkerboard", "color0": rgb(0.2, 0.4, 0.9), "color1": rgb(0.8, 0.3, 0.1),
           "to_uv": rotate((0, 0, 1), 20) @ scale((2.3, 1.7, 1))}


def of_everything(label: str, lamp: dict[str, Any], **objects: Any) -> dict[str, MovingScene]:
    """The lamp, the floor and the camera move in turn."""
    build = lit(lamp, **objects)
    return {f"{name}, {label}": moved(build, f"{name}.to_world", PUSH[part])._replace(step=FINE) for name, part in (
        ("lamp", "lamp"), ("floor", "floor"), ("sensor", "camera"))}


PICTURES = {
    **of_everything("texels", PROJECTOR | {"irradiance": TEXELS}),
    **of_everything("smooth", PROJECTOR | {"irradiance": SMOOTH}),
    **of_everything("squares of a spot", LAMPS["spot"] | {"texture": SQUARES}),
    "lamp, texels, two projectors": moved(lit(PROJECTOR | {"irradiance": TEXELS}, plate=PLATE, other=PROJECTOR | {
        "to_world": look_at((-1.0, 0.3, 1.8), (0.1, 0.05, 0), (0.1, 1, 0)), "irradiance": SMOOTH}), "lamp.to_world",
        PUSH["lamp"])._replace(step=FINE),
}
