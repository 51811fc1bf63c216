"""Integrators by Mitsuba's names: what they set is what `Renderer` takes for granted."""

from torch_radbp.integrator import (  # noqa: F401 (registers the plugins)
    absent,
    aov,
    direct,
    moment,
    path,
    projective,
    ptracer,
    volpath,
)
