"""Textures: functions from surface coordinates to linear RGB."""

from torch_radbp.texture import (  # noqa: F401 (registers the plugins)
    bitmap,
    blackbody,
    checkerboard,
    d65,
    irregular,
    mesh_attribute,
    rawconstant,
    regular,
    rgb,
    srgb,
    uniform,
)
