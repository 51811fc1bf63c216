"""Emitters: where light comes from."""

from torch_radbp.emitter import area, constant, directional, envmap, point, projector, spot  # noqa: F401 (registers the plugins)
