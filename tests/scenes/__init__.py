"""The scenes of the tests. The words that they are described in, and those that most tests share, come from here.

A scene that only one test has stands in its file; what two of them need is a module here.
"""

from tests.scenes.cases import (
    CASES,
    Case,
    cornell,
    furnace,
    sky_and_points,
    textured,
    textured_lamp,
    two_sided,
)
from tests.scenes.description import (
    GLOW,
    SKY,
    diffuse,
    load,
    look_at,
    overhead,
    parameters,
    rectangle,
    rgb,
    sensor,
    texels,
)

__all__ = ["CASES", "GLOW", "SKY", "Case", "cornell", "diffuse", "furnace", "load", "look_at", "overhead", "parameters",
           "rectangle", "rgb", "sensor", "sky_and_points", "texels", "textured", "textured_lamp", "two_sided"]
