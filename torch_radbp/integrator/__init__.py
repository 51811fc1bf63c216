"""Integrators by Mitsuba's names: what they set is what `Renderer` takes for granted."""

from torch_radbp.integrator import absent, aov, direct, moment, path, ptracer, volpath  # noqa: F401 (registers the plugins)
