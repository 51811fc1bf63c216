"""Emitters: where light comes from."""

from torch_radbp.emitter import area, constant, point  # noqa: F401 (registers the plugins)
