"""Sensors: where rays start."""

from torch_radbp.sensor import independent, perspective  # noqa: F401 (registers the plugins)
