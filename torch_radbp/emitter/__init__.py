"""Emitters: where light comes from."""

from torch_radbp.emitter import (  # noqa: F401 (registers the plugins)
    area,
    constant,
    directional,
    directionalarea,
    envmap,
    point,
    projector,
    spot,
    sunsky,
)
