"""Sensors: where rays start."""

from torch_radbp.sensor import batch, calibrated, orthographic, perspective, sampler, thinlens  # noqa: F401 (registers the plugins)
