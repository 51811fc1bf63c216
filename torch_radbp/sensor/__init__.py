"""Sensors: where rays start."""

from torch_radbp.sensor import orthographic, perspective, sampler  # noqa: F401 (registers the plugins)
