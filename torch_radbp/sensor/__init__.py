"""Sensors: where rays start."""

from torch_radbp.sensor import perspective, sampler  # noqa: F401 (registers the plugins)
