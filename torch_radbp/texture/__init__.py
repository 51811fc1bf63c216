"""Textures: functions from surface coordinates to linear RGB."""

from torch_radbp.texture import bitmap, rgb  # noqa: F401 (registers the plugins)
